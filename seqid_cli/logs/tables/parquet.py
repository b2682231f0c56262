"""Parquet logs: only the needed columns are read, one row group at a time.

A table made of JointState messages has a `name` column of string lists; a LeRobot data
set names the motors of `observation.state` in `meta/info.json`, two folders or one
above its data files.
"""

import json
import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc
import pyarrow.parquet as pq

from seqid_cli.errors import InputError
from seqid_cli.logs.raw import Array, RawLog, TimeSource
from seqid_cli.logs.tables.columns import ARROW_ERRORS, is_number, is_text, opened_table
from seqid_cli.logs.tables.naming_schemes import LEROBOT_STATE
from seqid_cli.logs.tables.table import TableFile, read_table
from seqid_cli.robot.types import Robot

_ELEMENT = re.compile(r"(?P<list>.+)\[(?P<index>[0-9]+)\]")
BLOCK_ROWS = 65_536
_LONGEST = 256  # elements of a list column that can be one number per joint
_LARGEST = 16 << 20  # bytes of an info.json
_ENDINGS = ("", ".pos", ".position", "_pos", "_position", ".q")
_NAME_COLUMNS = ("name", "names", "joint_names")


def lerobot_names(path: Path) -> list[str]:
    """Names of the motors of a LeRobot data set; empty where they are not told."""
    for folder in list(path.absolute().parents)[1:4]:
        info = folder / "meta" / "info.json"
        try:
            if info.stat().st_size > _LARGEST:
                return []
            names = json.loads(info.read_bytes())["features"][LEROBOT_STATE]["names"]
        except (OSError, ValueError, KeyError, TypeError, RecursionError):
            continue
        # {"motors": [...]} of older data sets
        if isinstance(names, dict) and len(names) == 1:
            (names,) = names.values()
        if isinstance(names, list):
            return [str(name) for name in names]
    return []


def _name_column(path: Path, file: pq.ParquetFile) -> list[str]:
    """Return the joints that a column of string lists names, alike in all rows."""
    schema = file.schema_arrow
    for column in _NAME_COLUMNS:
        kind = schema.field(column).type if column in schema.names else pa.null()
        if not pa.types.is_list(kind) or not pa.types.is_string(kind.value_type):
            continue
        given = [
            row for row in file.read(columns=[column]).column(0).to_pylist() if row
        ]
        if any(row != given[0] for row in given):
            message = f"the names in column {column!r} change from row to row"
            hint = "Write one column per joint, <joint>.position and so on."
            raise InputError(message, hint=hint, where=str(path))
        return [str(name) for name in given[0]] if given else []
    return []


@dataclass(frozen=True, kw_only=True)
class ParquetTable(TableFile):
    """An opened Parquet file; `lists` are its list columns of numbers and how long these are."""

    lists: dict[str, int] = field(default_factory=dict)

    def tables(
        self, columns: Sequence[str], rows: int | None
    ) -> Iterator[tuple[pa.Table, str]]:
        """Read columns; nothing of a damaged file can be salvaged."""
        matched = {name: _ELEMENT.fullmatch(name) for name in columns}
        elements = {
            n: m
            for n, m in matched.items()
            if m is not None and m["list"] in self.lists
        }
        lists = dict.fromkeys(found["list"] for found in elements.values())
        plain = [name for name in columns if name not in elements]
        for table in read_tables(self.path, [*lists, *plain], rows=rows):
            flat = _flattened(table)
            out = {
                name: flat.column(name)
                for name in plain
                if flat.schema.names.count(name) == 1
            }
            values = {name: self._matrix(flat, name) for name in lists}
            for name, found in elements.items():
                out[name] = pa.chunked_array(
                    [values[found["list"]][:, int(found["index"])]]
                )
            yield pa.table(out), ""

    def _matrix(self, table: pa.Table, name: str) -> Array:
        """Return a list column as (M, length), rows without a list as NaN."""
        length = self.lists[name]
        try:
            column = table.column(name).combine_chunks()
            counts = np.asarray(pc.fill_null(pc.list_value_length(column), -1))
            wrong = np.flatnonzero((counts != length) & (counts > 0))
            if len(wrong):
                text = (
                    f"row {wrong[0] + 1}: {name!r} holds {counts[wrong[0]]} values, the"
                    " first "
                )
                text += f"row {length} ({len(wrong)} such rows)"
                hint = (
                    "Write one value per joint in every row, null where one is missing."
                )
                raise InputError(text, hint=hint, where=self.where)
            values = np.full((len(column), length), np.nan)
            flat = pc.cast(pc.list_flatten(column), pa.float64(), safe=False)
            values[counts == length] = flat.to_numpy(zero_copy_only=False).reshape(
                -1, length
            )
        except ARROW_ERRORS as error:
            raise damaged(self.path, error) from error
        return values


