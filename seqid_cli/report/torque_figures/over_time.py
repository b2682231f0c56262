"""Measured and predicted torque of one log over time, above the residual."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from seqid_cli.report.chart import Panel, figure, full_box, padded
from seqid_cli.report.collection import Place
from seqid_cli.report.torque_figures.thinning import extremes, pieces
from seqid_cli.report.torques import Series
from seqid_cli.report.views import Figure, Table, table
from seqid_cli.report.words import number, short_path
from seqid_cli.typing import Array, Mask

_ROWS = 20  # of the table
_MOST_SPANS = 200
_ROOM = 0.06  # above and below what is drawn, of its range


def over_time(
    models: Mapping[str, Series],
    place: Place,
    events: Sequence[tuple[float, float]],
    columns: int,
) -> Figure:
    """Draw measured and predicted torque of one log above the residual.

    Parameters
    ----------
    models : mapping of str to Series
        Torques of the same log by the name of their model, the best first.
    place : Place
        The joint.
    events : sequence of pairs of float
        Start and end of pushes, which are shaded [s].
    columns : int
        Each line has at most two points in each of so many parts of the time.

    Returns
    -------
    Figure
    """
    series = next(iter(models.values()))
    unit = place.unit
    is_complete = _is_complete(series)
    is_counted = is_complete & series.used & series.sliding
    # Where no sample counts, all that are complete give the range.
    in_range = is_counted if np.any(is_counted) else is_complete

    # From the back to the front: shades, bands, then lines.
    torque, residual = _panels(models, in_range, unit)
    for panel in (torque, residual):
        _shade(panel, series, events)
    has_rests = _draw_rests(series, torque, columns)
    has_band = _draw_band(series, residual, columns)
    legend = _draw_lines(models, torque, residual, unit, columns)

    if has_band:
        legend["band-residual"] = "95 % band"
    if has_rests:
        legend["faint"] = "held at rest"
    if events:
        legend["event"] = "pushed"
    if not np.all(series.used):
        legend["unused"] = "not counted"

    name = short_path(series.log)
    title = f"Torque of {place.joint}, {name}"
    return figure(
        [torque, residual],
        f"{title} over time",
        _text(series.residual[in_range], unit),
        legend,
        _table(series, unit, title),
        name=name,
    )


def _is_complete(series: Series) -> Mask:
    """Return which samples (N,) have measured and predicted torque."""
    return (
        np.isfinite(series.torque)
        & np.isfinite(series.predicted)
        & np.isfinite(series.residual)
    )


def _text(residual: Array, unit: str) -> str:
    """Return how large the residual (N,) of the shown samples is."""
    if not len(residual):
        return "No sample is known."
    rms = float(np.sqrt(np.mean(np.square(residual))))
    largest = float(np.abs(residual).max())
    return (
        f"The residual has an RMS of {number(rms)} {unit} and reaches"
        f" {number(largest)} {unit}."
    )


def _panels(
    models: Mapping[str, Series], in_range: Mask, unit: str
) -> tuple[Panel, Panel]:
    """Return the frames for the torque and, below, for the residual.

    The frame of the residual is as high as that of the samples `in_range` (N,).
    """
    series = next(iter(models.values()))
    torques = [series.low, series.high]
    residuals = [np.zeros(1), series.residual[in_range]]
    for of_model in models.values():
        is_complete = _is_complete(of_model)
        torques.append(of_model.torque[is_complete])
        torques.append(of_model.predicted[is_complete])
        is_counted = is_complete & of_model.used & of_model.sliding
        residuals.append(of_model.residual[is_counted])
    all_torques = np.concatenate(torques)

    x_range = (0.0, float(series.t[-1] - series.t[0]) or 1.0)
    torque = Panel(
        box=full_box(26, 200),
        x_ticks=12,
        x_range=x_range,
        y_range=padded(all_torques[np.isfinite(all_torques)], _ROOM),
        y_title=f"torque, {unit}",
        show_x=False,
        hover="t|s",
    )
    residual = Panel(
        box=full_box(256, 104),
        x_ticks=12,
        x_range=x_range,
        y_range=padded(np.concatenate(residuals), _ROOM),
        x_title="time, s",
        y_title=f"residual, {unit}",
        y_ticks=3,
        hover="t|s",
    )
    return torque, residual


def _shade(panel: Panel, series: Series, events: Sequence[tuple[float, float]]) -> None:
    """Shade pushes, and samples that are not counted."""
    for start, stop in events:
        panel.span(start, stop, "event", f"pushed from {start:.2f} to {stop:.2f} s")
    t = series.t - series.t[0]
    last = len(t) - 1
    for piece in pieces(t, ~series.used, max_gap=np.inf)[:_MOST_SPANS]:
        panel.span(float(t[piece.start]), float(t[min(piece.stop, last)]), "unused")


def _draw_rests(series: Series, torque: Panel, columns: int) -> bool:
    """Draw the interval that friction holds at rest; return whether there is any."""
    t = series.t - series.t[0]
    rests = _is_complete(series) & np.isfinite(series.low) & np.isfinite(series.high)
    for piece in pieces(t, rests):
        low = series.low[piece]
        high = series.high[piece]
        drawn = np.union1d(
            extremes(t[piece], low, columns), extremes(t[piece], high, columns)
        )
        torque.band(t[piece][drawn], low[drawn], high[drawn], "faint")
    return bool(np.any(rests))


def _draw_band(series: Series, residual: Panel, columns: int) -> bool:
    """Draw the residual's 95 % band where the joint slides; return if there is any."""
    if series.std is None:
        return False
    t = series.t - series.t[0]
    has_band = _is_complete(series) & series.sliding & np.isfinite(series.std)
    for piece in pieces(t, has_band):
        half_width = 1.96 * series.std[piece]
        drawn = extremes(t[piece], half_width, columns)
        residual.band(
            t[piece][drawn], -half_width[drawn], half_width[drawn], "residual"
        )
    return bool(np.any(has_band))


