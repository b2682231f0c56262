"""Measured and predicted torque, and the residual against time, position, velocity, frequency."""

from collections.abc import Mapping, Sequence

import numpy as np
from scipy.signal import welch
from scipy.stats import gamma

from seqid_cli.model.effects.spectral_lines import (
    NEIGHBOURHOOD_HZ,
    Signal,
    amplitude,
    strongest_lines,
)
from seqid_cli.report.collection import Place
from seqid_cli.report.figures.chart import WIDE, Panel, drawing, small_figure, small_panel, wide_box
from seqid_cli.report.figures.svg import padded
from seqid_cli.report.torques import Series
from seqid_cli.report.views import Figure, Key, Table, table
from seqid_cli.report.words import number, plural, short_path
from seqid_cli.typing import Array, Index, Mask

Event = tuple[float, float]

_ROWS = 20  # of the tables of time series
_BINS = 40
_OTHERS = 3  # colours of models beside the best


def over_time(
    models: Mapping[str, Series], place: Place, events: Sequence[Event], columns: int
) -> Figure:
    """Draw measured and predicted torque of one log above the residual, events shaded.

    `models` are the torques of the same log by the name of their model, the best first.
    """
    series = next(iter(models.values()))
    t, good = series.t - series.t[0], _known(series)
    unit, name = place.unit, short_path(series.log)
    counted = good & series.used & series.sliding
    shown = counted if np.any(counted) else good
    torque, residual = _panels(models, t, shown, unit)
    for panel in (torque, residual):
        for start, stop in events:
            panel.span(start, stop, "event", f"pushed from {start:.2f} to {stop:.2f} s")
        for part in pieces(t, ~series.used, max_gap=np.inf)[:200]:
            panel.span(float(t[part.start]), float(t[min(part.stop, len(t) - 1)]), "unused")
    rests = good & np.isfinite(series.low) & np.isfinite(series.high)
    for piece in pieces(t, rests):
        low, high = series.low[piece], series.high[piece]
        kept = np.union1d(*(extremes(t[piece], bound, columns) for bound in (low, high)))
        torque.band(t[piece][kept], low[kept], high[kept], "faint")
    names = list(models) if len(models) > 1 else ["predicted"]
    styles = ["predicted", *(f"other{k % _OTHERS}" for k in range(len(models) - 1))]
    drawn = [(torque, series, series.torque, "measured", "measured")]
    for label, style, other in reversed(list(zip(names, styles, models.values(), strict=True))):
        best = other is series
        drawn.append((torque, other, other.predicted, style, label))
        left = ("residual", "residual") if best else (style, f"residual, {label}")
        drawn.append((residual, other, other.residual, *left))
    for panel, whose, values, style, label in drawn:
        at = whose.t - whose.t[0]
        for piece in pieces(at, _known(whose)):
            kept = extremes(at[piece], values[piece], columns)
            panel.line(at[piece][kept], values[piece][kept], style, name=label, unit=unit)
    title = f"{place.joint}, {name}"
    text = _described(series, shown, unit)
    svg = drawing(WIDE, 348, f"Torque of {title} over time", text, [torque, residual])
    legend = [Key("measured", "measured"), *map(Key, styles, names), Key("residual", "residual")]
    legend += [Key("faint", "held at rest")] if np.any(rests) else []
    legend += [Key("event", "pushed")] if events else []
    legend += [] if np.all(series.used) else [Key("unused", "not counted")]
    return Figure(name, svg, legend, _time_table(t, series, good, unit, title), wide=True)


def _panels(models: Mapping[str, Series], t: Array, shown: Mask, unit: str) -> tuple[Panel, Panel]:
    """Return the frames for the torque and, below, for the residual."""
    span = (0.0, float(t[-1]) if len(t) > 1 and t[-1] > 0 else 1.0)
    series = next(iter(models.values()))
    drawn = [series.torque[_known(series)], series.low, series.high]
    drawn += [one.predicted[_known(one)] for one in models.values()]
    left = [series.residual[shown]]
    left += [one.residual[_known(one) & one.used & one.sliding] for one in models.values()]
    both = np.concatenate(drawn)
    limits = _limits(both[np.isfinite(both)])
    title, below = f"torque, {unit}", f"residual, {unit}"
    torque = Panel(wide_box(26, 164), span, limits, y_title=title, show_x=False, hover="t|s")
    limits = _limits(np.concatenate(left), zero=True)
    residual = Panel(wide_box(220, 84), span, limits, "time, s", below, y_ticks=3, hover="t|s")
    return torque, residual


def _known(series: Series) -> Mask:
    good = np.isfinite(series.torque) & np.isfinite(series.predicted)
    return good & np.isfinite(series.residual)


def _limits(values: Array, *, zero: bool = False) -> tuple[float, float]:
    if not len(values):
        return -1.0, 1.0
    low, high = float(values.min()), float(values.max())
    return padded(min(low, 0.0) if zero else low, max(high, 0.0) if zero else high, 0.06)


