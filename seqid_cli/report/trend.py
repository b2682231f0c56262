"""One page about what changed over dates, on any number of robots."""

from datetime import datetime

import numpy as np

from seqid_cli.params.dates import created_from
from seqid_cli.params.results.tables import changes
from seqid_cli.params.results.trend import ChangeEntry, SeriesEntry, TrendFile
from seqid_cli.report.chart import figure, padded, small_panel
from seqid_cli.report.judgement import Judgement
from seqid_cli.report.views import Figure, Group, Page, Section, Table, table
from seqid_cli.report.words import Z95, number, plural

_DAY = 86400.0


def trend_page(file: TrendFile, path: str, *, title: str = "") -> Page:
    """Return the page about the trend at `path`; `title` instead of the number of robots."""
    # clearest change first
    names = list(dict.fromkeys(entry.robot for entry in file.changes))
    judgement = Judgement("good", "Nothing changed beyond its error.", (), ())
    if names:
        text = (
            f"{plural(len(file.changes), 'change')} beyond the error:"
            f" {', '.join(names)}."
        )
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
        created_from([file]),
        subject="Trend",
    )


def _overview(file: TrendFile, judgement: Judgement) -> Section:
    lead = (
        f"{judgement.sentence} A change counts from {number(file.limit)} standard"
        " errors on: all steps between two dates and all lines over time were tried,"
        " quantity by quantity."
    )
    inflated = [
        f"{stage} {number(x)}" for stage, x in file.inflation.items() if x > 1.0
    ]
    notes = list(file.notes)
    if inflated:
        notes.append(
            f"Standard errors were taken larger by these factors: {', '.join(inflated)}"
        )
    shown = Table("Changes, the clearest first", changes(file.changes))
    groups = [Group("changes", "All changes", tables=[shown], unfolded=True)]
    return Section(
        "verdict", "What changed", lead, groups if file.changes else [], notes=notes
    )


def _key(entry: ChangeEntry | SeriesEntry) -> tuple[str, str, str, str]:
    return entry.robot, entry.stage, entry.joint, entry.name


def _figure(series: SeriesEntry) -> Figure:
    """Values with 95 % intervals over days since the first date."""
    times = np.array(
        [datetime.fromisoformat(date).timestamp() for date in series.dates]
    )
    days = (times - times[0]) / _DAY
    values, half = np.array(series.values), Z95 * np.array(series.std_errors)
    x, x_range = (
        (f"days since {series.dates[0][:10]}", ""),
        padded([0.0, max(days[-1], 1.0)], 0.02),
    )
    edges = np.concatenate([values - half, values + half])
    panel = small_panel(x, x_range, series.unit, padded(edges))
    panel.hover = "time|d"
    panel.band(days, values - half, values + half, "cut0")
    what = " ".join(part for part in (series.joint, series.stage, series.name) if part)
    panel.line(days, values, "predicted", name=what, unit=series.unit)
    text = f"{what} from {number(values[0])} to {number(values[-1])} {series.unit}"
    rows = zip(
        (date[:10] for date in series.dates),
        series.values,
        series.std_errors,
        strict=True,
    )
    titles, kinds = "date | value [{unit}] | std error", "text number5 number2"
    return figure(
        [panel], what, text, {}, table(what, titles, kinds, rows, unit=series.unit)
    )
