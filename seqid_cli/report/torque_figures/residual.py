"""The residual over position or velocity, and its spectrum."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from seqid_cli.report.chart import figure, padded, small_panel
from seqid_cli.report.collection import Place
from seqid_cli.report.torque_figures.thinning import extremes, pieces
from seqid_cli.report.torques import Series
from seqid_cli.report.views import Figure, table
from seqid_cli.report.words import number, plural
from seqid_cli.spectra import welch
from seqid_cli.typing import Array

_ROWS = 20  # of the table of a spectrum
_BINS = 40
_IN_BIN, _IN_RUN = 4, 64  # samples: fewer are not drawn
_ROOM = 0.06  # above and below what is drawn, of its range


class _Bin(NamedTuple):
    """Quantiles of the residual in a bin of a quantity."""

    centre: float
    least: float
    low: float
    median: float
    high: float
    most: float


def over_quantity(
    logs: Sequence[Series], place: Place, quantity: str, unit: str
) -> Figure | None:
    """Draw the spread of the residual over position or velocity.

    Parameters
    ----------
    logs : sequence of Series
        A joint's torques, log by log.
    place : Place
        The joint.
    quantity : {"position", "velocity"}
    unit : str
        Unit of the quantity.

    Returns
    -------
    Figure or None
        None where the quantity is not known.
    """
    x, residual = _counted_samples(logs, quantity)
    if not len(x) or not x.max() > x.min():
        return None
    edges = np.linspace(x.min(), x.max(), _BINS + 1)
    bins = _bins_of(x, residual, edges)
    if not bins:
        return None

    panel = small_panel(
        (quantity, unit),
        padded(edges, 0.02),
        f"residual, {place.unit}",
        padded(np.append(residual, 0.0), _ROOM),
    )
    centre = [item.centre for item in bins]
    median = [item.median for item in bins]
    panel.band(
        centre, [item.least for item in bins], [item.most for item in bins], "faint"
    )
    panel.band(
        centre, [item.low for item in bins], [item.high for item in bins], "residual"
    )
    panel.line(centre, median, "residual", name="median", unit=place.unit)

    title = f"Residual of {place.joint} over {quantity}"
    text = (
        f"Median, 90 % range and extremes of the residual in {plural(len(bins), 'bin')}"
        f" of {quantity}. The median lies between {number(min(median))} and"
        f" {number(max(median))} {place.unit}."
    )
    values = table(
        title,
        "{over} [{x}] | least [{y}] | 5 % [{y}] | median [{y}] | 95 % [{y}] | most"
        " [{y}]",
        "number number number number number number",
        bins,
        over=quantity,
        x=unit,
        y=place.unit,
    )
    legend = {"residual": "median", "band-residual": "90 %", "faint": "extremes"}
    return figure(
        [panel], title, text, legend, values, name=f"Residual over {quantity}"
    )


def _counted_samples(logs: Sequence[Series], quantity: str) -> tuple[Array, Array]:
    """Return a quantity and the residual (N,) of the counted samples of all logs."""
    x_of_logs = [np.zeros(0)]
    residual_of_logs = [np.zeros(0)]
    for series in logs:
        x = getattr(series, quantity)
        if x is None:
            continue
        is_complete = np.isfinite(x) & np.isfinite(series.residual)
        is_counted = series.used & series.sliding & is_complete
        x_of_logs.append(x[is_counted])
        residual_of_logs.append(series.residual[is_counted])
    return np.concatenate(x_of_logs), np.concatenate(residual_of_logs)


def _bins_of(x: Array, residual: Array, edges: Array) -> list[_Bin]:
    """Return the bins of x between edges that have enough samples."""
    order = np.argsort(x, kind="stable")
    parts = np.split(residual[order], np.searchsorted(x[order], edges[1:-1]))
    centres = (edges[1:] + edges[:-1]) / 2
    bins = []
    for centre, part in zip(centres, parts, strict=True):
        if len(part) >= _IN_BIN:
            quantiles = np.quantile(part, [0.0, 0.05, 0.5, 0.95, 1.0]).tolist()
            bins.append(_Bin(float(centre), *quantiles))
    return bins


def spectrum(
    logs: Sequence[Series], place: Place, cutoff_hz: float | None, columns: int
) -> Figure | None:
    """Draw the residual's amplitude spectral density in its longest run without a gap.

    Parameters
    ----------
    logs : sequence of Series
        A joint's torques, log by log.
    place : Place
        The joint.
    cutoff_hz : float, optional
        Cut-off of the low-pass [Hz], beyond which there is nothing to see.
    columns : int
        The line has at most two points in each of so many parts of the frequency.

    Returns
    -------
    Figure or None
        None where no run is long enough.
    """
    longest = _longest_run(logs)
    if longest is None:
        return None
    f, density = _amplitude_density(longest.t, longest.residual)
    nyquist_hz = 0.5 * longest.rate_hz
    top_hz = nyquist_hz if cutoff_hz is None else min(nyquist_hz, 1.5 * cutoff_hz)
    inside = (f > 0.0) & (f <= top_hz) & (density > 0.0)
    f = f[inside]
    density = density[inside]
    if len(f) < 2:
        return None

    unit = f"{place.unit}/\u221aHz"
    decades = (
        10 ** np.floor(np.log10(density.min())),
        10 ** np.ceil(np.log10(density.max())),
    )
    panel = small_panel(
        ("frequency", "Hz"),
        (0.0, float(top_hz)),
        f"residual, {unit}",
        decades,
        y_log=True,
    )
    if cutoff_hz is not None and cutoff_hz < top_hz:
        panel.upright(cutoff_hz, "line-mark")
    drawn = extremes(f, np.log10(density), columns)
    panel.line(f[drawn], density[drawn], "residual", name="density", unit=unit)

    title = f"Spectrum of the residual of {place.joint}"
    parts = np.array_split(np.arange(len(f)), min(_ROWS, len(f)))
    peaks = [part[np.argmax(density[part])] for part in parts]
    values = table(
        f"{title}, its peaks",
        "frequency [Hz] | density [{unit}]",
        "number4 number",
        [(float(f[k]), float(density[k])) for k in peaks],
        unit=unit,
    )
    text = f"Strongest at {f[np.argmax(density)]:.2f} Hz."
    return figure(
        [panel],
        title,
        text,
        {"residual": "density", "line-mark": "cut-off"},
        values,
        name="Spectrum of the residual",
        note=text,
    )


class _Run(NamedTuple):
    """Samples (N,) of the residual without a gap, and their mean rate."""

    t: Array
    residual: Array
    rate_hz: float


def _longest_run(logs: Sequence[Series]) -> _Run | None:
    """Return the longest run without a gap, if one is long enough."""
    longest = None
    n_longest = _IN_RUN - 1
    for series in logs:
        for run in pieces(series.t, series.used & np.isfinite(series.residual)):
            count = run.stop - run.start
            lasts = series.t[run.stop - 1] > series.t[run.start]
            if count > n_longest and lasts:
                longest = (series, run)
                n_longest = count
    if longest is None:
        return None
    series, run = longest
    t = series.t[run]
    rate_hz = (len(t) - 1) / float(t[-1] - t[0])
    return _Run(t=t, residual=series.residual[run], rate_hz=rate_hz)


def _amplitude_density(t: Array, residual: Array) -> tuple[Array, Array]:
    """Return frequencies (F,) [Hz] and the root of the power density there."""
    # Stamps jitter: the spectrum needs even steps.
    even_t = np.linspace(t[0], t[-1], len(t))
    even_residual = np.interp(even_t, t, residual)
    rate_hz = (len(t) - 1) / float(t[-1] - t[0])
    length = min(len(residual), max(256, len(residual) // 4))
    f, power = welch(even_residual, rate_hz, length)
    return f, np.sqrt(power)