def read_blocks(
    path: Path,
    robot: Robot,
    time_source: TimeSource = "header",
    *,
    rows: int | None = BLOCK_ROWS,
) -> Iterator[RawLog]:
    """Read a Parquet log; see `read_table`. A row has one time, whatever the source."""
    del time_source
    return read_table(open_table(path, robot.joint_names), robot, rows)


def read_tables(
    path: Path, columns: Sequence[str], *, rows: int | None = BLOCK_ROWS
) -> Iterator[pa.Table]:
    """Read columns, up to `rows` rows of a row group at a time, or all; checks checksums."""
    try:
        with opened_table(
            path, pre_buffer=False, page_checksum_verification=True
        ) as file:
            schema = file.schema_arrow
            # each text may be of any size
            for name in set(columns) & set(schema.names):
                kind = schema.field(name).type
                if is_text(kind):
                    kind = kind.value_type if pa.types.is_dictionary(kind) else kind
                    message = f"column {name!r} holds {kind}, not numbers"
                    hint = (
                        "Write it as float64 in SI units, time in seconds or as a"
                        " timestamp."
                    )
                    raise InputError(message, hint=hint, where=str(path))
            if rows is None:
                yield file.read(columns=list(columns))
                return
            for group in range(file.num_row_groups):
                own = {"row_groups": [group], "columns": list(columns)}
                for batch in file.iter_batches(rows, **own, use_threads=False):
                    yield pa.Table.from_batches([batch])
                    del batch
                # or it keeps some row groups' worth
                pa.default_memory_pool().release_unused()
    except ARROW_ERRORS as error:
        raise damaged(path, error) from error


def open_table(path: Path, joints: Sequence[str] = ()) -> ParquetTable:
    """Read the names of columns: `parent.child`, `column[k]` of lists, which `joints` may name."""
    try:
        with opened_table(path) as file:
            fields = _flattened(file.schema_arrow.empty_table()).schema
            lengths = {
                each.name: _length(file, each.name, each.type) for each in fields
            }
            lists = {name: length for name, length in lengths.items() if length}
            lerobot = LEROBOT_STATE in lists
            named = lerobot_names(path) if lerobot else _name_column(path, file)
    except ARROW_ERRORS as error:
        raise damaged(path, error) from error
    # The place of each joint in the lists, where the file names them all.
    places = {name: place for place, name in reversed([*enumerate(named)])}
    forms = [
        [joint + end for end in _ENDINGS if joint + end in places] for joint in joints
    ]
    entries = {joint: places[f[0]] for joint, f in zip(joints, forms, strict=True) if f}
    notes: list[str] = []
    if len(entries) < len(joints):
        entries = {}
        notes += [
            f"{LEROBOT_STATE}: values are taken in the order of the robot file"
        ] * lerobot
    names = fields.names
    names += [f"{name}[{k}]" for name, length in lists.items() for k in range(length)]
    return ParquetTable(path, tuple(names), entries, tuple(notes), lists=lists)


def list_columns(path: Path) -> tuple[str, ...]:
    """List the names of columns as the file has them."""
    try:
        with opened_table(path) as file:
            return tuple(file.schema.column(i).path for i in range(len(file.schema)))
    except ARROW_ERRORS as error:
        raise damaged(path, error) from error


def _flattened(table: pa.Table) -> pa.Table:
    """Name the fields of a column `column.field`, at any depth."""
    while any(pa.types.is_struct(kind) for kind in table.schema.types):
        table = table.flatten()
    return table


def _length(file: pq.ParquetFile, name: str, kind: pa.DataType) -> int:
    """Return the length of the first list of a column, 0 where none can hold joints."""
    lists = (pa.types.is_list, pa.types.is_large_list, pa.types.is_fixed_size_list)
    if not any(is_list(kind) for is_list in lists) or not is_number(kind.value_type):
        return 0
    if pa.types.is_fixed_size_list(kind):
        return int(kind.list_size) if kind.list_size <= _LONGEST else 0
    if file.schema_arrow.names.count(name) != 1:
        return 0  # a list inside a struct, or two columns of one name
    for batch in file.iter_batches(batch_size=1024, columns=[name]):
        given = batch.column(0).drop_null() if batch.num_columns else []
        if len(given):
            return len(given[0]) if len(given[0]) <= _LONGEST else 0
    return 0


def damaged(path: Path, error: BaseException) -> InputError:
    """Make the error for what Arrow could not read."""
    reason = " ".join(str(error).split())[:200] or type(error).__name__
    message = f"the Parquet file is damaged or not readable ({reason})"
    hint = "Copy it again from the source, or leave this log out."
    if isinstance(error, MemoryError):
        message = f"there is too little memory to read it ({reason})"
        hint = (
            "Give the process more, or split the log; a damaged file may ask for too"
            " much, too."
        )
    return InputError(message, hint=hint, where=str(path))
