"""Parquet logs: one row per sample, only the needed columns are read."""

from __future__ import annotations

import difflib
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc
import pyarrow.parquet as pq

from seqid_cli.errors import InputError
from seqid_cli.logs.raw import (
    ACCELEROMETERS,
    GYRO,
    STAMP_LIMIT_NS,
    Array,
    RawLog,
    Rows,
    Stamps,
    Stream,
    TimeSource,
)
from seqid_cli.robot.types import Channels, Imu, Robot

QUANTITIES = ("position", "velocity", "torque", "current", "temperature")
ROWS = "the rows"
TIME_NAMES = ("time", "timestamp")

# UR RTDE recordings (one column per joint) need no [channels].
_RTDE = Channels(
    position="actual_q_{index0}",
    velocity="actual_qd_{index0}",
    current="actual_current_{index0}",
    temperature="joint_temperatures_{index0}",
)
_PRESETS = (_RTDE,)
_NS_PER = {"s": 1_000_000_000, "ms": 1_000_000, "us": 1_000, "ns": 1}
# An epoch time of this size cannot be seconds: the largest that it can be in each unit.
_EPOCH = (("ns", 1e17), ("us", 1e14), ("ms", 1e11))
_ARROW_ERRORS = (pa.ArrowException, OSError, ValueError, KeyError, MemoryError, OverflowError)


@dataclass(frozen=True)
class _Plan:
    """Which column carries what."""

    time: str
    joints: dict[str, list[str | None]]  # quantity -> column per joint
    imus: dict[str, tuple[list[str], list[str]]]  # IMU -> accelerometer and gyro columns

    @property
    def columns(self) -> list[str]:
        names = [self.time]
        names += [name for row in self.joints.values() for name in row if name is not None]
        names += [name for pair in self.imus.values() for row in pair for name in row]
        return list(dict.fromkeys(names))


def read(path: Path, robot: Robot, time_source: TimeSource = "header") -> RawLog:
    """Read a Parquet log.

    Parameters
    ----------
    path : Path
        The file.
    robot : Robot
        Its joints, IMUs and `[channels]` say which columns are read.
    time_source : {"header", "log"}
        Without meaning here: a row has one time.

    Returns
    -------
    RawLog
        All streams share the stamps of the rows; nulls and NaN stay missing.

    Raises
    ------
    InputError
        Damaged file, missing column, or a column that is no number.
    """
    del time_source
    names = column_names(path)
    plan = _plan(path, robot, names)
    _require_once(path, plan.columns, names)
    table = _load(path, plan.columns)
    stamps, keep, warnings = _stamps(path, table, plan.time)
    channels = {
        quantity: np.column_stack(
            [
                np.full(len(keep), np.nan) if name is None else _numbers(path, table, name)
                for name in row
            ]
        )
        for quantity, row in plan.joints.items()
    }
    joints = Stream(ROWS, stamps, channels).take(keep)
    imus: dict[str, tuple[Stream, ...]] = {
        imu: (_imu_stream(path, table, stamps, columns).take(keep),)
        for imu, columns in plan.imus.items()
    }
    prefer_current = robot.channels.current is not None and robot.channels.torque is None
    return RawLog(joints, imus, warnings=tuple(warnings), prefer_current=prefer_current)


def column_names(path: Path) -> list[str]:
    """List the columns of a Parquet file, nested ones as `parent.child`.

    Raises
    ------
    InputError
        The file is damaged.
    """
    try:
        with pq.ParquetFile(path) as file:
            return [file.schema.column(i).path for i in range(len(file.schema))]
    except _ARROW_ERRORS as error:
        raise _damaged(path, error) from error


def list_columns(path: Path) -> list[tuple[str, str, int]]:
    """List name, type and number of rows of each column.

    Raises
    ------
    InputError
        The file is damaged.
    """
    try:
        with pq.ParquetFile(path) as file:
            rows = file.metadata.num_rows
            columns = [file.schema.column(i) for i in range(len(file.schema))]
            return [(column.path, column.physical_type.lower(), rows) for column in columns]
    except _ARROW_ERRORS as error:
        raise _damaged(path, error) from error


def _load(path: Path, columns: list[str]) -> pa.Table:
    try:
        with pq.ParquetFile(path, page_checksum_verification=True) as file:
            table = file.read(columns=columns)
            while any(pa.types.is_struct(kind) for kind in table.schema.types):
                table = table.flatten()
    except _ARROW_ERRORS as error:
        raise _damaged(path, error) from error
    return table


