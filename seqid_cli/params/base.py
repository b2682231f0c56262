"""The base of all documents: strict structures, and how a notebook shows them.

Whatever a document holds is laid out by its own shape: structures that lie in a list or
by name in a dictionary as the rows of one table, other values by their names. Long
lists are counted.
"""

from collections.abc import Mapping, Sequence
from html import escape
from typing import Any

import msgspec

_MOST_ROWS, _MOST_VALUES = 60, 6
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
    """A structure that a notebook shows as tables."""

    def _repr_html_(self) -> str:
        """Return the content as tables."""
        return f'<div class="seqid">{_tables(self)}</div>'


def _fields(struct: msgspec.Struct) -> dict[str, object]:
    return {
        x: getattr(struct, x) for x in struct.__struct_fields__ if x not in _LEFT_OUT
    }


def _tables(value: Any) -> str:
    """A structure: short values in one table, then a part for each longer one; or many as rows."""
    if isinstance(value, list) and not isinstance(value[0], msgspec.Struct):
        return f"{len(value)} rows"
    if not isinstance(value, msgspec.Struct):
        return _records(value)
    values = _fields(value)
    rows = [(name, text) for name, own in values.items() if (text := _short(own))]
    parts = [_table((), rows)] if rows else []
    for name, own in values.items():
        if own and not _short(own) and (inner := _tables(own)):
            parts.append(
                f"<details open><summary>{escape(name)}</summary>{inner}</details>"
            )
    return "".join(parts)


def _short(value: object) -> str:
    """A value in one cell; empty where there is nothing, or too much for a cell."""
    if isinstance(value, float):
        return f"{value:.4g}"
    if isinstance(value, str | int):
        return escape(str(value))
    if isinstance(value, Sequence) and all(
        isinstance(x, str | float | int) for x in value
    ):
        if len(value) > _MOST_VALUES and not isinstance(value[0], str):
            return f"{len(value)} values"
        return "<br>".join(map(_short, value))
    return ""


def _records(value: Any) -> str:
    """Structures or values of one kind as rows, behind their names where they have any."""
    names = list(map(str, value)) if isinstance(value, Mapping) else []
    records = list(value.values()) if isinstance(value, Mapping) else list(value)
    shown = records[:_MOST_ROWS]
    columns: list[str] = []
    cells = [[_short(record)] for record in shown]
    if shown and isinstance(shown[0], msgspec.Struct):
        texts = [
            {x: _short(own) for x, own in _fields(record).items()} for record in shown
        ]
        columns = [x for x in texts[0] if any(text[x] for text in texts)]
        cells = [[text[x] for x in columns] for text in texts]
    if names:
        columns = ["", *columns] if columns else columns
        cells = [[escape(name), *row] for name, row in zip(names, cells, strict=False)]
    rest = len(records) - len(shown)
    return _table(columns, cells) + (f"<p>and {rest} more</p>" if rest else "")


def _table(columns: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    head = "".join(f"<th>{escape(name)}</th>" for name in columns)
    body = "".join(
        "<tr>" + "".join(f"<td>{x}</td>" for x in row) + "</tr>" for row in rows
    )
    top = f"<thead><tr>{head}</tr></thead>" if head else ""
    return f"<table>{top}<tbody>{body}</tbody></table>"
