"""Tables, one row per sample: which column carries what, whatever file they come from.

A column is the one that the robot file declares under `[channels]`, else what its name
tells (`naming_schemes`). M is the number of rows.
"""

import difflib
import re
from abc import abstractmethod
from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np
import pyarrow as pa

from seqid_cli.errors import InputError
from seqid_cli.logs.drives import in_si
from seqid_cli.logs.raw import ACCELEROMETERS, GYRO, OTHER_NAMES, RawLog, Stream
from seqid_cli.logs.tables import naming_schemes as schemes
from seqid_cli.logs.tables.columns import TimeColumn, numbers, read_stamps
from seqid_cli.logs.tables.csv_form import nameless
from seqid_cli.logs.tables.episodes import separate
from seqid_cli.logs.tables.imu_columns import ImuColumns, imu_columns
from seqid_cli.logs.tables.name_words import EFFORT, QUANTITIES
from seqid_cli.robot.toml_schema import Channels, Columns, column_name
from seqid_cli.robot.types import Robot
from seqid_cli.typing import Array

ROWS = "the rows"  # the name of a table's streams, for messages
_TIME_KEY = "[channels] time"
# No arm has so many; a table of a log that lies on its side has thousands.
_MOST_CHANNELS = 400
_SHOWN = 6  # missing columns that a message lists
_ELEMENT = re.compile(r"(?P<list>.+)\[(?P<index>[0-9]+)\]")


@dataclass(frozen=True, kw_only=True)
class TableFile:
    """An opened file that holds a table."""

    path: Path
    names: tuple[str, ...]  # elements of list columns as `column[k]`
    # place in lists of each joint that the file names
    entries: Mapping[str, int] = field(default_factory=dict)
    # likewise in lists of commands; None: as in the others
    command_entries: Mapping[str, int] | None = None
    named: bool = False  # whether rows name the joints, which must be the robot's then
    notes: tuple[str, ...] = ()  # what was noticed

    @property
    def where(self) -> str:
        """The file, for messages."""
        return str(self.path)

    def column(self, name: str) -> str:
        """Return the name of a column that the robot file gives by name or number."""
        if name not in self.names and re.fullmatch("[1-9][0-9]{0,4}", name):
            place = int(name) - 1
            return self.names[place] if place < len(self.names) else name
        return name

    @abstractmethod
    def tables(
        self, columns: Sequence[str], rows: int | None
    ) -> Iterator[tuple[pa.Table, str]]:
        """Read columns, at most `rows` rows at a time; says what was lost."""


@dataclass(frozen=True, kw_only=True)
class Plan:
    """The column that carries each quantity."""

    time: TimeColumn
    joints: dict[str, list[str | None]]  # per quantity one for each joint
    imus: dict[str, ImuColumns]
    episode: str | None
    warnings: list[str]

    @property
    def columns(self) -> list[str]:
        """All columns to be read, each once."""
        names: list[str | None] = [self.time.nanoseconds]
        if self.time.rate_hz is None:
            names.insert(0, self.time.name)
        for joint_columns in self.joints.values():
            names += joint_columns
        for imu in self.imus.values():
            names += imu.accelerometers
            names += imu.gyro
        names.append(self.episode)
        return list(dict.fromkeys(name for name in names if name is not None))


def elements_in(
    columns: Sequence[str], lists: Collection[str]
) -> dict[str, tuple[str, int]]:
    """Return the list column and the place in it of names such as `column[k]`."""
    element_of = {}
    for name in columns:
        match = _ELEMENT.fullmatch(name)
        if match is not None and match["list"] in lists:
            element_of[name] = (match["list"], int(match["index"]))
    return element_of


def read_table(
    file: TableFile, robot: Robot, rows: int | None = None
) -> Iterator[RawLog]:
    """Read the channels that the robot file knows, block by block.

    Parameters
    ----------
    file : TableFile
        An opened table.
    robot : Robot
        Names of joints, channels and IMUs.
    rows : int, optional
        Rows in a block, about; None for one block. A file of several episodes is one
        block.

    Yields
    ------
    RawLog
        All streams share their stamps; nulls and NaN stay missing. The first block
        tells what was noticed of the file.

    Raises
    ------
    InputError
        A column is missing, is there twice or holds no numbers.
    """
    plan = make_plan(file, robot)
    columns = plan.columns
    for name in columns:
        count = file.names.count(name)
        if count > 1:
            raise InputError(
                f"column {name!r} is there {count} times",
                hint="Give each column a name of its own.",
                where=file.where,
            )

    notes = [*file.notes, *plan.warnings]
    rows_in_block = None if plan.episode else rows
    n_rows = 0
    for table, lost in file.tables(columns, rows_in_block):
        raw = _raw_log(file.where, table, plan, robot, n_rows)
        n_rows += table.num_rows
        yield replace(raw, partial=lost, warnings=(*notes, *raw.warnings))
        notes = []


