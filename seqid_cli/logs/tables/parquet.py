"""Parquet logs: only the needed columns are read, one row group at a time.

A table made of JointState messages has a `name` column of string lists; a LeRobot data
set names the motors of `observation.state` and of `action` in `meta/info.json`, two
folders or one above its data files.
"""

import json
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

from seqid_cli.being_read import being_read
from seqid_cli.errors import InputError
from seqid_cli.logs.raw import Array, RawLog, TimeSource
from seqid_cli.logs.tables.columns import ARROW_ERRORS, is_number, is_text, opened_table
from seqid_cli.logs.tables.csv_form import LONGEST_LIST
from seqid_cli.logs.tables.name_words import WORDS
from seqid_cli.logs.tables.naming_schemes import (
    LEROBOT_ACTION,
    LEROBOT_STATE,
    NAME_COLUMNS,
)
from seqid_cli.logs.tables.side_by_side import with_siblings
from seqid_cli.logs.tables.table import TableFile, elements_in, read_table
from seqid_cli.robot.toml_schema import DEFAULTS, Channels
from seqid_cli.robot.types import Robot

BLOCK_ROWS = 65_536
_LARGEST = 16 << 20  # bytes of an info.json
# What stands behind a joint's name where a file names the elements of its lists.
_ENDINGS = ("", ".pos", ".position", "_pos", "_position", ".q")
# ... and where the element is another quantity.
_OTHER_THAN_POSITION = frozenset[str]().union(
    *(words for quantity, words in WORDS.items() if quantity != "position")
)


def lerobot_names(path: Path, feature: str = LEROBOT_STATE) -> list[str]:
    """Return the names of a LeRobot data set's motors; empty where none are told."""
    for folder in list(path.absolute().parents)[1:4]:
        info = folder / "meta" / "info.json"
        try:
            if info.stat().st_size > _LARGEST:
                return []
            names = json.loads(info.read_bytes())["features"][feature]["names"]
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
    schema = _flattened(file.schema_arrow.empty_table()).schema
    for column in NAME_COLUMNS:
        if schema.names.count(column) != 1:
            continue
        kind = schema.field(column).type
        if not pa.types.is_list(kind) or not pa.types.is_string(kind.value_type):
            continue

        table = _flattened(file.read(columns=[column]))
        rows = table.column(column).to_pylist()
        names_by_row = [row for row in rows if row]
        if not names_by_row:
            return []
        first = names_by_row[0]
        if any(row != first for row in names_by_row):
            raise InputError(
                f"the names in column {column!r} change from row to row",
                hint="Write one column per joint, <joint>.position and so on.",
                where=str(path),
            )
        return [str(name) for name in first]
    return []


@dataclass(frozen=True, kw_only=True)
class ParquetTable(TableFile):
    """An opened Parquet file."""

    # list columns of numbers, and how long the lists are
    lists: dict[str, int] = field(default_factory=dict)
    # names of elements that stand for a list column and the place in it
    elements: Mapping[str, tuple[str, int]] = field(default_factory=dict)

    def tables(
        self, columns: Sequence[str], rows: int | None
    ) -> Iterator[tuple[pa.Table, str]]:
        """Read columns; nothing of a damaged file can be salvaged."""
        element_of = elements_in(columns, self.lists)
        for name in columns:
            if name in self.elements:
                element_of[name] = self.elements[name]
        list_columns = dict.fromkeys(name for name, _ in element_of.values())
        plain_columns = [name for name in columns if name not in element_of]
        for table in read_tables(self.path, [*list_columns, *plain_columns], rows=rows):
            flat = _flattened(table)
            values = {
                name: flat.column(name)
                for name in plain_columns
                if flat.schema.names.count(name) == 1
            }
            matrices = {name: self._matrix(flat, name) for name in list_columns}
            for name, (list_column, k) in element_of.items():
                values[name] = pa.chunked_array([matrices[list_column][:, k]])
            yield pa.table(values), ""

    def _matrix(self, table: pa.Table, name: str) -> Array:
        """Return a list column as (M, length), rows without a list as NaN."""
        import pyarrow.compute as pc

        length = self.lists[name]
        try:
            column = table.column(name).combine_chunks()
            counts = np.asarray(pc.fill_null(pc.list_value_length(column), -1))
            faulty = np.flatnonzero((counts != length) & (counts > 0))
            if len(faulty):
                raise InputError(
                    f"row {faulty[0] + 1}: {name!r} holds {counts[faulty[0]]} values,"
                    f" the first row {length} ({len(faulty)} such rows)",
                    hint="Write one value per joint in every row, null where one is"
                    " missing.",
                    where=self.where,
                )
            elements = pc.cast(pc.list_flatten(column), pa.float64(), safe=False)
            rows = elements.to_numpy(zero_copy_only=False).reshape(-1, length)
            matrix = np.full((len(column), length), np.nan)
            matrix[counts == length] = rows
        except ARROW_ERRORS as error:
            raise damaged(self.path, error) from error
        return matrix


