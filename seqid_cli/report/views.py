"""Figures, tables and sections for the templates: plain data, no HTML but finished drawings."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

from markupsafe import Markup

from seqid_cli.params.results.tables import WORDS, Values
from seqid_cli.params.schema import Verdict
from seqid_cli.report.words import effect_words, number, percent, short_path, unit_text

Cell = str | Markup


@dataclass(frozen=True)
class Column:
    """A column of a table; `numeric` ones are set to the right."""

    title: str
    numeric: bool = False
    unit: str = ""


def texts(*titles: str) -> list[Column]:
    """Return columns of text."""
    return [Column(title) for title in titles]


def numbers(*titles: str, unit: str = "") -> list[Column]:
    """Return columns of numbers in one unit."""
    return [Column(title, numeric=True, unit=unit) for title in titles]


VALUE_COLUMNS = [
    *texts("parameter"),
    *numbers("value", "std error", "95 % interval"),
    *texts("unit"),
]


@dataclass(frozen=True)
class Table:
    """Rows of finished text; `caption` names them, `style` is the class of the table."""

    caption: str
    columns: Sequence[Column]
    rows: Sequence[Sequence[Cell]]
    note: str = ""
    folded: bool = False
    style: str = ""


def table_of(caption: str, found: Values, note: str = "", *, folded: bool = False) -> Table:
    """Return values as a table of the page."""
    columns = [Column(h.title, h.kind not in WORDS, unit_text(h.unit)) for h in found.heads]
    cells = found.cells(number, percent, effect=effect_words, path=short_path)
    return Table(caption, columns, cells, note, folded)


@dataclass(frozen=True)
class Key:
    """One entry of a legend; `style` is the class that the line has in the drawing."""

    style: str
    text: str


@dataclass(frozen=True)
class Figure:
    """A drawing with its title, legend and the table of its values."""

    title: str
    drawing: Markup
    legend: Sequence[Key] = ()
    table: Table | None = None
    note: str = ""
    wide: bool = False


@dataclass(frozen=True)
class Absent:
    """Data that a section lacks, and the command that makes them."""

    text: str
    command: str = ""


@dataclass(frozen=True)
class Group:
    """Part of a section with a heading of its own."""

    id: str
    title: str
    lead: str = ""
    joint: str = ""  # that it is about
    badge: str = ""  # good, poor, open, or nothing
    badge_text: str = ""
    facts: Sequence[tuple[str, str]] = ()
    figures: Sequence[Figure] = ()
    tables: Sequence[Table] = ()  # those without rows are left out
    notes: Sequence[str] = ()
    absent: Sequence[Absent] = ()
    unfolded: bool = False  # tables stand open


def badge(verdicts: Sequence[Verdict]) -> tuple[str, str]:
    """Return the badge of some verdicts and its text: nothing without any."""
    if not verdicts:
        return "", ""
    state = "good" if all(verdict.good for verdict in verdicts) else "poor"
    return state, state


def badge_text(state: str, text: str) -> Markup:
    """Return a badge with its text for a cell of a table."""
    return Markup('<span class="badge {}">{}</span>').format(state or "none", text)


@dataclass(frozen=True)
class Section:
    """A part of the page; `template` renders what `data` holds beyond the groups."""

    id: str
    title: str
    lead: str = ""
    groups: Sequence[Group] = ()
    tables: Sequence[Table] = ()
    figures: Sequence[Figure] = ()
    absent: Sequence[Absent] = ()
    notes: Sequence[str] = ()
    template: str = ""
    data: dict[str, object] = field(default_factory=dict)