def _described(series: Series, shown: Mask, unit: str) -> str:
    if not np.any(shown):
        return "No sample has both a measured and a predicted torque."
    rms = float(np.sqrt(np.mean(np.square(series.residual[shown]))))
    low, high = float(series.torque[shown].min()), float(series.torque[shown].max())
    return (
        f"Measured torque from {number(low)} to {number(high)} {unit}; the residual has an RMS of "
        f"{number(rms)} {unit} and reaches {number(float(np.abs(series.residual[shown]).max()))} "
        f"{unit}."
    )


def _time_table(t: Array, series: Series, good: Mask, unit: str, title: str) -> Table:
    rows = []
    edges = np.linspace(0.0, float(t[-1]), min(_ROWS, len(t)) + 1)
    starts = np.searchsorted(t, edges[:-1])
    for at, a, b in zip(edges[:-1], starts, np.append(starts[1:], len(t)), strict=True):
        keep = good[a:b]
        if not np.any(keep):
            continue
        measured, predicted, rest = (
            values[a:b][keep] for values in (series.torque, series.predicted, series.residual)
        )
        ends = [end() for x in (measured, predicted) for end in (x.min, x.max)]
        left = (np.sqrt(np.mean(rest**2)), np.abs(rest).max())
        rows.append((f"{at:.2f}", *map(float, (*ends, *left))))
    heads = "from [s] | measured, least [{u}] | most [{u}] | predicted, least [{u}] | most [{u}]"
    heads += " | residual RMS [{u}] | largest [{u}]"
    kinds = "count number number number number number number"
    return table(f"Torque of {title}", heads, kinds, rows, u=unit)


def over_quantity(logs: Sequence[Series], place: Place, quantity: str, unit: str) -> Figure | None:
    """Draw the spread of the residual over position or velocity; None where it is not known."""
    known = [(getattr(s, quantity), s.residual, s.used & s.sliding) for s in logs]
    kept = [
        np.array([x[m], r[m]])
        for x, r, used in known
        if x is not None
        for m in [used & np.isfinite(x) & np.isfinite(r)]
    ]
    x, r = np.concatenate([np.zeros((2, 0)), *kept], axis=1)
    bins = _binned(x, r) if len(x) else []
    if not bins:
        return None
    panel = small_panel(
        (quantity, unit),
        padded(float(x.min()), float(x.max()), 0.02),
        f"residual, {place.unit}",
        _limits(r, zero=True),
    )
    centre, least, low, middle, high, most = zip(*bins, strict=True)
    panel.band(centre, least, most, "faint")
    panel.band(centre, low, high, "residual")
    panel.line(centre, middle, "residual", name="median", unit=place.unit)
    title = f"Residual of {place.joint} over {quantity}"
    text = (
        f"Median, 90 % range and extremes of the residual in {plural(len(bins), 'bin')} of "
        f"{quantity}. The median lies between {number(min(middle))} and "
        f"{number(max(middle))} {place.unit}."
    )
    legend = [Key("residual", "median"), Key("band-residual", "90 %"), Key("faint", "extremes")]
    heads = "{over} [{x}] | least [{y}] | 5 % [{y}] | median [{y}] | 95 % [{y}] | most [{y}]"
    own = {"over": quantity, "x": unit, "y": place.unit}
    values = table(title, heads, "number number number number number number", bins, **own)
    return small_figure(panel, title, text, legend, values, name=f"Residual over {quantity}")


def _binned(
    x: Array, r: Array, *, min_samples: int = 4
) -> list[tuple[float, float, float, float, float, float]]:
    low, high = float(x.min()), float(x.max())
    if not high > low:
        return []
    place = np.minimum(((x - low) / (high - low) * _BINS).astype(np.int64), _BINS - 1)
    order = np.argsort(place, kind="stable")
    parts = np.split(r[order], np.searchsorted(place[order], np.arange(1, _BINS)))
    rows = []
    for k, part in enumerate(parts):
        if len(part) >= min_samples:
            low5, middle, high95 = (float(v) for v in np.quantile(part, [0.05, 0.5, 0.95]))
            centre = low + (k + 0.5) * (high - low) / _BINS
            rows.append((centre, float(part.min()), low5, middle, high95, float(part.max())))
    return rows


