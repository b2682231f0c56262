"""Tables, one row per sample: which column carries what, whatever file they come from.

A table may hold many short recordings behind each other, each with a clock of its own
that begins again (LeRobot's `episode_index`): they become stretches with a gap between
them, never joined.
"""

import difflib
from abc import abstractmethod
from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from itertools import pairwise
from pathlib import Path

import numpy as np
import pyarrow as pa

from seqid_cli.errors import InputError
from seqid_cli.logs.drives import in_si
from seqid_cli.logs.raw import (
    ACCELEROMETERS,
    GYRO,
    RawLog,
    Rows,
    Stamps,
    Stream,
    partly_logged,
)
from seqid_cli.logs.tables import naming_schemes as schemes
from seqid_cli.logs.tables.columns import TimeColumn, numbers, read_stamps
from seqid_cli.logs.tables.csv_form import nameless
from seqid_cli.robot.toml_schema import Channels, Columns
from seqid_cli.robot.types import Imu, Robot
from seqid_cli.typing import Array

ROWS = "the rows"
_SHOWN = 6
# Forms of names: of accelerometers (by number, or the axes of a triad) and of the
# gyro's axes.
_FORMS = (
    *((f"{{imu}}{mark}a{{of}}", f"{{imu}}{mark}g{{of}}") for mark in "./_"),
    *(
        (
            f"{stem}linear_acceleration{mark}{{of}}",
            f"{stem}angular_velocity{mark}{{of}}",
        )
        for stem, mark in (("{imu}.", "."), ("{imu}/", "/"), ("/{imu}/data/", "/"))
    ),
)


def imu_columns(
    where: str, robot: Robot, imu: Imu, known: Collection[str], warnings: list[str]
) -> tuple[list[str], list[str]] | None:
    """Find the accelerometer and gyro columns of an IMU; None where the log has none of them."""
    count = len(imu.positions)
    for form, gyro in _FORMS:
        accelerometers = [form.format(imu=imu.name, of=k + 1) for k in range(count)]
        if count == 3 and not set(known).intersection(accelerometers):
            accelerometers = [form.format(imu=imu.name, of=axis) for axis in "xyz"]
        rates = (
            [gyro.format(imu=imu.name, of=axis) for axis in "xyz"] if imu.gyro else []
        )
        missing = [name for name in accelerometers + rates if name not in known]
        if not missing:
            return accelerometers, rates
        if len(missing) < len(accelerometers) + len(rates):
            raise partly_logged(imu, missing, where)
    # UR's own accelerometer, for a triad of the robot file that rides on the last link.
    names = [f"actual_tool_accelerometer_{axis}" for axis in range(3)]
    last = imu.after_joint == robot.n - 1 and count == 3 and not imu.gyro
    if not last or any(name not in known for name in names):
        return None
    warnings.append(f"IMU {imu.name!r} is read from {names[0]} ... {names[-1]}")
    return names, []


def separate(
    stamps: Stamps, keep: Rows, episode: Array, name: str
) -> tuple[Stamps, Rows, list[str]]:
    """Lay episodes (M,), NaN where missing, of a column `name`, one behind the other; one stays.

    `stamps` (M,): of the rows [ns]. `keep` (K,): the rows that have one. Returns: new
    stamps, the rows of an episode, notes.
    """
    hole_s, hole_intervals = 1.0, 50  # between episodes, at least
    numbered = np.isfinite(episode[keep])
    lost = int(np.count_nonzero(~numbered))
    notes = [f"{lost} rows without {name} were left out"] if lost else []
    keep = keep[numbered]
    runs = np.split(keep, np.flatnonzero(np.diff(episode[keep])) + 1)
    if len(runs) == 1:
        return stamps, keep, notes
    # The mean interval inside the episodes, gaps left out: the holes then fit the time
    # base.
    steps = np.concatenate([np.diff(stamps[run]) for run in runs])
    steps = steps[steps > 0]
    interval = (
        float(np.mean(steps[steps < 1.5 * np.median(steps)])) if len(steps) else 1e9
    )
    hole = round(interval * max(hole_intervals, np.ceil(hole_s * 1e9 / interval)))
    moved = stamps.copy()
    for before, run in pairwise(runs):
        moved[run] += int(moved[before].max()) + hole - int(stamps[run].min())
    text = (
        f"{len(runs)} episodes ({name}) are read as stretches with a gap of"
        f" {hole * 1e-9:.3g} s"
    )
    notes.append(f"{text} between them")
    return moved, keep, notes


