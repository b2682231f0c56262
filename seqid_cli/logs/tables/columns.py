"""Columns of a table as numbers, and its time column as integer nanoseconds."""

import os
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import BinaryIO

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

from seqid_cli.errors import InputError
from seqid_cli.logs.raw import STAMP_LIMIT_NS, Array, Mask, Rows, Stamps
from seqid_cli.logs.tables.parquet_footer import FooterError, values_by_column

ARROW_ERRORS = (
    pa.ArrowException,
    OSError,
    ValueError,
    KeyError,
    MemoryError,
    OverflowError,
)
ROOM = 256 << 20  # bytes in memory that any table may have
MOST_TIMES = 500  # ... and beyond them, of one byte of the file
_NUMBERS = (
    pa.types.is_integer,
    pa.types.is_floating,
    pa.types.is_decimal,
    pa.types.is_null,
)
_TEXTS = (
    pa.types.is_string,
    pa.types.is_large_string,
    pa.types.is_binary,
    pa.types.is_large_binary,
)
_TIMED = (pa.types.is_timestamp, pa.types.is_duration, pa.types.is_time)
_HINT = "Write it as float64 in SI units; time also as a timestamp."
NS_PER = {"s": 1_000_000_000, "ms": 1_000_000, "us": 1_000, "ns": 1}
DAY_NS = 86_400 * NS_PER["s"]
_OF_DAY = (
    r"^\s*(?P<hours>[0-9]{1,3}):(?P<minutes>[0-5][0-9]):(?P<seconds>[0-5][0-9])"
    r"(?:[.,](?P<fraction>[0-9]{1,12}))?\s*$"
)
# An epoch time of this size cannot be seconds: the largest that it can be in each unit.
_EPOCH = (("ns", 1e17), ("us", 1e14), ("ms", 1e11))


@dataclass(frozen=True)
class TimeColumn:
    """Columns of time: one, or whole seconds and the nanoseconds beside them."""

    name: str
    unit: str | None = None  # by name or format, else by the size of the numbers
    sure: bool = False  # whether the unit stands with the name
    rate_hz: float | None = None  # of samples without a column of time
    nanoseconds: str | None = None  # the column beside whole seconds


def column(table: pa.Table, name: str) -> pa.ChunkedArray:
    """Return a column, dictionaries resolved."""
    values = table.column(name)
    if pa.types.is_dictionary(values.type):
        return values.cast(values.type.value_type)
    return values


def numbers(where: str, table: pa.Table, name: str) -> Array:
    """Read a column as float64 (M,); nulls become NaN.

    Raises InputError, which names the column of the log `where`, if it holds none.
    """
    with _explained(where, name):
        values = column(table, name)
        if not is_number(values.type):
            raise InputError(
                f"column {name!r} holds {values.type}, not numbers",
                hint=_HINT,
                where=where,
            )
        if values.type != pa.float64():
            values = values.cast(pa.float64(), safe=False)
        array: Array = values.to_numpy()
    # Some patterns of a damaged NaN raise a warning in every sum that they are in.
    is_missing = np.isnan(array)
    return np.where(is_missing, np.nan, array) if is_missing.any() else array


@contextmanager
def _explained(where: str, name: str) -> Iterator[None]:
    """Turn what Arrow says of a column into a message."""
    try:
        yield
    except MemoryError:
        raise  # which is no fault of the column
    except ARROW_ERRORS as error:
        reason = " ".join(str(error).split())[:200]
        raise InputError(
            f"column {name!r} cannot be read ({reason})", hint=_HINT, where=where
        ) from error


def is_number(kind: pa.DataType) -> bool:
    """Tell whether a column of this type can be read as numbers."""
    return any(is_kind(kind) for is_kind in _NUMBERS)


def is_text(kind: pa.DataType) -> bool:
    """Tell whether a column of this type holds texts, or bytes."""
    if pa.types.is_dictionary(kind):
        kind = kind.value_type
    return any(is_kind(kind) for is_kind in _TEXTS)


