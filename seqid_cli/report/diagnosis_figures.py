"""What a diagnosis looks like: unexplained torque, residuals beside their floor, events."""

from __future__ import annotations

from collections.abc import Sequence

from seqid_cli.params.diagnosis_schema import DiagnosisFile, EventEntry, EvidenceEntry
from seqid_cli.params.diagnosis_words import over_words
from seqid_cli.report.chart import Box, Panel, drawing
from seqid_cli.report.collection import Collection
from seqid_cli.report.row_chart import RowChart
from seqid_cli.report.svg import padded
from seqid_cli.report.torque_figures import SMALL
from seqid_cli.report.views import Column, Figure, Key, Table
from seqid_cli.report.words import file_name, number, plural, unit_text

_MOST_EVENTS = 200  # per row
_MOST_LOGS = 20


def evidence_figure(
    shown: EvidenceEntry, collection: Collection, what: str = "Residual"
) -> Figure | None:
    """Draw a joint's residual over what an effect goes with, before and after that is off."""
    if len(shown.x) < 2 or not min(shown.x) < max(shown.x):
        return None
    unit = unit_text(collection.units(shown.joint)[0])
    quantity, x_unit = over_words(shown), unit_text(shown.unit)
    sided = " times direction" if shown.sided else ""
    curves = [("residual", "faint", "before", shown.before, shown.before_spread)]
    if shown.after:
        curves.append(("predicted", "cut0", "after", shown.after, shown.after_spread))
    edges = [
        y + s * d for *_, ys, ds in curves for y, d in zip(ys, ds, strict=True) for s in (-1, 1)
    ]
    panel = Panel(
        Box(62, 26, SMALL - 74, 150),
        (min(shown.x), max(shown.x)),
        padded(min(0.0, *edges), max(0.0, *edges)),
        x_title=f"{quantity}, {x_unit}" if x_unit else quantity,
        y_title=f"residual{sided}, {unit}",
        x_ticks=4,
        hover=f"{quantity}|{x_unit}",
    )
    for _, band, _, ys, ds in curves:
        low, high = (
            [(x, y + s * d) for x, y, d in zip(shown.x, ys, ds, strict=True)] for s in (-1, 1)
        )
        panel.band(low, high, band)
    for line, _, name, ys, _ in curves:
        panel.line(zip(shown.x, ys, strict=True), line, name=name, unit=unit)
    title = f"{what} of {shown.joint} over {quantity}"
    text = "Means of bins, in bands of one standard deviation."
    legend = [Key(line, f"{name} it is taken off") for line, _, name, *_ in curves]
    note = f"{text} All else that was found is off in both." if shown.after else text
    svg = drawing(SMALL, 220, title, text, [panel])
    return Figure(title, svg, legend, _bins(shown, title, quantity, unit), note)


def _bins(shown: EvidenceEntry, title: str, quantity: str, unit: str) -> Table:
    heads = (
        Column(quantity, numeric=True, unit=unit_text(shown.unit)),
        Column("samples", numeric=True),
        Column("before", numeric=True, unit=unit),
        Column("spread", numeric=True, unit=unit),
        Column("after", numeric=True, unit=unit),
        Column("spread", numeric=True, unit=unit),
    )
    none = [float("nan")] * len(shown.x)
    after, spread = shown.after or none, shown.after_spread or none
    values = zip(shown.before, shown.before_spread, after, spread, strict=True)
    rows = [
        (number(x), str(count), *map(number, some))
        for x, count, some in zip(shown.x, shown.count, values, strict=True)
    ]
    return Table(title, heads, rows)


def against_floor(file: DiagnosisFile, collection: Collection) -> Figure | None:
    """Draw each joint's residual as a multiple of its noise floor."""
    shown = {
        name: (entry.rmse / entry.noise_floor, (entry.rmse_explained or 0.0) / entry.noise_floor)
        for name in collection.robot.joints
        if (entry := file.joints.get(name)) is not None and entry.rmse and entry.noise_floor
    }
    if not shown:
        return None
    far = max(1.2, *(max(pair) for pair in shown.values()))
    chart = RowChart(list(shown), far, "RMS residual as a multiple of the noise floor")
    for row, (rmse, explained) in enumerate(shown.values()):
        chart.bar(row, 0.0, rmse, "bar")
        if file.findings and explained:
            chart.dot(row, explained, "after")
    chart.mark(1.0, "floor")
    text = "; ".join(f"{name}: {number(rmse)}" for name, (rmse, _) in shown.items())
    legend = [Key("bar", "residual"), Key("floor", "noise floor")]
    legend += [Key("after", "with the findings")] if file.findings else []
    title = "Residual against the noise floor"
    return Figure(title, chart.render(title, f"{text}, times the floor."), legend, wide=True)


def timeline(events: Sequence[EventEntry]) -> Figure | None:
    """Draw when something pushed the arm, one row per log."""
    if not events:
        return None
    logs = list(dict.fromkeys(event.log for event in events))
    names = [file_name(log) for log in logs[:_MOST_LOGS]]
    chart = RowChart(names, max(event.end for event in events), "time since its log's start, s")
    for row, log in enumerate(logs[:_MOST_LOGS]):
        for event in [event for event in events if event.log == log][:_MOST_EVENTS]:
            told = f"{event.start:.2f} to {event.end:.2f} s: {', '.join(event.joints)}"
            chart.bar(row, event.start, event.end, "span event", told)
    title = "Events: something pushed the arm"
    text = f"{plural(len(events), 'event')} in {plural(len(logs), 'log')}; the table lists them."
    return Figure(title, chart.render(title, text), [Key("event", "pushed")], wide=True)
