"""One page about what changed over dates, on any number of robots."""

from __future__ import annotations

from datetime import datetime

from seqid_cli.params.results.tables import changes
from seqid_cli.params.results.trend import ChangeEntry, SeriesEntry, TrendFile
from seqid_cli.report.figures.chart import Box, Panel, drawing
from seqid_cli.report.figures.svg import line, padded
from seqid_cli.report.judgement import Judgement
from seqid_cli.report.page import render
from seqid_cli.report.views import Figure, Group, Section, Table, numbers, table_of, texts
from seqid_cli.report.words import number, plural

_WIDTH, _HEIGHT = 640.0, 170.0
_DAY = 86400.0
_INTERVAL = 1.96  # standard errors


def trend_page(file: TrendFile, *, title: str = "") -> tuple[str, Judgement, list[Section]]:
    """Return the page, its verdict and its sections.

    `title`: instead of the number of robots.
    """
    judgement = _judged(file)
    sections = [_overview(file, judgement), *(_robot(file, name) for name in _changed(file))]
    about = [plural(len(file.files), "parameter file"), f"{len(file.series)} series"]
    name = title or plural(len(file.robots), "robot")
    html = render(name, about, judgement, sections, subject="Trend")
    return html, judgement, sections


def _changed(file: TrendFile) -> list[str]:
    """Robots that changed, in the order of their clearest change."""
    return list(dict.fromkeys(entry.robot for entry in file.changes))


def _judged(file: TrendFile) -> Judgement:
    names = _changed(file)
    if not names:
        return Judgement("good", "Nothing changed beyond its error.", (), ())
    changed = plural(len(file.changes), "change")
    return Judgement("poor", f"{changed} beyond the error: {', '.join(names)}.", (), ())


def _overview(file: TrendFile, judgement: Judgement) -> Section:
    lead = (
        f"{judgement.sentence} A change counts from {number(file.limit)} standard errors on: all "
        "steps between two dates and all lines over time were tried, quantity by quantity."
    )
    made = [table_of("Changes, the clearest first", changes(file.changes))] if file.changes else []
    inflated = [f"{stage} {number(x)}" for stage, x in file.inflation.items() if x > 1.0]
    notes = list(file.notes)
    if inflated:
        notes.append(f"Standard errors were taken larger by these factors: {', '.join(inflated)}")
    group = Group("changes", "All changes", tables=made, unfolded=True)
    return Section("verdict", "What changed", lead, [group] if made else [], notes=notes)


def _robot(file: TrendFile, name: str) -> Section:
    """The series of one robot that changed."""
    place = _changed(file).index(name) + 1
    own = {_key(entry) for entry in file.changes if entry.robot == name}
    figures = [_figure(series) for series in file.series if _key(series) in own]
    group = Group(f"series-{place}", "Over time", figures=figures)
    return Section(f"robot-{place}", name, groups=[group])


def _key(entry: ChangeEntry | SeriesEntry) -> tuple[str, str, str, str]:
    return entry.robot, entry.stage, entry.joint, entry.name


def _figure(series: SeriesEntry) -> Figure:
    """Values with 95 % intervals over days since the first date."""
    times = [datetime.fromisoformat(date).timestamp() for date in series.dates]
    days = [(time - times[0]) / _DAY for time in times]
    half = [_INTERVAL * error for error in series.std_errors]
    pairs = list(zip(days, series.values, half, strict=True))
    low, high = min(y - e for _, y, e in pairs), max(y + e for _, y, e in pairs)
    panel = Panel(
        Box(64, 22, _WIDTH - 84, _HEIGHT),
        padded(0.0, max(days[-1], 1.0), 0.02),
        padded(low, high),
        x_title=f"days since {series.dates[0][:10]}",
        y_title=series.unit,
        hover="time|d",
    )
    for day, value, error in pairs:
        x = panel.x(day)
        panel.add(line("whisker", x, panel.y(value - error), x, panel.y(value + error)))
        panel.add(line("spot", x, panel.y(value), x, panel.y(value)))
    what = " ".join(part for part in (series.joint, series.stage, series.name) if part)
    panel.line([(day, value) for day, value, _ in pairs], "predicted", name=what, unit=series.unit)
    text = f"{what} from {number(series.values[0])} to {number(series.values[-1])} {series.unit}"
    columns = (*texts("date"), *numbers("value", unit=series.unit), *numbers("std error"))
    rows = [
        (date[:10], number(value, 5), number(error, 2))
        for date, value, error in zip(series.dates, series.values, series.std_errors, strict=True)
    ]
    table = Table(what, columns, rows)
    return Figure(what, drawing(_WIDTH, _HEIGHT + 66, what, text, [panel]), table=table)
