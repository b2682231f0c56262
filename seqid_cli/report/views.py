"""Figures, tables and sections for the templates: plain data, no HTML but finished drawings.

Everything that comes from a file is escaped by the templates. The page may not load
anything: its policy names the style sheet and the script by their hashes and forbids
everything else.
"""

import base64
import hashlib
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from importlib.resources import files
from typing import Any, NamedTuple

from markupsafe import Markup

from seqid_cli import __version__
from seqid_cli.model.effects.units import UNTOLD
from seqid_cli.params.document import worst_level
from seqid_cli.params.results.tables import Values, heads, values
from seqid_cli.params.schema import Verdict
from seqid_cli.report import words
from seqid_cli.report.judgement import Judgement
from seqid_cli.templates import filled

Legend = Mapping[str, str]  # what a line is, by the class that it has in the drawing
VALUE_HEADS = heads(
    "parameter | value | std error | 95 % interval | unit",
    "text number number number text",
)


@dataclass(frozen=True)
class Table:
    """Values under their heads; `caption` names them, `style` is the class of the table."""

    caption: str
    values: Values
    note: str = ""
    folded: bool = False
    style: str = ""

    @cached_property
    def rows(self) -> Sequence[Sequence[str]]:
        """The values as text."""
        forms = {
            "effect": words.effect_words,
            "path": words.short_path,
            "unit": words.unit_text,
        }
        return self.values.cells(words.number, words.percent, **forms)


def table(
    caption: str, titles: str, kinds: str, rows: Iterable[Sequence[Any]], **names: str
) -> Table:
    """Return rows of values under `heads` as a table of the page."""
    return Table(caption, values(titles, kinds, rows, **names))


def value_row(
    name: str, value: float | None, error: float | None, unit: str
) -> tuple[str, ...]:
    """Return the cells of an estimate under `VALUE_HEADS`; without an error it is fixed."""
    if value is None or error is None or error >= UNTOLD:
        return name, "not determined", words.DASH, words.DASH, words.unit_text(unit)
    texts = (
        words.with_error(value, error)
        if error > 0.0
        else (words.number(value), "fixed")
    )
    return name, *texts, words.interval(value, error), words.unit_text(unit)


@dataclass(frozen=True)
class Figure:
    """A drawing with its title, legend and the table of its values.

    `joint` names the joint that it is about, where it stands in a group about several:
    the page hides it when another joint is chosen.
    """

    title: str
    drawing: Markup
    legend: Legend
    table: Table | None = None
    note: str = ""
    wide: bool = False
    joint: str = ""


class Absent(NamedTuple):
    """Data that a section lacks, and the command that makes them."""

    text: str
    command: str


@dataclass(frozen=True)
class Group:
    """Part of a section with a heading of its own."""

    id: str
    title: str
    lead: str = ""
    joint: str = ""  # that it is about
    badge: str = ""  # good, poor, open, or nothing
    badge_text: str = ""  # if other than the badge
    facts: Sequence[tuple[str, str]] = ()
    figures: Sequence[Figure | None] = ()
    tables: Sequence[Table] = ()  # those without rows are left out
    notes: Sequence[str] = ()
    absent: Sequence[Absent] = ()
    unfolded: bool = False  # tables stand open


def badge(verdicts: Sequence[Verdict]) -> str:
    """Return the badge of some verdicts: nothing without any."""
    return worst_level(verdicts) or ""


def reasons(verdicts: Sequence[Verdict]) -> str:
    """Return why verdicts are what they are."""
    return "; ".join(verdict.reason for verdict in verdicts if verdict.reason)


@dataclass(frozen=True)
class Section:
    """A part of the page; `judgement` and the table `glance` stand at the head of the first."""

    id: str
    title: str
    lead: str = ""
    groups: Sequence[Group] = ()
    tables: Sequence[Table] = ()
    absent: Sequence[Absent] = ()
    notes: Sequence[str] = ()
    judgement: Judgement | None = None
    glance: Table | None = None

    @property
    def complete(self) -> bool:
        """Whether all its data were given."""
        return not self.absent and not any(group.absent for group in self.groups)


def lacking(key: str, title: str, text: str, command: str) -> Section:
    """Return a section without its data: what is lacking, and the command that makes it."""
    return Section(key, title, absent=[Absent(text, command)])


@dataclass(frozen=True)
class Page:
    """The content of a page.

    `about` are facts under its title, `subject` says what it is about; `robot`, `files`
    and `torques` name what it was made of, `created` is the newest date of that,
    `warnings` are about files that fit, but not perfectly.
    """

    title: str
    about: Sequence[str]
    judgement: Judgement
    sections: Sequence[Section]
    robot: str
    files: Sequence[str]
    created: str
    subject: str = "Dynamic model"
    torques: Sequence[str] = ()
    warnings: Sequence[str] = ()

    @property
    def html(self) -> str:
        """The page as one text."""
        parts = {"style": resource("style.css"), "script": resource("script.js")}
        policy = "default-src 'none'; "
        for name, text in parts.items():
            digest = base64.b64encode(hashlib.sha256(text.encode()).digest()).decode()
            policy += f"{name}-src 'sha256-{digest}'; "
        policy += "img-src data:; base-uri 'none'; form-action 'none'"
        content = {"page": self, "version": __version__, "policy": policy} | parts
        filters = {"unit": words.unit_text, "short": words.short_path}
        return filled(
            "seqid_cli.report", "report.html.j2", content, filters=filters, markup=True
        )


def resource(name: str) -> str:
    """Return a file of the templates as text."""
    return (files("seqid_cli.report") / "templates" / name).read_text(encoding="utf-8")
