"""The base of all documents: strict structures, and how a notebook shows them.

Whatever a document holds is laid out by its own shape: structures that lie in a list or by name in
a dictionary as the rows of one table, other values by their names. Long lists are counted.
"""

from collections.abc import Mapping, Sequence
from html import escape

import msgspec

_MOST_ROWS, _MOST_VALUES = 60, 6
_LEFT_OUT = frozenset({"schema", "created", "tool", "inputs", "covariance", "representative"})


class FrozenStruct(
    msgspec.Struct, forbid_unknown_fields=True, kw_only=True, omit_defaults=False, frozen=True
):
    """Base of structures that never change, and so can be in a set."""


class Struct(msgspec.Struct, forbid_unknown_fields=True, kw_only=True, omit_defaults=False):
    """Base of all file structures: an unknown key is an error that names its path."""


class Document(Struct):
    """A structure that a notebook shows as tables."""

    def _repr_html_(self) -> str:
        """Return the content as tables."""
        return f'<div class="seqid">{_fields(self)}</div>'


def _fields(struct: object) -> str:
    """The fields of a structure: short values in one table, then a part for each longer one."""
    names = [name for name in getattr(struct, "__struct_fields__", ()) if name not in _LEFT_OUT]
    values = {name: getattr(struct, name) for name in names}
    short = {name: _short(value) for name, value in values.items()}
    rows = [(name, text) for name, text in short.items() if text]
    parts = [_table((), rows)] if rows else []
    for name, value in values.items():
        inner = ""
        if short[name] is not None:
            continue
        if isinstance(value, msgspec.Struct):
            inner = _fields(value)
        elif isinstance(value, Mapping):
            inner = _records(list(value.values()), list(map(str, value)))
        elif isinstance(value, Sequence) and all(isinstance(x, msgspec.Struct) for x in value):
            inner = _records(value, [])
        if inner:
            title = f"<summary>{escape(name)}</summary>"
            parts.append(f"<details open>{title}{inner}</details>")
    return "".join(parts)


def _short(value: object) -> str | None:
    """A value in one cell ("" where there is nothing); None where it takes a part of its own."""
    if value is None or (isinstance(value, Sequence | Mapping) and not value):
        return ""
    if isinstance(value, float):
        return f"{value:.4g}"
    if isinstance(value, str | int | bool):
        return escape(str(value))
    if isinstance(value, Sequence) and all(isinstance(x, str | float | int) for x in value):
        if len(value) > _MOST_VALUES and not isinstance(value[0], str):
            return f"{len(value)} values"
        return "<br>".join(str(_short(x)) for x in value)
    return None


def _records(records: Sequence[object], names: Sequence[str]) -> str:
    """Structures of one kind as rows, behind their names where they have any."""
    shown = records[:_MOST_ROWS]
    if not all(isinstance(record, msgspec.Struct) for record in shown):
        rows = [(name, _short(record) or "") for name, record in zip(names, shown, strict=False)]
        return _table((), rows)
    fields = [name for name in getattr(shown[0], "__struct_fields__", ()) if name not in _LEFT_OUT]
    columns = [n for n in fields if any(_short(getattr(record, n, None)) for record in shown)]
    cells = [[_short(getattr(record, n, None)) or "" for n in columns] for record in shown]
    if names:
        columns = ["", *columns]
        cells = [[escape(name), *row] for name, row in zip(names, cells, strict=False)]
    rest = len(records) - len(shown)
    return _table(columns, cells) + (f"<p>and {rest} more</p>" if rest else "")


def _table(columns: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    head = "".join(f"<th>{escape(name)}</th>" for name in columns)
    body = "".join("<tr>" + "".join(f"<td>{x}</td>" for x in row) + "</tr>" for row in rows)
    return (
        f"<table>{f'<thead><tr>{head}</tr></thead>' if head else ''}<tbody>{body}</tbody></table>"
    )