@dataclass(frozen=True)
class TableFile:
    """An opened file that holds a table."""

    path: Path
    names: tuple[str, ...]  # elements of list columns as `column[k]`
    # of joints in lists, if named
    entries: Mapping[str, int] = field(default_factory=dict)
    notes: tuple[str, ...] = ()  # what was noticed

    @property
    def where(self) -> str:
        """The file, for messages."""
        return str(self.path)

    @abstractmethod
    def tables(
        self, columns: Sequence[str], rows: int | None
    ) -> Iterator[tuple[pa.Table, str]]:
        """Read columns, at most `rows` rows at a time; says what was lost."""


@dataclass(frozen=True)
class Plan:
    """Which column carries what: per quantity one per joint, per IMU accelerometers and gyro."""

    time: TimeColumn
    joints: dict[str, list[str | None]]
    imus: dict[str, tuple[list[str], list[str]]]
    episode: str | None
    warnings: list[str]


def read_table(
    file: TableFile, robot: Robot, rows: int | None = None
) -> Iterator[RawLog]:
    """Read the channels that the robot file knows, in blocks of about `rows`, or as one.

    All streams share their stamps; nulls and NaN stay missing. The first block tells
    what was noticed of the file. A file of several episodes is one block.
    """
    plan = make_plan(file, robot)
    wanted: list[str | None] = [plan.time.name, plan.time.nanoseconds]
    wanted += [name for row in plan.joints.values() for name in row]
    wanted += [name for pair in plan.imus.values() for row in pair for name in row]
    columns = list(
        dict.fromkeys(name for name in (*wanted, plan.episode) if name is not None)
    )
    for name in columns:
        if (count := file.names.count(name)) > 1:
            message = f"column {name!r} is there {count} times"
            raise InputError(
                message, hint="Give each column a name of its own.", where=file.where
            )
    notes = [*file.notes, *plan.warnings]
    for table, partial in file.tables(columns, None if plan.episode else rows):
        yield _raw_log(file.where, table, plan, robot, partial, notes)
        notes = []


def _raw_log(
    where: str,
    table: pa.Table,
    plan: Plan,
    robot: Robot,
    partial: str,
    notes: list[str],
) -> RawLog:
    stamps, keep, warnings = read_stamps(where, table, plan.time)
    if plan.episode is not None:
        episode = numbers(where, table, plan.episode)
        stamps, keep, more = separate(stamps, keep, episode, plan.episode)
        warnings += more
    channels = {
        quantity: _columns(where, table, row) for quantity, row in plan.joints.items()
    }
    joints = Stream(ROWS, stamps, in_si(channels, stamps, robot))
    if plan.episode is not None or len(keep) < len(stamps):
        joints = joints.take(keep)
    imus: dict[str, tuple[Stream, ...]] = {}
    for imu, columns in plan.imus.items():
        pairs = zip((ACCELEROMETERS, GYRO), columns, strict=True)
        channels = {name: _columns(where, table, row) for name, row in pairs if row}
        imus[imu] = (Stream(ROWS, stamps, channels).take(keep),)
    prefer_current = (
        robot.channels.current is not None and robot.channels.torque is None
    )
    return RawLog(
        joints, imus, partial, (*notes, *warnings), prefer_current=prefer_current
    )


