"""Columns of a table as numbers, and its time column as integer nanoseconds."""

import os
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import BinaryIO

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc
import pyarrow.parquet as pq

from seqid_cli.errors import InputError
from seqid_cli.logs.raw import STAMP_LIMIT_NS, Array, Mask, Rows, Stamps

ARROW_ERRORS = (
    pa.ArrowException,
    OSError,
    ValueError,
    KeyError,
    MemoryError,
    OverflowError,
)
# bytes in memory of any table; of one byte of a larger one
ROOM, MOST_TIMES = 256 << 20, 500
_NUMBERS = (
    pa.types.is_integer,
    pa.types.is_floating,
    pa.types.is_decimal,
    pa.types.is_null,
)
_TEXTS = (
    pa.types.is_string, pa.types.is_large_string, pa.types.is_binary, pa.types.is_large_binary,
)  # fmt: skip
_TIMED = (pa.types.is_timestamp, pa.types.is_duration, pa.types.is_time)
_HINT = "Write it as float64 in SI units; time also as a timestamp."
NS_PER = {"s": 1_000_000_000, "ms": 1_000_000, "us": 1_000, "ns": 1}
# An epoch time of this size cannot be seconds: the largest that it can be in each unit.
_EPOCH = (("ns", 1e17), ("us", 1e14), ("ms", 1e11))


@dataclass(frozen=True)
class TimeColumn:
    """Where time stands: one column, or whole seconds and the nanoseconds beside them."""

    name: str
    # by name or format; None: only the size of the numbers tells
    unit: str | None = None
    sure: bool = False  # whether it stands with the name
    nanoseconds: str | None = None


def column(table: pa.Table, name: str) -> pa.ChunkedArray:
    """Return a column, dictionaries resolved."""
    found = table.column(name)
    dictionary = pa.types.is_dictionary(found.type)
    return pc.cast(found, found.type.value_type) if dictionary else found


def numbers(where: str, table: pa.Table, name: str) -> Array:
    """Read a column as float64 (M,); nulls become NaN."""
    with _explained(where, name):
        found = column(table, name)
        if not is_number(found.type):
            message = f"column {name!r} holds {found.type}, not numbers"
            raise InputError(message, hint=_HINT, where=where)
        values: Array = pc.cast(found, pa.float64(), safe=False).to_numpy()
    return values


@contextmanager
def _explained(where: str, name: str) -> Iterator[None]:
    """Turn what Arrow says of a column into a message."""
    try:
        yield
    except MemoryError:
        raise  # which is no fault of the column
    except ARROW_ERRORS as error:
        message = (
            f"column {name!r} cannot be read ({' '.join(str(error).split())[:200]})"
        )
        raise InputError(message, hint=_HINT, where=where) from error


def is_number(kind: pa.DataType) -> bool:
    """Tell whether a column of this type can be read as numbers."""
    return any(is_kind(kind) for is_kind in _NUMBERS)


def is_text(kind: pa.DataType) -> bool:
    """Tell whether a column of this type holds texts, or bytes."""
    kind = kind.value_type if pa.types.is_dictionary(kind) else kind
    return any(is_kind(kind) for is_kind in _TEXTS)


def read_stamps(
    where: str, table: pa.Table, time: TimeColumn
) -> tuple[Stamps, Rows, list[str]]:
    """Read the stamps [ns] (M,) of the rows, 0 where missing; the rows that have one; warnings."""
    warnings: list[str] = []
    with _explained(where, time.name):
        kind = column(table, time.name).type
    if any(is_timed(kind) for is_timed in _TIMED):
        stamps, good = _from_counts(where, table, time.name, NS_PER[kind.unit])
    elif time.nanoseconds is not None:
        rest = numbers(where, table, time.nanoseconds)
        stamps, good = _from_values(numbers(where, table, time.name), NS_PER["s"])
        good &= (rest >= 0) & (rest < NS_PER["s"])
        stamps += np.where(good, rest, 0).astype(np.int64)
    else:
        values = numbers(where, table, time.name)
        unit = _unit(values, time, warnings)
        if pa.types.is_integer(kind) and not pa.types.is_uint64(kind):
            stamps, good = _from_counts(where, table, time.name, NS_PER[unit])
        else:
            warnings += _resolution(
                time.name, kind, values / (NS_PER["s"] / NS_PER[unit])
            )
            stamps, good = _from_values(values, NS_PER[unit])
    if lost := int(np.count_nonzero(~good)):
        warnings.append(
            f"{lost} rows without a usable time in column {time.name!r} were left out"
        )
    return np.where(good, stamps, 0), np.flatnonzero(good), warnings


