"""Figures, tables and sections for the templates: plain data and finished drawings.

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
from typing import Any, Literal, NamedTuple

from markupsafe import Markup

from seqid_cli import __version__
from seqid_cli.params.document import worst_level
from seqid_cli.params.results.tables import Values, heads, values
from seqid_cli.params.schema import Verdict
from seqid_cli.report import words
from seqid_cli.report.judgement import Judgement
from seqid_cli.templates import filled
from seqid_cli.visible import visible

Legend = Mapping[str, str]  # what a line is, by the class that it has in the drawing
VALUE_HEADS = heads(
    "parameter | value | std error | 95 % interval | unit",
    "text number number number text",
)


@dataclass(frozen=True, kw_only=True)
class Table:
    """Values under their heads.

    Parameters
    ----------
    caption : str
    values : Values
    note : str
        Text below the table.
    folded : bool
        Whether a click has to open it.
    style : str
        Class of the table in the style sheet.
    """

    caption: str
    values: Values
    note: str = ""
    folded: bool = False
    style: str = ""

    @cached_property
    def rows(self) -> Sequence[Sequence[str]]:
        """Rows of the values as text."""
        return self.values.cells(
            words.number,
            words.percent,
            effect=words.effect_words,
            path=words.short_path,
            unit=words.unit_text,
        )


def table(
    caption: str, titles: str, kinds: str, rows: Iterable[Sequence[Any]], **names: str
) -> Table:
    """Return rows of values as a table of the page.

    Parameters
    ----------
    caption : str
    titles, kinds : str
        Titles and kinds of the columns, as `params.results.tables.heads` takes them.
    rows : iterable of sequences
    **names : str
        What stands for places in braces in the titles.

    Returns
    -------
    Table
    """
    return Table(caption=caption, values=values(titles, kinds, rows, **names))


def value_row(
    name: str, value: float | None, error: float | None, unit: str
) -> tuple[str, ...]:
    """Return the cells of an estimate under `VALUE_HEADS`.

    Parameters
    ----------
    name : str
    value : float, optional
        None where it is not determined.
    error : float, optional
        Standard error; zero of a value that is fixed.
    unit : str

    Returns
    -------
    tuple of str
    """
    unit = words.unit_text(unit)
    if value is None or error is None:
        return name, "not determined", words.DASH, words.DASH, unit
    shown_value, shown_error = words.number(value), "fixed"
    if error > 0.0:
        shown_value, shown_error = words.with_error(value, error)
    return name, shown_value, shown_error, words.interval(value, error), unit


@dataclass(frozen=True, kw_only=True)
class Figure:
    """A drawing with its title, legend and the table of its values.

    Parameters
    ----------
    title : str
    drawing : Markup
        Finished SVG.
    legend : Legend
    table : Table, optional
    note : str
        Text below the drawing.
    width : {"small", "wide", "full"}
        Whether it takes a third, half or all of the page's width.
    joint : str
        The joint that it is about, where it stands in a group about several: the page
        hides it when another joint is chosen.
    """

    title: str
    drawing: Markup
    legend: Legend
    table: Table | None = None
    note: str = ""
    width: Literal["small", "wide", "full"] = "small"
    joint: str = ""


class Absent(NamedTuple):
    """Data that a section lacks, and the command that makes them."""

    text: str
    command: str


@dataclass(frozen=True, kw_only=True)
class Group:
    """Part of a section with a heading of its own.

    Parameters
    ----------
    id : str
        Anchor on the page.
    title : str
    lead : str
        Text below the title.
    joint : str
        The joint that the group is about.
    badge : str
        "good", "poor", "open", or nothing.
    badge_text : str
        Text on the badge, if other than its name.
    facts : sequence of pairs of str
        Names and values.
    figures : sequence of Figure or None
        None is left out.
    tables : sequence of Table
        Those without rows are left out.
    notes : sequence of str
    absent : sequence of Absent
    unfolded : bool
        Whether tables stand open.
    """

    id: str
    title: str
    lead: str = ""
    joint: str = ""
    badge: str = ""
    badge_text: str = ""
    facts: Sequence[tuple[str, str]] = ()
    figures: Sequence[Figure | None] = ()
    tables: Sequence[Table] = ()
    notes: Sequence[str] = ()
    absent: Sequence[Absent] = ()
    unfolded: bool = False


def badge(verdicts: Sequence[Verdict]) -> str:
    """Return the badge of some verdicts: nothing without any."""
    return worst_level(verdicts) or ""


def reasons(verdicts: Sequence[Verdict]) -> str:
    """Return the reasons of verdicts, each once.

    Where several joints are judged, each reason has the names of its joints before it.
    """
    joints_of: dict[str, list[str]] = {}
    for verdict in verdicts:
        if verdict.reason:
            names = joints_of.setdefault(verdict.reason, [])
            if verdict.joint:
                names.append(verdict.joint)
    several = len({verdict.joint for verdict in verdicts if verdict.joint}) > 1
    return "; ".join(
        f"{', '.join(names)}: {reason}" if names and several else reason
        for reason, names in joints_of.items()
    )


@dataclass(frozen=True, kw_only=True)
class Section:
    """A part of the page.

    Parameters
    ----------
    id : str
        Anchor on the page.
    title : str
    lead : str
        Text below the title.
    groups : sequence of Group
    tables : sequence of Table
        Those without rows are left out.
    absent : sequence of Absent
    notes : sequence of str
    judgement : Judgement, optional
        At the head of the first section.
    glance : Table, optional
        The joints at a glance, beside the judgement.
    """

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
        """True where all its data were given."""
        return not self.absent and not any(group.absent for group in self.groups)


def lacking(key: str, title: str, text: str, command: str) -> Section:
    """Return a section without its data.

    Parameters
    ----------
    key : str
        Anchor on the page.
    title : str
    text : str
        What is lacking.
    command : str
        The command that makes it.

    Returns
    -------
    Section
    """
    return Section(id=key, title=title, absent=[Absent(text, command)])


@dataclass(frozen=True, kw_only=True)
class Page:
    """The content of a page.

    Parameters
    ----------
    title : str
    about : sequence of str
        Facts under the title.
    judgement : Judgement
    sections : sequence of Section
    robot : str
        Name of the robot, or names of all.
    files : sequence of str
        Documents that the page was made of.
    created : str
        The newest date of these.
    subject : str
        What the page is about.
    torques : sequence of str
        Torque files that the page was made of.
    warnings : sequence of str
        About files that fit, but not perfectly.
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
        style = style_sheet()
        script = resource("script.js")

        # The browser runs and loads nothing but these two.
        policy = (
            f"default-src 'none'; style-src '{_hash_of(style)}';"
            f" script-src '{_hash_of(script)}'; img-src data:; base-uri 'none';"
            " form-action 'none'"
        )
        content = {
            "page": self,
            "version": __version__,
            "policy": policy,
            "style": style,
            "script": script,
        }
        text = filled(
            "seqid_cli.report",
            "report.html.j2",
            content,
            filters={"unit": words.unit_text, "short": words.short_path},
            markup=True,
        )
        # A name may hold marks that turn text, or end a line: they are shown.
        return visible(text)


def _hash_of(text: str) -> str:
    """Return the hash by which a policy names a style sheet or a script."""
    digest = hashlib.sha256(text.encode()).digest()
    return f"sha256-{base64.b64encode(digest).decode()}"


def style_sheet() -> str:
    """Return the style of a page: that of its drawings, and that around them."""
    return resource("drawing.css") + resource("style.css")


def resource(name: str) -> str:
    """Return a file of the templates as text."""
    return (files("seqid_cli.report") / "templates" / name).read_text(encoding="utf-8")