def make_plan(file: TableFile, robot: Robot) -> Plan:
    """Decide which columns to read: what the robot file declares, else what the names tell."""
    known, joints = set(file.names), robot.joint_names
    match = schemes.find_scheme(joints, known, file.entries)
    if match is None and robot.channels.position is None:
        raise missing_columns(
            file.where, schemes.nearest_scheme(joints, known), file.names
        )
    warnings: list[str] = []
    columns = _joint_columns(file, robot, match)
    found = {
        imu.name: imu_columns(file.where, robot, imu, known, warnings)
        for imu in robot.imus
    }
    imus = {name: pair for name, pair in found.items() if pair is not None}
    left = known.difference(*columns.values())
    episode = next((name for name in schemes.EPISODES if name in left), None)
    return Plan(
        _time_column(file, robot.channels, match), columns, imus, episode, warnings
    )


def _joint_columns(
    file: TableFile, robot: Robot, match: schemes.Match | None
) -> dict[str, list[str | None]]:
    known, names = set(file.names), robot.joint_names
    found = (
        schemes.find_quantities(names, known) if match is None else dict(match.columns)
    )
    effort = found.pop(schemes.EFFORT, None)
    if effort is not None:
        found.setdefault(
            "current" if robot.channels.effort == "current" else "torque", effort
        )
    for quantity in schemes.QUANTITIES:
        pattern: Columns | None = getattr(robot.channels, quantity)
        if pattern is not None:
            declared = [
                schemes.column_name(pattern, name, i) for i, name in enumerate(names)
            ]
            if missing := [name for name in declared if name not in known]:
                raise missing_columns(file.where, missing, file.names)
            found[quantity] = [*declared]
    return {
        quantity: found[quantity]
        for quantity in schemes.QUANTITIES
        if quantity in found
    }


def _time_column(
    file: TableFile, channels: Channels, match: schemes.Match | None
) -> TimeColumn:
    names, unit = file.names, match.time_unit if match is not None else None
    told = schemes.time_names(names)
    if "t" in told and channels.time is None:
        return TimeColumn("t", unit)
    candidates = list(told) if channels.time is None else [str(channels.time)]
    if len(candidates) > 1:
        message = f"the time column is ambiguous: {' or '.join(candidates)}"
        hint = 'Say which in the robot file: [channels] time = "..."'
        raise InputError(message, hint=hint, where=file.where)
    parts = schemes.stamp_parts(names)
    if not candidates and parts is not None:
        return TimeColumn(parts[0], "s", True, nanoseconds=parts[1])
    own = candidates[0] if candidates else "t"
    if own not in names:
        raise missing_columns(file.where, [own], names, what="[channels] time")
    said = told.get(own)
    return TimeColumn(own, said or unit, said is not None)


def missing_columns(
    where: str,
    missing: Sequence[str],
    names: Sequence[str],
    *,
    what: str = "[channels] position",
) -> InputError:
    """Make the error for columns that a log lacks; it names the nearest ones that are there."""
    names = list(dict.fromkeys(names))
    if nameless(names):
        text = f"has no line of names: its columns are numbered 1 to {len(names)}"
        hint = (
            "Say in the robot file which is which: [channels] time = 1, position = [2,"
            " 3], "
        )
        hint += (
            "current = [4, 5]; or write a first line such as time,q1,q2,i1,i2 into the"
            " file."
        )
        return InputError(text, hint=hint, where=where)
    close = [
        difflib.get_close_matches(name, names, n=3, cutoff=0.4) for name in missing[:3]
    ]
    nearest = list(dict.fromkeys(match for matches in close for match in matches))
    listed = nearest or names[:12]
    more = "" if len(missing) <= _SHOWN else f" and {len(missing) - _SHOWN} more"
    text = f"no column {', '.join(repr(name) for name in missing[:_SHOWN])}{more}; "
    text += (
        f"{'nearest' if nearest else 'there are'}:"
        f" {', '.join(listed) or 'no columns at all'}"
    )
    hint = (
        "Joint names come from the robot file; where the log uses other column names, "
    )
    return InputError(text, hint=f'{hint}give them there: {what} = "..."', where=where)


def _columns(where: str, table: pa.Table, row: Sequence[str | None]) -> Array:
    empty = np.full(table.num_rows, np.nan)
    columns = [empty if name is None else numbers(where, table, name) for name in row]
    return np.stack(columns).T  # one column after the other, as they came