def _unit(
    values: Array, time: TimeColumn, warnings: list[str], *, fastest_s: float = 5e-05
) -> str:
    """Return the unit: what the name says, or the format, or else the size of the numbers."""
    if time.unit is not None and time.sure:
        return time.unit
    finite = values[np.isfinite(values)]
    middle = float(np.median(np.abs(finite))) if len(finite) else 0.0
    steps = np.diff(finite)
    step = float(np.median(steps[steps > 0])) if (steps > 0).any() else np.inf
    if time.unit is not None and time.unit != "s":
        if step * NS_PER[time.unit] * 1e-9 >= fastest_s:
            return time.unit
        form = f"column {time.name!r} is in {time.unit} by its format"
        warnings.append(f"{form}, but steps by {step:.3g}: read as s")
        return "s"
    unit = next((unit for unit, least in _EPOCH if middle > least), "s")
    if unit != "s":
        warnings.append(
            f"column {time.name!r} is too large for seconds: read as {unit}"
        )
    return unit


def _from_counts(
    where: str, table: pa.Table, name: str, ns_per_unit: int
) -> tuple[Stamps, Mask]:
    """Stamps [ns] (M,) by integer counts of a unit, exactly, and which of them are usable."""
    with _explained(where, name):
        found = column(table, name)
        missing = pc.is_null(found).to_numpy()
        if not pa.types.is_integer(found.type):
            found = pc.cast(
                found, pa.int32() if found.type.bit_width == 32 else pa.int64()
            )
        counts = pc.fill_null(pc.cast(found, pa.int64()), 0).to_numpy()
    limit = STAMP_LIMIT_NS // ns_per_unit
    good = ~missing & (counts > -limit) & (counts < limit)
    return np.where(good, counts, 0) * ns_per_unit, good


def _from_values(values: Array, ns_per_unit: int) -> tuple[Stamps, Mask]:
    """As `_from_counts`, by floating-point values; no digit of an epoch time is lost."""
    good = np.isfinite(values) & (np.abs(values) < STAMP_LIMIT_NS / ns_per_unit)
    kept = np.where(good, values, 0.0)
    whole = np.floor(kept)
    rest = np.rint((kept - whole) * ns_per_unit)
    return whole.astype(np.int64) * ns_per_unit + rest.astype(np.int64), good


def _resolution(name: str, kind: pa.DataType, values: Array) -> list[str]:
    """Warn of floating-point times [s] too coarse for the interval between samples."""
    finite = values[np.isfinite(values)]
    if not (pa.types.is_float32(kind) or pa.types.is_float16(kind)) or len(finite) < 2:
        return []
    step = float(np.spacing(np.abs(finite).max().astype(kind.to_pandas_dtype())))
    forward = np.diff(finite)
    interval = (
        float(np.mean(forward, where=forward > 0)) if (forward > 0).any() else 0.0
    )
    if step <= 1e-3 * interval:
        return []
    return [
        f"column {name!r} is {kind} and cannot resolve less than {step:.3g} s at the"
        f" end of the log ({interval:.3g} s between samples): write time as float64 or"
        " timestamp"
    ]


def opened_table(path: Path, **options: object) -> pq.ParquetFile:
    """Open a Parquet file whose values have room: no few bytes that stand for many."""
    file = pq.ParquetFile(readable(path), **options)
    about, schema = file.metadata, file.schema
    lists = [
        k for k in range(about.num_columns) if schema.column(k).max_repetition_level
    ]
    groups = [about.row_group(k) for k in range(about.num_row_groups)] if lists else []
    listed = sum(group.column(k).num_values for group in groups for k in lists)
    size = path.stat().st_size
    room = 8 * (about.num_rows * (about.num_columns - len(lists)) + listed)
    if room > ROOM + MOST_TIMES * size:
        message = f"its {size} bytes unpack to {room}, {room // size} times as many"
        hint = "No recording repeats itself like that: copy it again, or leave it out."
        raise InputError(message, hint=hint, where=str(path))
    return file


def readable(path: Path) -> Path | BinaryIO:
    """What Arrow opens: a file by its name, or open already where it cannot spell the name."""
    return (
        path
        if str(path).encode("utf-8", "replace") == os.fsencode(path)
        else path.open("rb")
    )
