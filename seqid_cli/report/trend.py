"""One page about what changed over dates, on any number of robots."""

from collections.abc import Sequence
from datetime import datetime

import numpy as np

from seqid_cli.params.dates import created_from
from seqid_cli.params.results.tables import changes
from seqid_cli.params.results.trend import ChangeEntry, SeriesEntry, TrendFile
from seqid_cli.report.chart import figure, padded, small_panel
from seqid_cli.report.judgement import Judgement
from seqid_cli.report.views import Figure, Group, Page, Section, Table, table
from seqid_cli.report.words import Z95, number, plural

_DAY_S = 86400.0


def trend_page(file: TrendFile, path: str, *, title: str = "") -> Page:
    """Return the page about a trend.

    Parameters
    ----------
    file : TrendFile
    path : str
        Path of the file.
    title : str
        Instead of the number of robots.

    Returns
    -------
    Page
    """
    # Robots in the order of their clearest change.
    changed_robots = list(dict.fromkeys(entry.robot for entry in file.changes))
    judgement = _judgement(file, changed_robots)
    return Page(
        title=title or plural(len(file.robots), "robot"),
        about=[
            plural(len(file.files), "parameter file"),
            f"{len(file.series)} series",
        ],
        judgement=judgement,
        sections=[_overview(file, judgement), *_robot_sections(file, changed_robots)],
        robot=", ".join(file.robots),
        files=[path],
        created=created_from([file]),
        subject="Trend",
    )


def _judgement(file: TrendFile, changed_robots: Sequence[str]) -> Judgement:
    """Return poor where anything changed beyond its error, else good."""
    if not changed_robots:
        return Judgement("good", "Nothing changed beyond its error.", (), ())
    text = (
        f"{plural(len(file.changes), 'change')} beyond the error:"
        f" {', '.join(changed_robots)}."
    )
    return Judgement("poor", text, (), ())


def _overview(file: TrendFile, judgement: Judgement) -> Section:
    """Return the section with the verdict and a table of all changes."""
    lead = (
        f"{judgement.sentence} A change counts from {number(file.limit)} standard"
        " errors on: all steps between two dates and all lines over time were tried,"
        " quantity by quantity."
    )
    notes = list(file.notes)
    inflated = [
        f"{stage} {number(factor)}"
        for stage, factor in file.inflation.items()
        if factor > 1.0
    ]
    if inflated:
        notes.append(
            f"Standard errors were taken larger by these factors: {', '.join(inflated)}"
        )

    groups = []
    if file.changes:
        all_changes = Table(
            caption="Changes, the clearest first", values=changes(file.changes)
        )
        group = Group(
            id="changes", title="All changes", tables=[all_changes], unfolded=True
        )
        groups.append(group)
    return Section(
        id="verdict", title="What changed", lead=lead, groups=groups, notes=notes
    )


def _robot_sections(file: TrendFile, changed_robots: Sequence[str]) -> list[Section]:
    """Return a section on each robot that changed, with its series that did."""
    changed = {_key(entry) for entry in file.changes}
    sections = []
    for place, name in enumerate(changed_robots, start=1):
        figures = [
            _figure(series)
            for series in file.series
            if series.robot == name and _key(series) in changed
        ]
        group = Group(id=f"series-{place}", title="Over time", figures=figures)
        sections.append(Section(id=f"robot-{place}", title=name, groups=[group]))
    return sections


def _key(entry: ChangeEntry | SeriesEntry) -> tuple[str, str, str, str]:
    """Return the name of the quantity that an entry is about."""
    return entry.robot, entry.stage, entry.joint, entry.name


def _figure(series: SeriesEntry) -> Figure:
    """Draw values with 95 % intervals over days since the first date."""
    times = np.array(
        [datetime.fromisoformat(date).timestamp() for date in series.dates]
    )
    days = (times - times[0]) / _DAY_S
    values = np.array(series.values)
    half_width = Z95 * np.array(series.std_errors)

    edges = np.concatenate([values - half_width, values + half_width])
    panel = small_panel(
        (f"days since {series.dates[0][:10]}", ""),
        padded([0.0, max(days[-1], 1.0)], 0.02),
        series.unit,
        padded(edges),
    )
    panel.hover = "time|d"
    panel.band(days, values - half_width, values + half_width, "cut0")
    parts = (series.joint, series.stage, series.name)
    title = " ".join(part for part in parts if part)
    panel.line(days, values, "predicted", name=title, unit=series.unit)

    text = f"{title} from {number(values[0])} to {number(values[-1])} {series.unit}"
    dates = [date[:10] for date in series.dates]
    rows = table(
        title,
        "date | value [{unit}] | std error",
        "text number5 number2",
        zip(dates, series.values, series.std_errors, strict=True),
        unit=series.unit,
    )
    return figure([panel], title, text, {}, rows)