def _raw_log(
    where: str, table: pa.Table, plan: Plan, robot: Robot, first_row: int
) -> RawLog:
    """Turn the columns of a table, from a row of its file on, into streams."""
    stamps, rows, warnings = read_stamps(where, table, plan.time, first_row)
    if plan.episode is not None:
        episode = numbers(where, table, plan.episode)
        stretches = separate(stamps, rows, episode, plan.episode)
        stamps = stretches.stamps
        rows = stretches.rows
        warnings += stretches.notes

    channels = {
        quantity: _matrix(where, table, columns)
        for quantity, columns in plan.joints.items()
    }
    joints = Stream(ROWS, stamps, in_si(channels, stamps, robot))
    # Nothing is copied where every row counts.
    if plan.episode is not None or len(rows) < len(stamps):
        joints = joints.take(rows)

    imus: dict[str, tuple[Stream, ...]] = {}
    for name, columns in plan.imus.items():
        readings: dict[str, Array] = {}
        if columns.accelerometers:
            readings[ACCELEROMETERS] = _matrix(where, table, columns.accelerometers)
        if columns.gyro:
            readings[GYRO] = _matrix(where, table, columns.gyro)
        imus[name] = (Stream(ROWS, stamps, readings).take(rows),)

    declares_current = robot.channels.current is not None
    declares_torque = robot.channels.torque is not None
    return RawLog(
        joints,
        imus,
        warnings=tuple(warnings),
        prefer_current=declares_current and not declares_torque,
    )


def _matrix(where: str, table: pa.Table, columns: Sequence[str | None]) -> Array:
    """Read columns as (M, w), each together in memory; NaN where there is none."""
    missing = np.full(table.num_rows, np.nan)
    values = [
        missing if name is None else numbers(where, table, name) for name in columns
    ]
    return np.stack(values).T


def make_plan(file: TableFile, robot: Robot) -> Plan:
    """Decide which columns to read: what the robot file declares, else what names tell.

    Raises InputError where positions or a declared column are missing, or where time is
    ambiguous.
    """
    log_columns = set(file.names)
    joints = robot.log_names
    match = schemes.find_scheme(joints, log_columns, file.entries, file.command_entries)
    if match is None and robot.channels.position is None:
        if file.named:
            raise other_joints(file.where, joints, list(file.entries))
        nearest = schemes.nearest_scheme(joints, log_columns)
        raise missing_columns(file.where, nearest, file.names)

    warnings: list[str] = []
    joint_columns = _joint_columns(file, robot, match)
    imus: dict[str, ImuColumns] = {}
    for imu in robot.imus:
        columns = imu_columns(file.where, robot, imu, log_columns, warnings)
        if columns is not None:
            imus[imu.name] = columns

    free = log_columns.difference(*joint_columns.values())
    return Plan(
        time=_time_column(file, robot.channels, match),
        joints=joint_columns,
        imus=imus,
        episode=next((name for name in schemes.EPISODES if name in free), None),
        warnings=warnings,
    )


def _joint_columns(
    file: TableFile, robot: Robot, match: schemes.Match | None
) -> dict[str, list[str | None]]:
    """Return the columns of the joints by quantity: declared ones before found ones."""
    log_columns = set(file.names)
    joints = robot.log_names
    columns = (
        schemes.find_quantities(joints, log_columns)
        if match is None
        else dict(match.columns)
    )
    effort = columns.pop(EFFORT, None)
    if effort is not None:
        is_current = robot.channels.effort_is_current
        columns.setdefault("current" if is_current else "torque", effort)

    for quantity in QUANTITIES:
        pattern: Columns | None = getattr(robot.channels, quantity)
        if pattern is None:
            continue
        declared = [
            file.column(column_name(pattern, name, k)) for k, name in enumerate(joints)
        ]
        missing = [name for name in declared if name not in log_columns]
        if missing:
            raise missing_columns(file.where, missing, file.names)
        columns[quantity] = [*declared]
    # Commands may stand in front of the joint beside columns of another form.
    commands = [f"command.{name}" for name in joints]
    if "command" not in columns and log_columns.issuperset(commands):
        columns["command"] = [*commands]
    # Files of one quantity each may all have the names of the positions' columns.
    for quantity in QUANTITIES:
        alike = [f"{quantity}.{name}" for name in columns.get("position", ())]
        if quantity not in columns and alike and log_columns.issuperset(alike):
            columns[quantity] = [*alike]
    return {name: columns[name] for name in QUANTITIES if name in columns}


