"""Figures of a diagnosis: residuals relative to their noise floor, and events."""

from __future__ import annotations

from collections.abc import Sequence

from seqid_cli.params.results.diagnosis import DiagnosisFile, EventEntry
from seqid_cli.report.collection import Collection
from seqid_cli.report.figures.chart import RowChart
from seqid_cli.report.views import Figure, Key
from seqid_cli.report.words import file_name, number, plural

_MOST_EVENTS = 200  # per row
_MOST_LOGS = 20


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
            chart.dots(row, [explained])
    chart.mark(1.0, "floor")
    text = "; ".join(f"{name}: {number(rmse)}" for name, (rmse, _) in shown.items())
    legend = [Key("bar", "residual"), Key("floor", "noise floor")]
    legend += [Key("after", "with the findings")] if file.findings else []
    return chart.figure("Residual against the noise floor", f"{text}, times the floor.", legend)


def timeline(events: Sequence[EventEntry]) -> Figure | None:
    """Draw the events over time, one row per log."""
    if not events:
        return None
    logs = list(dict.fromkeys(event.log for event in events))
    names = [file_name(log) for log in logs[:_MOST_LOGS]]
    chart = RowChart(names, max(event.end for event in events), "time since its log's start, s")
    for row, log in enumerate(logs[:_MOST_LOGS]):
        for event in [event for event in events if event.log == log][:_MOST_EVENTS]:
            tooltip = f"{event.start:.2f} to {event.end:.2f} s: {', '.join(event.joints)}"
            chart.bar(row, event.start, event.end, "span event", tooltip)
    text = f"{plural(len(events), 'event')} in {plural(len(logs), 'log')}; the table lists them."
    return chart.figure("Events: something pushed the arm", text, [Key("event", "pushed")])
