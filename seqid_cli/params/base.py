"""Base of all documents: strict structures, and how Python and notebooks show them.

Whatever a document holds is laid out by its own shape: structures that lie in a list or
by name in a dictionary as the rows of one table, other values by their names. Long
lists are counted.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from html import escape
from typing import TYPE_CHECKING, Any

import msgspec

if TYPE_CHECKING:
    import pyarrow as pa

_MOST_ROWS = 60
_MOST_VALUES = 6  # in one cell
# What a reader of a notebook does not look for.
_LEFT_OUT = frozenset(
    {"schema", "created", "tool", "inputs", "covariance", "representative"}
)


class FrozenStruct(
    msgspec.Struct,
    forbid_unknown_fields=True,
    kw_only=True,
    omit_defaults=False,
    frozen=True,
):
    """Base of structures that never change, and so can be in a set."""


class Struct(
    msgspec.Struct, forbid_unknown_fields=True, kw_only=True, omit_defaults=False
):
    """Base of all file structures: an unknown key is an error that names its path."""


class Document(Struct):
    """A whole document: one line in a shell, tables in a notebook or as Arrow."""

    def tables(self) -> dict[str, pa.Table]:
        """Return the content as Arrow tables by place; see `tables_of`."""
        from seqid_cli.params.tables import tables_of

        return tables_of(self)

    def __repr__(self) -> str:
        """Return one line: the kind of document and what it is about."""
        gist = ", ".join(self._gist())
        return (
            f"<{type(self).__name__}: {gist}>" if gist else f"<{type(self).__name__}>"
        )

    def _gist(self) -> list[str]:
        """Return what a line says of the document: robot and verdict, if it has any."""
        robot_name = getattr(getattr(self, "robot", None), "name", None)
        verdict = getattr(self, "verdict", None)
        return [text for text in (robot_name, verdict) if isinstance(text, str)]

    def _repr_html_(self) -> str:
        """Return the content as tables."""
        return f'<div class="seqid">{_tables(self)}</div>'


def _fields(struct: msgspec.Struct) -> dict[str, object]:
    """Return the fields of a structure that are shown."""
    return {
        name: getattr(struct, name)
        for name in struct.__struct_fields__
        if name not in _LEFT_OUT
    }


def _tables(value: Any) -> str:
    """Lay out a value as tables.

    A structure has its short values in one table, then a part for each longer one; many
    values are the rows of a table.
    """
    if isinstance(value, list) and not isinstance(value[0], msgspec.Struct):
        return f"{len(value)} rows"
    if not isinstance(value, msgspec.Struct):
        return _records(value)

    short_rows = []
    parts = []
    for name, item in _fields(value).items():
        text = _short(item)
        if text:
            short_rows.append((name, text))
        elif item:
            inner = _tables(item)
            if inner:
                summary = f"<summary>{escape(name)}</summary>"
                parts.append(f"<details open>{summary}{inner}</details>")
    if short_rows:
        parts.insert(0, _table((), short_rows))
    return "".join(parts)


def _short(value: object) -> str:
    """Write a value into one cell; empty for nothing, and for too much for a cell."""
    if isinstance(value, float):
        return f"{value:.4g}"
    if isinstance(value, str | int):
        return escape(str(value))
    if not isinstance(value, Sequence):
        return ""
    if not all(isinstance(item, str | float | int) for item in value):
        return ""
    if len(value) > _MOST_VALUES and not isinstance(value[0], str):
        return f"{len(value)} values"
    return "<br>".join(map(_short, value))


def _records(value: Any) -> str:
    """Lay out structures or values of one kind as rows, behind their names if any."""
    has_names = isinstance(value, Mapping)
    records = list(value.values()) if has_names else list(value)
    shown_records = records[:_MOST_ROWS]

    columns: list[str] = []
    cells = [[_short(record)] for record in shown_records]
    if shown_records and isinstance(shown_records[0], msgspec.Struct):
        columns, cells = _cells_of_structs(shown_records)
    if has_names:
        columns = ["", *columns] if columns else columns
        names = [escape(str(name)) for name in value]
        cells = [[name, *row] for name, row in zip(names, cells, strict=False)]

    n_hidden = len(records) - len(shown_records)
    ending = f"<p>and {n_hidden} more</p>" if n_hidden else ""
    return _table(columns, cells) + ending


def _cells_of_structs(
    records: Sequence[msgspec.Struct],
) -> tuple[list[str], list[list[str]]]:
    """Return columns and rows of structures, without columns that are all empty."""
    texts = []
    for record in records:
        fields = _fields(record)
        texts.append({name: _short(item) for name, item in fields.items()})
    columns = []
    for name in texts[0]:
        if any(text[name] for text in texts):
            columns.append(name)
    rows = [list(map(text.__getitem__, columns)) for text in texts]
    return columns, rows


def _table(columns: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    """Write a table; its cells are marked up already."""
    head = "".join(f"<th>{escape(name)}</th>" for name in columns)
    top = f"<thead><tr>{head}</tr></thead>" if head else ""
    body = ""
    for row in rows:
        cells = "".join(f"<td>{cell}</td>" for cell in row)
        body += f"<tr>{cells}</tr>"
    return f"<table>{top}<tbody>{body}</tbody></table>"
