"""Documents as Arrow tables, one for each list of structures in them."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import TYPE_CHECKING, TypeAlias

import msgspec

if TYPE_CHECKING:
    import pyarrow as pa

# What a cell of a table can hold; a structure in a structure is a table of its own.
_SCALAR = (bool, int, float, str, type(None))
_Row: TypeAlias = "dict[str, object]"


def tables_of(document: msgspec.Struct) -> dict[str, pa.Table]:
    """Lay out a document as Arrow tables.

    Parameters
    ----------
    document : Struct
        Of any kind, or a part of one.

    Returns
    -------
    dict of str to pyarrow.Table
        A table for each list of structures, by its place in the document
        ("stages.gravity.parameters"), with a row per structure. Where structures lie by
        name ("stages.friction.joints"), the first column, `key`, is the name. Lists
        inside those are not split by what they lie in: each has its own place
        ("stages.friction.joints.elbow.parameters"). Units are those of the document.
    """
    import pyarrow as pa

    tables = {}
    for place, rows in _rows_by_place(document, ""):
        tables[place] = pa.Table.from_pylist(rows)
    return tables


def _rows_by_place(value: object, place: str) -> Iterator[tuple[str, list[_Row]]]:
    """Yield each table's place and rows, in the document's order."""
    parts = _parts(value)
    rows = []
    for name, part in parts.items():
        if isinstance(part, msgspec.Struct) and not isinstance(value, msgspec.Struct):
            cells = {} if isinstance(value, list) else {"key": name}
            rows.append(cells | _cells(part))
    if rows:
        yield place, rows
    for name, part in parts.items():
        yield from _rows_by_place(part, f"{place}.{name}" if place else name)


def _parts(value: object) -> dict[str, object]:
    """Return what lies in a structure, a dictionary or a list, by name or number."""
    if isinstance(value, msgspec.Struct):
        return {name: getattr(value, name) for name in value.__struct_fields__}
    if isinstance(value, Mapping):
        return {str(name): part for name, part in value.items()}
    if isinstance(value, list) and value and isinstance(value[0], msgspec.Struct):
        return {str(number): part for number, part in enumerate(value)}
    return {}


def _cells(struct: msgspec.Struct) -> _Row:
    """Return the fields of a structure that one cell can hold."""
    return {name: part for name, part in _parts(struct).items() if _is_cell(part)}


def _is_cell(value: object) -> bool:
    """Tell whether a value is a scalar, or a list of scalars of one kind."""
    if isinstance(value, _SCALAR):
        return True
    if not isinstance(value, list):
        return False
    kinds = {type(item) for item in value}
    return len(kinds) <= 1 and all(issubclass(kind, _SCALAR) for kind in kinds)