def read_stamps(
    where: str, table: pa.Table, time: TimeColumn, first_row: int = 0
) -> tuple[Stamps, Rows, list[str]]:
    """Read the time of the rows.

    Parameters
    ----------
    where : str
        The log, for messages.
    table : pyarrow.Table
        M rows.
    time : TimeColumn
        Where time stands, and in which unit.
    first_row : int
        Number of the table's first row in its file.

    Returns
    -------
    stamps : ndarray of int, (M,)
        Stamps [ns], 0 where missing.
    rows : ndarray of int, (K,)
        The rows that have one.
    warnings : list of str
        Rows left out, units that were guessed, times that are too coarse.
    """
    warnings: list[str] = []
    if time.rate_hz is not None:
        rows = np.arange(table.num_rows)
        stamps = np.rint((first_row + rows) * (NS_PER["s"] / time.rate_hz))
        return stamps.astype(np.int64), rows, warnings
    with _explained(where, time.name):
        kind = column(table, time.name).type
    if any(is_timed(kind) for is_timed in _TIMED):
        stamps, is_usable = _from_counts(where, table, time.name, NS_PER[kind.unit])
        if pa.types.is_time(kind):
            stamps = _over_midnight(stamps, is_usable)
    elif time.nanoseconds is not None:
        nanoseconds = numbers(where, table, time.nanoseconds)
        seconds = numbers(where, table, time.name)
        stamps, is_usable = _from_values(seconds, NS_PER["s"])
        is_usable &= (nanoseconds >= 0) & (nanoseconds < NS_PER["s"])
        stamps += np.where(is_usable, nanoseconds, 0).astype(np.int64)
    else:
        values = numbers(where, table, time.name)
        unit = _unit(values, time, warnings)
        if pa.types.is_integer(kind) and not pa.types.is_uint64(kind):
            stamps, is_usable = _from_counts(where, table, time.name, NS_PER[unit])
        else:
            seconds = values / (NS_PER["s"] / NS_PER[unit])
            warnings += _resolution(time.name, kind, seconds)
            stamps, is_usable = _from_values(values, NS_PER[unit])

    n_lost = int(np.count_nonzero(~is_usable))
    if n_lost:
        warnings.append(
            f"{n_lost} rows without a usable time in column {time.name!r} were left out"
        )
    return np.where(is_usable, stamps, 0), np.flatnonzero(is_usable), warnings


def times_of_day(texts: pa.ChunkedArray) -> pa.ChunkedArray | None:
    """Return times of texts such as 13:05:07.250; None where most have another form.

    Hours may have one digit. Texts of more than 24 hours are durations. Raises
    ValueError, with the first text of another form, where there are a few.
    """
    import pyarrow.compute as pc

    parts = pc.extract_regex(texts, _OF_DAY)
    if parts.null_count > len(parts) // 2:
        return None
    others = texts.filter(pc.and_(parts.is_null(), texts.is_valid()))
    if len(others):
        raise ValueError(others[0].as_py())
    flat = parts.combine_chunks()
    hours, minutes, seconds = (
        pc.cast(flat.field(name), pa.int64())
        for name in ("hours", "minutes", "seconds")
    )
    fraction = pc.utf8_rpad(flat.field("fraction"), 9, "0")
    fraction = pc.cast(pc.utf8_slice_codeunits(fraction, 0, 9), pa.int64())
    whole_s = pc.add(pc.multiply(pc.add(pc.multiply(hours, 60), minutes), 60), seconds)
    ns = pc.add(pc.multiply(whole_s, NS_PER["s"]), fraction)
    ns = pc.if_else(flat.is_valid(), ns, pa.scalar(None, pa.int64()))
    latest_ns = pc.max(ns).as_py() or 0
    kind = pa.time64("ns") if latest_ns < DAY_NS else pa.duration("ns")
    return pa.chunked_array([pc.cast(ns, kind)])