def _time_column(
    file: TableFile, channels: Channels, match: schemes.Match | None
) -> TimeColumn:
    """Choose the column of time: the declared one, `t`, or the only one named so.

    A declared unit counts more than what name or format say.
    """
    if channels.rate is not None:
        return TimeColumn("", rate_hz=channels.rate)
    unit_of_format = match.time_unit if match is not None else None
    unit_by_name = schemes.time_names(file.names)
    if channels.time is None and "t" in unit_by_name:
        declared_unit = channels.time_unit
        return TimeColumn(
            "t", declared_unit or unit_of_format, sure=declared_unit is not None
        )

    candidates = list(unit_by_name)
    if channels.time is not None:
        candidates = [file.column(str(channels.time))]
    elif match is not None and match.time in file.names:
        candidates = [match.time]
    if len(candidates) > 1:
        raise InputError(
            f"the time column is ambiguous: {' or '.join(candidates)}",
            hint='Say which in the robot file: [channels] time = "..."',
            where=file.where,
        )

    parts = schemes.stamp_parts(file.names)
    if parts is not None and candidates in ([], [parts[0]]):
        seconds, nanoseconds = parts
        return TimeColumn(seconds, "s", sure=True, nanoseconds=nanoseconds)

    name = candidates[0] if candidates else "t"
    if name not in file.names:
        if channels.time is not None:
            raise missing_columns(file.where, [name], file.names, what=_TIME_KEY)
        raise InputError(
            f"no column of the time; there are: {', '.join(file.names[:12])}",
            hint=f'Say which it is in the robot file: {_TIME_KEY} = "...". Where there'
            " is none: [channels] rate = 200 (Hz), which seqid init --rate 200 writes.",
            where=file.where,
        )
    unit = channels.time_unit or unit_by_name.get(name)
    return TimeColumn(name, unit or unit_of_format, sure=unit is not None)


def other_joints(
    where: str, wanted: Sequence[str], logged: Sequence[str]
) -> InputError:
    """Make the error for a log of joints that are not those of the robot file."""
    lacking = [name for name in wanted if name not in logged] or list(wanted)
    return InputError(
        f"no joint {', '.join(lacking[:_SHOWN])}; names in the log:"
        f" {', '.join(logged[:12])}",
        hint=OTHER_NAMES,
        where=where,
    )


def missing_columns(
    where: str,
    missing: Sequence[str],
    names: Sequence[str],
    *,
    what: str = "[channels] position",
) -> InputError:
    """Make the error for columns that a log lacks; it names the nearest that are there.

    Parameters
    ----------
    where : str
        The log.
    missing, names : sequence of str
        Columns that it lacks, and those that it has.
    what : str
        The key of the robot file that can name another column.
    """
    names = list(dict.fromkeys(names))
    if nameless(names) and len(names) > _MOST_CHANNELS:
        return InputError(
            f"has no line of names, but {len(names)} columns: samples seem to lie side"
            " by side",
            hint="Turn the table: one line per sample. In Python:"
            " numpy.savetxt('log.csv', numpy.loadtxt('table.csv', delimiter=',').T,"
            " delimiter=',')",
            where=where,
        )
    if nameless(names):
        return InputError(
            f"has no line of names: its columns are numbered 1 to {len(names)}",
            hint="Say in the robot file which is which: [channels] time = 1, position ="
            " [2, 3], current = [4, 5]; or write a first line such as time,q1,q2,i1,i2"
            " into the file.",
            where=where,
        )

    nearest: dict[str, None] = {}
    for name in missing[:3]:
        close = difflib.get_close_matches(name, names, n=3, cutoff=0.4)
        nearest.update(dict.fromkeys(close))
    listed = list(nearest) or names[:12]
    introduction = "nearest" if nearest else "there are"

    lacking = ", ".join(repr(name) for name in missing[:_SHOWN])
    if len(missing) > _SHOWN:
        lacking += f" and {len(missing) - _SHOWN} more"
    return InputError(
        f"no column {lacking}; {introduction}:"
        f" {', '.join(listed) or 'no columns at all'}",
        hint="Joint names come from the robot file; where the log uses other column"
        f' names, give them there: {what} = "..."',
        where=where,
    )
