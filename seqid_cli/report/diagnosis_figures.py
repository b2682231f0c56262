"""What a diagnosis looks like: unexplained torque, residuals beside their floor, events."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from seqid_cli.params.diagnosis_schema import DiagnosisFile, EventEntry, UnexplainedPart
from seqid_cli.report.chart import Box, Panel, drawing
from seqid_cli.report.collection import Collection
from seqid_cli.report.downsample import extremes
from seqid_cli.report.row_chart import RowChart
from seqid_cli.report.svg import padded
from seqid_cli.report.torque_figures import SMALL
from seqid_cli.report.views import Column, Figure, Key, Table
from seqid_cli.report.words import file_name, number, percent, plural, unit_text

_MOST_EVENTS = 200  # per row
_MOST_LOGS = 20
_COLUMNS = 300


def unexplained_curve(part: UnexplainedPart, collection: Collection) -> Figure | None:
    """Draw what no known effect explains over the quantity it depends on."""
    curve = part.curve
    if curve is None or len(curve.x) < 2 or not min(curve.x) < max(curve.x):
        return None
    points = sorted(zip(curve.x, curve.torque, strict=True))
    x, y = np.array([at for at, _ in points]), np.array([value for _, value in points])
    points = [points[k] for k in extremes(x, y, _COLUMNS)]
    unit = unit_text(collection.units(part.joint)[0])
    quantity = curve.quantity.replace("_", " ")
    panel = Panel(
        Box(62, 26, SMALL - 74, 150),
        (points[0][0], points[-1][0]),
        padded(min(0.0, min(curve.torque)), max(0.0, max(curve.torque))),
        x_title=f"{quantity}, {unit_text(curve.unit)}" if curve.unit else quantity,
        y_title=f"unexplained, {unit}",
        x_ticks=4,
        hover=f"{quantity}|{unit_text(curve.unit)}",
    )
    panel.line(points, "residual", name="unexplained", unit=unit)
    title = f"Unexplained torque of {part.joint} over {quantity}"
    text = f"{percent(part.share, 0)} of the residual's variance above the noise floor."
    heads = (
        Column(quantity, numeric=True, unit=curve.unit),
        Column("torque", numeric=True, unit=unit),
    )
    every = max(1, len(points) // 20)
    rows = [(number(at), number(value)) for at, value in points[::every]]
    svg = drawing(SMALL, 220, title, text, [panel])
    return Figure(f"{part.joint}: unexplained", svg, (), Table(title, heads, rows))


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