def _over_midnight(stamps: Stamps, is_usable: Mask) -> Stamps:
    """Let times of the day run on over midnight: back by half a day or more is one."""
    moved = stamps.copy()
    times = stamps[is_usable]
    days = np.cumsum(np.diff(times, prepend=times[:1]) < -DAY_NS // 2)
    moved[is_usable] += days * DAY_NS
    return moved


def _unit(
    values: Array, time: TimeColumn, warnings: list[str], *, fastest_s: float = 5e-05
) -> str:
    """Return the unit: what the name says, or the format, or else the size of numbers.

    `fastest_s`: the shortest interval that a log can have; a unit of the format that
    makes it shorter is none [s].
    """
    if time.unit is not None and time.sure:
        return time.unit
    finite = values[np.isfinite(values)]
    steps = np.diff(finite)
    forward_steps = steps[steps > 0]
    step = float(np.median(forward_steps)) if len(forward_steps) else np.inf
    if time.unit is not None and time.unit != "s":
        if step * NS_PER[time.unit] * 1e-9 >= fastest_s:
            return time.unit
        warnings.append(
            f"column {time.name!r} is in {time.unit} by its format, but steps by"
            f" {step:.3g}: read as s"
        )
        return "s"

    size = float(np.median(np.abs(finite))) if len(finite) else 0.0
    for unit, least in _EPOCH:
        if size > least:
            warnings.append(
                f"column {time.name!r} is too large for seconds: read as {unit}"
            )
            return unit
    return "s"


def _from_counts(
    where: str, table: pa.Table, name: str, ns_per_unit: int
) -> tuple[Stamps, Mask]:
    """Return exact stamps [ns] (M,) by counts of a unit, and which are usable."""
    with _explained(where, name):
        values = column(table, name)
        if not pa.types.is_integer(values.type):
            # A calendar time is a count of its own width.
            width = pa.int32() if values.type.bit_width == 32 else pa.int64()
            values = values.cast(width)
        if values.type != pa.int64():
            values = values.cast(pa.int64())
        is_missing = np.zeros(len(values), dtype=np.bool_)
        if values.null_count:
            is_missing = values.is_null().to_numpy()
            values = values.fill_null(0)
        counts = values.to_numpy()
    limit = STAMP_LIMIT_NS // ns_per_unit
    is_usable = ~is_missing & (counts > -limit) & (counts < limit)
    return np.where(is_usable, counts, 0) * ns_per_unit, is_usable


def _from_values(values: Array, ns_per_unit: int) -> tuple[Stamps, Mask]:
    """Return stamps [ns] (M,) by floating-point values, and which are usable.

    Whole units and the fraction are converted apart, so that no digit of an epoch time
    is lost.
    """
    is_usable = np.isfinite(values) & (np.abs(values) < STAMP_LIMIT_NS / ns_per_unit)
    usable = np.where(is_usable, values, 0.0)
    units = np.floor(usable)
    fraction_ns = np.rint((usable - units) * ns_per_unit)
    stamps = units.astype(np.int64) * ns_per_unit + fraction_ns.astype(np.int64)
    return stamps, is_usable


def _resolution(name: str, kind: pa.DataType, seconds: Array) -> list[str]:
    """Warn of floating-point times too coarse for the interval between samples."""
    finite = seconds[np.isfinite(seconds)]
    is_coarse_kind = pa.types.is_float32(kind) or pa.types.is_float16(kind)
    if not is_coarse_kind or len(finite) < 2:
        return []
    largest = np.abs(finite).max().astype(kind.to_pandas_dtype())
    resolution_s = float(np.spacing(largest))

    steps = np.diff(finite)
    interval_s = 0.0
    if (steps > 0).any():
        interval_s = float(np.mean(steps, where=steps > 0))
    if resolution_s <= 1e-3 * interval_s:
        return []
    return [
        f"column {name!r} is {kind} and cannot resolve less than {resolution_s:.3g} s"
        f" at the end of the log ({interval_s:.3g} s between samples): write time as"
        " float64 or timestamp"
    ]


def opened_table(path: Path, **options: object) -> pq.ParquetFile:
    """Open a Parquet file whose values have room.

    Raises InputError where few bytes stand for so many values that no recording is in
    them. `options` are those of `pyarrow.parquet.ParquetFile`.
    """
    file = pq.ParquetFile(readable(path), **options)
    metadata = file.metadata
    columns = [file.schema.column(k) for k in range(metadata.num_columns)]
    list_columns = [column.path for column in columns if column.max_repetition_level]

    # A plain column has a value for each row; those of lists are counted.
    n_values = metadata.num_rows * (metadata.num_columns - len(list_columns))
    if list_columns:
        try:
            counts = values_by_column(path)
        except FooterError as error:
            raise InputError(
                f"its footer is damaged: {error}",
                hint="Copy it again, or leave it out.",
                where=str(path),
            ) from error
        n_values += sum(counts.get(name, 0) for name in list_columns)

    size = path.stat().st_size
    unpacked = 8 * n_values
    if unpacked > ROOM + MOST_TIMES * size:
        times = unpacked // size
        raise InputError(
            f"its {size} bytes unpack to {unpacked}, {times} times as many",
            hint="No recording repeats itself like that: copy it again, or leave it"
            " out.",
            where=str(path),
        )
    return file


def readable(path: Path) -> Path | BinaryIO:
    """Return what Arrow opens: a path, or a file already open where it is no UTF-8."""
    is_utf8 = str(path).encode("utf-8", "replace") == os.fsencode(path)
    return path if is_utf8 else path.open("rb")