def _damaged(path: Path, error: BaseException) -> InputError:
    reason = " ".join(str(error).split())[:200] or type(error).__name__
    return InputError(
        f"the Parquet file is damaged or not readable ({reason})",
        hint="Copy it again from the source, or leave this log out.",
        where=str(path),
    )


def _plan(path: Path, robot: Robot, names: list[str]) -> _Plan:
    known = set(names)
    channels, declared = _channels(robot, known)
    joints: dict[str, list[str | None]] = {}
    for quantity in QUANTITIES:
        pattern: str | None = getattr(channels, quantity)
        columns = [
            column_name(pattern or f"{{name}}.{quantity}", joint.name, i)
            for i, joint in enumerate(robot.joints)
        ]
        missing = [name for name in columns if name not in known]
        required = quantity == "position" or (declared and pattern is not None)
        if missing and required:
            raise _missing(path, missing, names)
        if len(missing) < len(columns):
            joints[quantity] = [name if name in known else None for name in columns]
    imus = {}
    for imu in robot.imus:
        columns_of_imu = _imu_columns(path, imu, known)
        if columns_of_imu is not None:
            imus[imu.name] = columns_of_imu
    return _Plan(_time_column(path, channels, names), joints, imus)


def column_name(pattern: str, joint: str, index0: int) -> str:
    """Fill a `[channels]` pattern: {name}, {index} (from 1), {index0} (from 0)."""
    filled = pattern.replace("{index0}", str(index0)).replace("{index}", str(index0 + 1))
    return filled.replace("{name}", joint)


def _channels(robot: Robot, known: set[str]) -> tuple[Channels, bool]:
    """Return the names to look for, and whether the robot file itself declares them."""
    first = robot.joint_names[0]
    if robot.channels.position is None and f"{first}.position" not in known:
        for preset in _PRESETS:
            if column_name(preset.position or "", first, 0) in known:
                return preset, False
    return robot.channels, True


def _time_column(path: Path, channels: Channels, names: list[str]) -> str:
    if channels.time is not None:
        if channels.time not in names:
            raise _missing(path, [channels.time], names)
        return channels.time
    if "t" in names:
        return "t"
    candidates = [name for name in TIME_NAMES if name in names]
    if len(candidates) == 1:
        return candidates[0]
    if candidates:
        raise InputError(
            f"the time column is ambiguous: {' or '.join(candidates)}",
            hint='Say which in the robot file: [channels] time = "..."',
            where=str(path),
        )
    raise _missing(path, ["t"], names)


def _imu_columns(path: Path, imu: Imu, known: set[str]) -> tuple[list[str], list[str]] | None:
    count = len(imu.positions)
    numbered = [f"{imu.name}.a{k + 1}" for k in range(count)]
    triad = [f"{imu.name}.a{axis}" for axis in "xyz"]
    use_triad = count == 3 and not known.intersection(numbered)
    accelerometers = triad if use_triad else numbered
    gyro = [f"{imu.name}.g{axis}" for axis in "xyz"] if imu.gyro else []
    missing = [name for name in accelerometers + gyro if name not in known]
    if len(missing) == len(accelerometers) + len(gyro):
        return None
    if missing:
        raise InputError(
            f"IMU {imu.name!r} is only partly in the log; missing: {', '.join(missing)}",
            hint=f"The robot file gives it {count} accelerometers"
            f"{' and a gyro' if imu.gyro else ''}: log them all, or correct the robot file.",
            where=str(path),
        )
    return accelerometers, gyro


def _imu_stream(
    path: Path, table: pa.Table, stamps: Stamps, columns: tuple[list[str], list[str]]
) -> Stream:
    channels = {
        quantity: np.column_stack([_numbers(path, table, name) for name in names])
        for quantity, names in zip((ACCELEROMETERS, GYRO), columns, strict=True)
        if names
    }
    return Stream(ROWS, stamps, channels)


def _missing(path: Path, missing: Sequence[str], names: list[str]) -> InputError:
    close = [difflib.get_close_matches(name, names, n=3, cutoff=0.4) for name in missing[:3]]
    nearest = list(dict.fromkeys(match for matches in close for match in matches))
    listed = nearest or names[:12]
    more = "" if len(missing) <= 6 else f" and {len(missing) - 6} more"
    return InputError(
        f"no column {', '.join(repr(name) for name in missing[:6])}{more}; "
        f"{'nearest' if nearest else 'there are'}: {', '.join(listed) or 'no columns at all'}",
        hint="Joint names come from the robot file; where the log uses other column names, "
        'give them there: [channels] position = "..."',
        where=str(path),
    )


