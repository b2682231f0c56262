"""One page about what changed over dates, on any number of robots."""

from datetime import datetime

import numpy as np

from seqid_cli.params.results.tables import changes
from seqid_cli.params.results.trend import ChangeEntry, SeriesEntry, TrendFile
from seqid_cli.report.figures.chart import Box, Panel, drawing
from seqid_cli.report.figures.svg import line, padded
from seqid_cli.report.judgement import Judgement
from seqid_cli.report.views import Figure, Group, Page, Section, table, table_of
from seqid_cli.report.words import number, plural

_WIDTH, _HEIGHT = 640.0, 170.0
_DAY = 86400.0
_INTERVAL = 1.96  # standard errors


def trend_page(file: TrendFile, path: str, *, title: str = "") -> Page:
    """Return the page about the trend at `path`; `title` instead of the number of robots."""
    names = list(dict.fromkeys(entry.robot for entry in file.changes))  # clearest change first
    judgement = Judgement("good", "Nothing changed beyond its error.", (), ())
    if names:
        text = f"{plural(len(file.changes), 'change')} beyond the error: {', '.join(names)}."
        judgement = Judgement("poor", text, (), ())
    changed, robots = {_key(entry) for entry in file.changes}, []
    for place, name in enumerate(names, start=1):
        own = [x for x in file.series if x.robot == name and _key(x) in changed]
        group = Group(f"series-{place}", "Over time", figures=list(map(_figure, own)))
        robots.append(Section(f"robot-{place}", name, groups=[group]))
    return Page(
        title or plural(len(file.robots), "robot"),
        [plural(len(file.files), "parameter file"), f"{len(file.series)} series"],
        judgement,
        [_overview(file, judgement), *robots],
        ", ".join(file.robots),
        [path],
        subject="Trend",
    )


def _overview(file: TrendFile, judgement: Judgement) -> Section:
    lead = (
        f"{judgement.sentence} A change counts from {number(file.limit)} standard errors on: all "
        "steps between two dates and all lines over time were tried, quantity by quantity."
    )
    inflated = [f"{stage} {number(x)}" for stage, x in file.inflation.items() if x > 1.0]
    notes = list(file.notes)
    if inflated:
        notes.append(f"Standard errors were taken larger by these factors: {', '.join(inflated)}")
    shown = table_of("Changes, the clearest first", changes(file.changes))
    groups = [Group("changes", "All changes", tables=[shown], unfolded=True)]
    return Section("verdict", "What changed", lead, groups if file.changes else [], notes=notes)


def _key(entry: ChangeEntry | SeriesEntry) -> tuple[str, str, str, str]:
    return entry.robot, entry.stage, entry.joint, entry.name


def _figure(series: SeriesEntry) -> Figure:
    """Values with 95 % intervals over days since the first date."""
    times = [datetime.fromisoformat(date).timestamp() for date in series.dates]
    days = [(time - times[0]) / _DAY for time in times]
    values, half = np.array(series.values), _INTERVAL * np.array(series.std_errors)
    panel = Panel(
        Box(64, 22, _WIDTH - 84, _HEIGHT),
        padded(0.0, max(days[-1], 1.0), 0.02),
        padded(float(min(values - half)), float(max(values + half))),
        x_title=f"days since {series.dates[0][:10]}",
        y_title=series.unit,
        hover="time|d",
    )
    for x, y, low, high in zip(days, values, values - half, values + half, strict=True):
        at = panel.x(x)
        panel.add(line("whisker", at, panel.y(low), at, panel.y(high)))
        panel.add(line("spot", at, panel.y(y), at, panel.y(y)))
    what = " ".join(part for part in (series.joint, series.stage, series.name) if part)
    panel.line(days, values, "predicted", name=what, unit=series.unit)
    text = f"{what} from {number(values[0])} to {number(values[-1])} {series.unit}"
    rows = zip((date[:10] for date in series.dates), series.values, series.std_errors, strict=True)
    titles, kinds = "date | value [{unit}] | std error", "text number5 number2"
    shown = table(what, titles, kinds, rows, unit=series.unit)
    return Figure(what, drawing(_WIDTH, _HEIGHT + 66, what, text, [panel]), table=shown)