def read_blocks(
    path: Path,
    robot: Robot,
    time_source: TimeSource = "header",
    *,
    rows: int | None = BLOCK_ROWS,
) -> Iterator[RawLog]:
    """Read a Parquet log; see `read_table`. A row has one time, whatever the source."""
    del time_source
    table = open_joined(path, robot.log_names, robot.channels)
    return read_table(table, robot, rows)


def open_joined(
    path: Path, joints: Sequence[str] = (), channels: Channels = DEFAULTS
) -> TableFile:
    """Open a table, with those of other quantities that belong to it."""

    def opened(file: Path) -> ParquetTable:
        return open_table(file, joints)

    return with_siblings(opened(path), opened, channels.files, channels.time)


def read_tables(
    path: Path, columns: Sequence[str], *, rows: int | None = BLOCK_ROWS
) -> Iterator[pa.Table]:
    """Read columns, checksums of pages checked.

    Parameters
    ----------
    rows : int, optional
        Rows of a row group at a time, at most; None reads all at once.

    Raises
    ------
    InputError
        The file is damaged, or a column holds texts.
    """
    try:
        with (
            being_read(path),
            opened_table(
                path, pre_buffer=False, page_checksum_verification=True
            ) as file,
        ):
            _refuse_texts(path, file, columns)
            if rows is None:
                yield file.read(columns=list(columns))
                return

            for group in range(file.num_row_groups):
                for batch in file.iter_batches(
                    rows,
                    row_groups=[group],
                    columns=list(columns),
                    use_threads=False,
                ):
                    yield pa.Table.from_batches([batch])
                    del batch
                # Otherwise Arrow holds the memory of some row groups.
                pa.default_memory_pool().release_unused()
    except ARROW_ERRORS as error:
        raise damaged(path, error) from error


def _refuse_texts(path: Path, file: pq.ParquetFile, columns: Sequence[str]) -> None:
    """Raise InputError for a column of texts, each of which may be of any size."""
    schema = file.schema_arrow
    for name in set(columns) & set(schema.names):
        kind = schema.field(name).type
        if not is_text(kind):
            continue
        if pa.types.is_dictionary(kind):
            kind = kind.value_type
        raise InputError(
            f"column {name!r} holds {kind}, not numbers",
            hint="Write it as float64 in SI units, time in seconds or as a timestamp.",
            where=str(path),
        )


def open_table(path: Path, joints: Sequence[str] = ()) -> ParquetTable:
    """Read the names of columns: `parent.child`, and `column[k]` of lists.

    Parameters
    ----------
    joints : sequence of str
        Names of the robot file. The file may name the elements of its lists by them.
    """
    try:
        with being_read(path), opened_table(path) as file:
            # Every call for it makes the whole schema anew.
            schema = file.schema_arrow
            fields = _flattened(schema.empty_table()).schema
            n_of_name = Counter(schema.names)
            lists: dict[str, int] = {}
            for each in fields:
                is_alone = n_of_name[each.name.split(".")[0]] <= 1
                length = _list_length(file, each.name, each.type, is_alone=is_alone)
                if length:
                    lists[each.name] = length
            is_lerobot = LEROBOT_STATE in lists
            names_in_rows = [] if is_lerobot else _name_column(path, file)
    except ARROW_ERRORS as error:
        raise damaged(path, error) from error

    entries = {name: place for place, name in enumerate(names_in_rows)}
    command_entries: dict[str, int] | None = None
    notes: tuple[str, ...] = ()
    elements: dict[str, tuple[str, int]] = {}
    if is_lerobot:
        command_entries = _action_entries(path, joints, lists)
        names_in_state = lerobot_names(path)
        elements = _elements_of_state(names_in_state, lists[LEROBOT_STATE])
        entries = _entries(joints, names_in_state)
        if elements:
            entries = _joints_of_state(names_in_state)
            elements |= _elements_of_action(path, lists)
        elif len(entries) < len(joints):
            entries = {}
            notes = (
                f"{LEROBOT_STATE}: values are taken in the order of the robot file",
            )
    names = list(fields.names)
    for name, length in lists.items():
        names += [f"{name}[{k}]" for k in range(length)]
    names += [name for name in elements if name not in names]
    return ParquetTable(
        path=path,
        names=tuple(names),
        entries=entries,
        command_entries=command_entries,
        named=bool(names_in_rows or elements),
        notes=notes,
        lists=lists,
        elements=elements,
    )