def _require_once(path: Path, columns: list[str], names: list[str]) -> None:
    for name in columns:
        if names.count(name) > 1:
            raise InputError(
                f"column {name!r} is there {names.count(name)} times",
                hint="Give each column a name of its own.",
                where=str(path),
            )


def _column(path: Path, table: pa.Table, name: str) -> pa.ChunkedArray:
    if table.schema.names.count(name) != 1:
        raise InputError(
            f"column {name!r} is not a plain column",
            hint="Write one number per row and column.",
            where=str(path),
        )
    column = table.column(name)
    if pa.types.is_dictionary(column.type):
        column = pc.cast(column, column.type.value_type)
    return column


def _numbers(path: Path, table: pa.Table, name: str) -> Array:
    """Read a column as float64; nulls become NaN."""
    try:
        column = _column(path, table, name)
        if not _is_number(column.type):
            raise InputError(
                f"column {name!r} holds {column.type}, not numbers",
                hint="Write it as float64 in SI units.",
                where=str(path),
            )
        values: Array = pc.cast(column, pa.float64(), safe=False).to_numpy()
    except _ARROW_ERRORS as error:
        raise _damaged(path, error) from error
    return values


def _is_number(kind: pa.DataType) -> bool:
    return bool(
        pa.types.is_integer(kind)
        or pa.types.is_floating(kind)
        or pa.types.is_decimal(kind)
        or pa.types.is_null(kind)
    )


def _stamps(path: Path, table: pa.Table, name: str) -> tuple[Stamps, Rows, list[str]]:
    """Return stamps [ns] (0 where missing), the rows that have one, and warnings."""
    kind = _column(path, table, name).type
    timed = (pa.types.is_timestamp, pa.types.is_duration, pa.types.is_time)
    warnings: list[str] = []
    if any(check(kind) for check in timed):
        seconds, rest = _from_timestamps(path, table, name, _NS_PER[kind.unit])
    else:
        values = _numbers(path, table, name)
        unit = _unit(values)
        if unit != "s":
            warnings.append(f"column {name!r} is too large for seconds: read as {unit}")
        seconds, rest = _split(values, _NS_PER[unit])
        warnings += _resolution(name, kind, values)
    good = np.isfinite(seconds) & (np.abs(seconds) < STAMP_LIMIT_NS / 1e9)
    lost = int(np.count_nonzero(~good))
    if lost:
        warnings.append(f"{lost} rows without a usable time in column {name!r} were left out")
    stamps = np.where(good, seconds, 0).astype(np.int64) * 1_000_000_000
    return stamps + np.where(good, rest, 0).astype(np.int64), np.flatnonzero(good), warnings


def _from_timestamps(
    path: Path, table: pa.Table, name: str, ns_per_unit: int
) -> tuple[Array, Array]:
    try:
        column = _column(path, table, name)
        missing = pc.is_null(column).to_numpy()
        bits = pa.int32() if column.type.bit_width == 32 else pa.int64()
        counts = pc.fill_null(pc.cast(pc.cast(column, bits), pa.int64()), 0).to_numpy()
    except _ARROW_ERRORS as error:
        raise _damaged(path, error) from error
    per_second = 1_000_000_000 // ns_per_unit
    seconds = np.where(missing, np.nan, (counts // per_second).astype(np.float64))
    return seconds, ((counts % per_second) * ns_per_unit).astype(np.float64)


def _unit(values: Array) -> str:
    finite = values[np.isfinite(values)]
    middle = float(np.median(np.abs(finite))) if len(finite) else 0.0
    return next((unit for unit, least in _EPOCH if middle > least), "s")


def _split(values: Array, ns_per_unit: int) -> tuple[Array, Array]:
    """Split into whole seconds and nanoseconds, so that no digit of an epoch time is lost."""
    per_second = 1_000_000_000 // ns_per_unit
    with np.errstate(invalid="ignore", over="ignore"):
        seconds = np.floor(values / per_second)
        rest: Array = np.rint((values - seconds * per_second) * ns_per_unit)
    return seconds, rest


def _resolution(name: str, kind: pa.DataType, values: Array) -> list[str]:
    finite = values[np.isfinite(values)]
    if not (pa.types.is_float32(kind) or pa.types.is_float16(kind)) or len(finite) < 2:
        return []
    dtype = np.float32 if pa.types.is_float32(kind) else np.float16
    step = float(np.spacing(dtype(np.abs(finite).max())))
    interval = float(finite.max() - finite.min()) / (len(finite) - 1)
    if step <= 1e-3 * interval:
        return []
    return [
        f"column {name!r} is {kind} and cannot resolve less than {step:.3g} s at the end of the "
        f"log ({interval:.3g} s between samples): write time as float64 or timestamp"
    ]