@dataclass(frozen=True, kw_only=True)
class _Line:
    """A line of a panel: `values` (N,) of a series, its style and its name."""

    panel: Panel
    series: Series
    values: Array
    style: str
    name: str


def _draw_lines(
    models: Mapping[str, Series],
    torque: Panel,
    residual: Panel,
    unit: str,
    columns: int,
) -> dict[str, str]:
    """Draw the lines of all models, the best above the others; return their legend."""
    legend = {"measured": "measured"}
    lines = []
    for k, (model, series) in enumerate(models.items()):
        is_best = k == 0
        style = "predicted" if is_best else f"other{k - 1}"
        name = model if len(models) > 1 else "predicted"
        legend[style] = name
        of_residual = _Line(
            panel=residual,
            series=series,
            values=series.residual,
            style="residual" if is_best else style,
            name="residual" if is_best else f"residual, {name}",
        )
        of_prediction = _Line(
            panel=torque,
            series=series,
            values=series.predicted,
            style=style,
            name=name,
        )
        lines += [of_residual, of_prediction]
    legend["residual"] = "residual"

    best = next(iter(models.values()))
    measured = _Line(
        panel=torque,
        series=best,
        values=best.torque,
        style="measured",
        name="measured",
    )
    # What is drawn last lies above.
    for item in [measured, *reversed(lines)]:
        t = item.series.t - item.series.t[0]
        for piece in pieces(t, _is_complete(item.series)):
            drawn = extremes(t[piece], item.values[piece], columns)
            item.panel.line(
                t[piece][drawn],
                item.values[piece][drawn],
                item.style,
                name=item.name,
                unit=unit,
            )
    return legend


def _table(series: Series, unit: str, title: str) -> Table:
    """Return torque and residual of equal parts of the time."""
    t = series.t - series.t[0]
    is_complete = _is_complete(series)
    starts = np.linspace(0.0, float(t[-1]), min(_ROWS, len(t)) + 1)[:-1]
    parts = np.split(np.arange(len(t)), np.searchsorted(t, starts[1:]))
    rows = []
    for start, part in zip(starts, parts, strict=True):
        samples = part[is_complete[part]]
        if not len(samples):
            continue
        torque = series.torque[samples]
        predicted = series.predicted[samples]
        residual = series.residual[samples]
        row = (
            f"{start:.2f}",
            float(np.min(torque)),
            float(np.max(torque)),
            float(np.min(predicted)),
            float(np.max(predicted)),
            float(np.sqrt(np.mean(residual**2))),
            float(np.abs(residual).max()),
        )
        rows.append(row)

    titles = (
        "from [s] | measured, least [{u}] | most [{u}] | predicted, least [{u}] | most"
        " [{u}] | residual RMS [{u}] | largest [{u}]"
    )
    kinds = "count number number number number number number"
    return table(title, titles, kinds, rows, u=unit)