def _elements_of_state(names: Sequence[str], length: int) -> dict[str, tuple[str, int]]:
    """Return elements of a LeRobot state by name, where some are no positions.

    Robots with torque feedback have `elbow.pos`, `elbow.vel` and `elbow.torque` in one
    list. Each of them is a column by its name then.
    """
    endings = {name.replace("_", ".").rpartition(".")[2] for name in names}
    if len(names) != length or endings.isdisjoint(_OTHER_THAN_POSITION):
        return {}
    elements: dict[str, tuple[str, int]] = {}
    for place, name in enumerate(names):
        elements.setdefault(name, (LEROBOT_STATE, place))
    return elements


def _elements_of_action(
    path: Path, lists: Mapping[str, int]
) -> dict[str, tuple[str, int]]:
    """Return the commanded positions among the actions, as `<joint>.command`."""
    names = lerobot_names(path, LEROBOT_ACTION)
    if len(names) != lists.get(LEROBOT_ACTION, 0):
        return {}
    return {
        f"{joint}.command": (LEROBOT_ACTION, place)
        for joint, place in _joints_of_state(names).items()
    }


def _joints_of_state(names: Sequence[str]) -> dict[str, int]:
    """Return the place of each joint's position in a LeRobot state of several kinds."""
    places: dict[str, int] = {}
    for place, name in enumerate(names):
        for ending in _ENDINGS[1:]:
            if name.endswith(ending):
                places.setdefault(name.removesuffix(ending), place)
                break
    return places


def _action_entries(
    path: Path, joints: Sequence[str], lists: dict[str, int]
) -> dict[str, int] | None:
    """Return the place of each joint in the actions; None: as in the states.

    Actions of another kind, such as poses of the gripper, are no commands of joints:
    every joint is at -1 then, where no list has an element.
    """
    action_names = lerobot_names(path, LEROBOT_ACTION)
    if action_names:
        places = _entries(joints, action_names)
        return {joint: places.get(joint, -1) for joint in joints}
    if lists.get(LEROBOT_ACTION) == lists[LEROBOT_STATE]:
        return None
    return dict.fromkeys(joints, -1)


def _entries(joints: Sequence[str], element_names: Sequence[str]) -> dict[str, int]:
    """Return the place in the lists of each joint that is named there."""
    places: dict[str, int] = {}
    for place, name in enumerate(element_names):
        places.setdefault(name, place)
    entries = {}
    for joint in joints:
        for ending in _ENDINGS:
            if joint + ending in places:
                entries[joint] = places[joint + ending]
                break
    return entries


def list_columns(path: Path) -> tuple[str, ...]:
    """List the names of columns as the file has them."""
    try:
        with being_read(path), opened_table(path) as file:
            return tuple(file.schema.column(i).path for i in range(len(file.schema)))
    except ARROW_ERRORS as error:
        raise damaged(path, error) from error


def _flattened(table: pa.Table) -> pa.Table:
    """Name the fields of a column `column.field`, at any depth."""
    while any(pa.types.is_struct(kind) for kind in table.schema.types):
        table = table.flatten()
    return table


def _list_length(
    file: pq.ParquetFile, name: str, kind: pa.DataType, *, is_alone: bool
) -> int:
    """Return the length of the first list of a column, 0 where none can hold joints.

    Nor can two columns of one name, which are not read: `is_alone` is false of these.
    """
    list_kinds = (pa.types.is_list, pa.types.is_large_list, pa.types.is_fixed_size_list)
    is_list = any(is_kind(kind) for is_kind in list_kinds)
    if not is_list or not is_number(kind.value_type):
        return 0
    length = 0
    if pa.types.is_fixed_size_list(kind):
        length = int(kind.list_size)
    elif is_alone:
        length = _first_length(file, name)
    return length if length <= LONGEST_LIST else 0


def _first_length(file: pq.ParquetFile, name: str) -> int:
    """Return the length of the first list that is not null, 0 where there is none."""
    for batch in file.iter_batches(batch_size=1024, columns=[name]):
        table = _flattened(pa.Table.from_batches([batch]))  # it may be in a struct
        if name not in table.column_names:
            continue
        lists = table.column(name).drop_null()
        if len(lists):
            return len(lists[0])
    return 0


def damaged(path: Path, error: BaseException) -> InputError:
    """Make the error for what Arrow could not read."""
    reason = " ".join(str(error).split())[:200] or type(error).__name__
    if isinstance(error, MemoryError):
        return InputError(
            f"there is too little memory to read it ({reason})",
            hint="Give the process more, or split the log; a damaged file may ask for"
            " too much, too.",
            where=str(path),
        )
    return InputError(
        f"the Parquet file is damaged or not readable ({reason})",
        hint="Copy it again from the source, or leave this log out.",
        where=str(path),
    )