def spectrum(
    logs: Sequence[Series], place: Place, cutoff_hz: float | None, columns: int
) -> Figure | None:
    """Draw the residual's amplitude spectral density and mark its lines."""
    signals = [signal for series in logs if (signal := _signal(series)) is not None]
    if not signals:
        return None
    longest = max(signals, key=lambda signal: signal.length_s)
    top = 0.5 * longest.rate_hz
    if cutoff_hz is not None:
        top = min(top, 1.5 * cutoff_hz)
    f, density = _density(longest)
    inside = (f > 0.0) & (f <= top) & (density > 0.0)
    if np.count_nonzero(inside) < 8:
        return None
    f, density = f[inside], density[inside]
    lines = sorted(certain_lines(signals, float(top)))
    unit = f"{place.unit}/\u221aHz"
    panel = small_panel(
        ("frequency", "Hz"),
        (0.0, float(top)),
        f"residual, {unit}",
        (10 ** np.floor(np.log10(density.min())), 10 ** np.ceil(np.log10(density.max()))),
        y_log=True,
        x_ticks=5,
    )
    panel.hover = "f|Hz"
    for line in lines:
        panel.upright(line, "line-mark")
    if cutoff_hz is not None and cutoff_hz < top:
        panel.upright(cutoff_hz, "limit", "cut-off")
    kept = extremes(f, np.log10(density), columns)
    panel.line(f[kept], density[kept], "residual", name="density", unit=unit)
    found = ", ".join(f"{line:.2f} Hz" for line in lines)
    rows = [(f"{line:.3f}", amplitude(longest, line)) for line in lines]
    return small_figure(
        panel,
        f"Spectrum of the residual of {place.joint}",
        f"Lines that stand out: {found or 'no line'}.",
        [Key("residual", "density"), *([Key("line-mark", "line")] if lines else [])],
        table(
            f"Lines in the residual of {place.joint}",
            "frequency [Hz] | amplitude [{unit}]",
            "count number",
            rows,
            "" if rows else "No frequency stands out of its neighbourhood.",
            unit=place.unit,
        ),
        name="Spectrum of the residual",
        note=f"Lines: {found}" if lines else "No line stands out.",
    )


def certain_lines(
    signals: Sequence[Signal], top_hz: float, *, most: int = 5, false_alarms: float = 0.01
) -> list[float]:
    """Return the frequencies (Hz) of lines that noise would show in one report of a hundred.

    The squared amplitude that noise of density S has at one frequency over a time T is
    exponentially distributed around 2 S / T, so that a sum over logs has a gamma distribution;
    there are as many chances as independent frequencies, twice for those between them.
    """
    longest = max(signals, key=lambda signal: signal.length_s)
    chances = 2.0 * top_hz * longest.length_s
    found = []
    for line in strongest_lines(signals, 0.0, 3 * most):
        size = 0.0
        for signal in signals:
            f, density = _density(signal)
            near = (np.abs(f - line) < max(NEIGHBOURHOOD_HZ, 4 * f[1])) & (f > 0.0)
            noise = float(np.median(density[near] ** 2)) if np.any(near) else 0.0
            size += amplitude(signal, line) ** 2 * signal.length_s / max(2.0 * noise, 1e-300)
        if line <= top_hz and chances * float(gamma.sf(size, len(signals))) < false_alarms:
            found.append(line)
    return found[:most]


def _signal(series: Series) -> Signal | None:
    good = series.used & np.isfinite(series.residual)
    runs = pieces(series.t, good)
    if not runs:
        return None
    run = max(runs, key=lambda part: part.stop - part.start)
    t, r = series.t[run], series.residual[run]
    if len(t) < 64 or not t[-1] > t[0]:
        return None
    rate = (len(t) - 1) / float(t[-1] - t[0])
    even = np.linspace(float(t[0]), float(t[-1]), len(t))
    values: Array = np.interp(even, t, r)
    return Signal(values, rate, float(t[0]))


def _density(signal: Signal) -> tuple[Array, Array]:
    length = min(len(signal.values), max(256, len(signal.values) // 4))
    f, power = welch(signal.values, fs=signal.rate_hz, nperseg=length, detrend="constant")
    return np.asarray(f, dtype=np.float64), np.sqrt(np.asarray(power, dtype=np.float64))


def extremes(x: Array, y: Array, columns: int) -> Index:
    """Return the indices of the smallest and largest y in each of `columns` equal parts of x.

    `x` (N,): not falling. `y` (N,): finite. `columns`: as many as the drawing has pixels across.
    Returns (M,) array of int: rising, M <= 2 * columns + 2; the first and the last sample are
    always among them.
    """
    if len(x) <= 2 * columns + 2:
        return np.arange(len(x))
    span = x[-1] - x[0]
    share = (x - x[0]) / span if span > 0.0 else np.zeros(len(x))
    column = np.minimum((share * columns).astype(np.int64), columns - 1)
    starts = np.flatnonzero(np.diff(column, prepend=-1))
    low, high = np.minimum.reduceat(y, starts), np.maximum.reduceat(y, starts)
    sizes, found = np.diff(np.append(starts, len(x))), [np.array([0, len(x) - 1])]
    for extreme in (low, high):  # the first sample that reaches it
        places = np.where(y == np.repeat(extreme, sizes), np.arange(len(x)), len(x))
        found.append(np.minimum.reduceat(places, starts))
    return np.unique(np.concatenate(found))


def pieces(t: Array, good: Mask, *, max_gap: float = 5.0) -> list[slice]:
    """Return the runs of good samples without a gap in time, as slices."""
    if not len(t):
        return []
    steps = np.diff(t)
    usual = float(np.median(steps[steps > 0.0])) if np.any(steps > 0.0) else 0.0
    # With few steps, all long, the median is no measure: then nothing counts as a gap.
    cut = np.concatenate(
        [[True], (steps > max_gap * usual) if usual else np.zeros(len(steps), bool)]
    )
    cut |= np.concatenate([[False], good[1:] != good[:-1]])
    starts = np.flatnonzero(cut)
    ends = np.append(starts[1:], len(t))
    return [slice(int(a), int(b)) for a, b in zip(starts, ends, strict=True) if good[a]]
