"""The clock of an IMU against that of the encoders: its model, and one search for it.

What happens t seconds of the encoders' clock after a log began has the IMU's stamp

    t + offset + rate t.

Readings y are a linear function of features X of the encoders' motion, whatever the
mounting: y(stamp of t) = X(t) theta + e. Which clock leaves least of them needs the
sums X'X, X'y and y'y alone, for shifts of the readings. Windows that are short against
the drift of a clock keep sums of their own, so that a clock is a choice of one shift
for each window: thousands are compared without touching the readings again.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from seqid_cli.typing import Array, Index, Mask

WINDOW_S = 2.0  # a clock that drifts by 5 ms/s moves by 5 ms about a window's middle
MAX_RATE = 0.008  # s/s; quartz differs by 1e-4, drivers that count samples by 4e-3


@dataclass(frozen=True)
class Clock:
    """The clock of an IMU against the encoders', in one log.

    Attributes
    ----------
    offset_s : float
        The IMU's stamp minus the encoders' stamp of the same instant, as the log
        begins.
    rate : float
        By which the IMU's clock gains on the encoders' [s/s].
    """

    offset_s: float = 0.0
    rate: float = 0.0

    def at(self, t: Array) -> Array:
        """Return by how much the IMU's stamps of instants `t` (N,) s are later [s]."""
        return np.asarray(self.offset_s + self.rate * t)


class Sums(NamedTuple):
    """Sums of p features and K readings: X'X (.., p, p), X'y (.., p, K), y'y (.., K).

    They may be of S shifts, which come first then.
    """

    xx: Array
    xy: Array
    yy: Array

    def at(self, shift: int) -> "Sums":
        """Return the sums of one shift."""
        return Sums(self.xx[shift], self.xy[shift], self.yy[shift])


@dataclass(frozen=True, kw_only=True)
class ClockScan:
    """Sums of the windows of one log, for shifts of the readings.

    Attributes
    ----------
    times : Array
        (W,) s, middles of the windows since the log began.
    shifts : Array
        (S,) s, evenly spaced, by which readings were taken later.
    windows : Sums
        (W, S, ..).
    """

    times: Array
    shifts: Array
    windows: Sums

    @property
    def spacing_s(self) -> float:
        """The spacing of the shifts [s]."""
        return float(self.shifts[1] - self.shifts[0]) if len(self.shifts) > 1 else 1.0

    def sums(self, rate: float) -> Sums:
        """Return the sums over all windows of clocks with a rate, one by one offset.

        The offsets are the shifts. Where a window needs one beyond them its sums are
        not finite.
        """
        moved = np.rint(rate * self.times / self.spacing_s).astype(np.intp)
        count = len(self.shifts)
        at: Index = np.arange(count) + moved[:, None]
        inside: Mask = (at >= 0) & (at < count)
        at = np.clip(at, 0, count - 1)
        windows = np.arange(len(self.times))[:, None]
        xx, xy, yy = (part[windows, at].sum(axis=0) for part in self.windows)
        is_covered: Mask = np.all(inside, axis=0, keepdims=True).T
        yy = np.where(is_covered, yy, np.inf)
        return Sums(xx, xy, yy)


def scan_of(
    t: Array,
    x: Array,
    read: Callable[[Array], tuple[Array, Array]],
    shifts: Array,
    *,
    window_s: float = WINDOW_S,
) -> ClockScan:
    """Sum features and readings window by window, for shifts of the readings.

    Parameters
    ----------
    t : Array
        (N,) s since the log began, on the encoders' clock, ascending.
    x : Array
        (N, p), features of the motion at these instants; the last one is a one.
    read : callable
        Returns readings (N, K) at stamps (N,) s, and the weight (N,) of each.
    shifts : Array
        (S,) s, evenly spaced.
    window_s : float
        Length of a window [s].
    """
    number = np.floor((t - t[0]) / window_s)
    edges = np.flatnonzero(np.diff(number, prepend=-1.0))  # windows in gaps are empty
    times = np.add.reduceat(t, edges) / np.diff(np.append(edges, len(t)))

    parts = []
    products = x[:, :, None] * x[:, None, :]
    for shift in shifts:
        y, weight = read(t + shift)
        weighted = x * weight[:, None]
        sums = Sums(
            xx=np.add.reduceat(products * weight[:, None, None], edges),
            xy=np.add.reduceat(weighted[:, :, None] * y[:, None, :], edges),
            yy=np.add.reduceat(y**2 * weight[:, None], edges),
        )
        parts.append(sums)
    windows = Sums(*(np.stack(part, axis=1) for part in zip(*parts, strict=True)))
    return ClockScan(times=times, shifts=shifts, windows=windows)


def added(parts: Sequence[Sums]) -> Sums:
    """Return the sums over all parts."""
    return Sums(*(np.sum(part, axis=0) for part in zip(*parts, strict=True)))


def solved(sums: Sums, *, ridge: float = 1e-9) -> Array:
    """Return the least squares theta (.., p, K).

    `ridge` holds directions of scaled features that the motion does not show.
    """
    scale = np.sqrt(np.maximum(np.diagonal(sums.xx, axis1=-2, axis2=-1), 1e-12))
    xx = sums.xx / (scale[..., :, None] * scale[..., None, :])
    xx = xx + ridge * np.eye(scale.shape[-1])
    theta = np.linalg.solve(xx, sums.xy / scale[..., None])
    return np.asarray(theta / scale[..., None])


def share_left(sums: Sums, theta: Array | None = None) -> Array:
    """Return the share (..,) of the readings' variance that is left, of all together.

    It is what the least squares leaves, or `theta` (p, K) with a mean of its own.
    Where sums are not finite it is infinite.
    """
    xx, xy, yy = sums
    n = np.maximum(xx[..., -1, -1], 1.0)[..., None]
    if theta is None:
        theta = solved(sums)
    slopes = theta[..., :-1, :]
    of_features = np.einsum("...p,...pk->...k", xx[..., -1, :-1], slopes)
    mean = (xy[..., -1, :] - of_features) / n
    slopes = np.broadcast_to(slopes, (*mean.shape[:-1], *slopes.shape[-2:]))
    theta = np.concatenate([slopes, mean[..., None, :]], axis=-2)

    is_known: Mask = np.all(np.isfinite(yy), axis=-1, keepdims=True)
    yy = np.where(is_known, yy, 0.0)
    left = yy - np.sum(theta * (2.0 * xy - xx @ theta), axis=-2)
    total = np.sum(yy - xy[..., -1, :] ** 2 / n, axis=-1)
    share = np.sum(np.maximum(left, 0.0), axis=-1) / np.maximum(total, 1e-12)
    return np.asarray(np.where(is_known[..., 0], share, np.inf))


class Likeliest(NamedTuple):
    """The clock of the least cost."""

    clock: Clock
    cost: float


def rates_of(scans: Sequence[ClockScan], *, max_rate: float = MAX_RATE) -> Array:
    """Return the rates [s/s] that the longest log tells apart, zero among them."""
    longest_s = max(float(scan.times[-1]) for scan in scans)
    step = 2.0 * scans[0].spacing_s / max(longest_s, 1.0)
    steps = int(max_rate / step)
    return np.asarray(step * np.arange(-steps, steps + 1), dtype=np.float64)


def search(
    scans: Sequence[ClockScan],
    rates: Array,
    cost: Callable[[Sums, float], Array] | None = None,
) -> Likeliest:
    """Return the likeliest clock of all logs together, among shifts and rates.

    Parameters
    ----------
    scans : sequence of ClockScan
        Sums of each log, for the same shifts.
    rates : Array
        (R,) s/s.
    cost : callable, optional
        Returns what is to be least (S,) by the sums of all logs and a rate; by default
        the share of the variance that is left.
    """
    likeliest = Likeliest(Clock(), np.inf)
    for rate in rates.tolist():
        sums = added([scan.sums(rate) for scan in scans])
        costs = share_left(sums) if cost is None else cost(sums, rate)
        best = int(np.argmin(costs))
        if costs[best] < likeliest.cost:
            clock = Clock(float(scans[0].shifts[best]), rate)
            likeliest = Likeliest(clock, float(costs[best]))
    return likeliest


def left_at(
    scans: Sequence[ClockScan], clock: Clock, theta: Array | None = None
) -> float:
    """Return the share that a clock leaves of the variance of all logs together."""
    left = share_left(added([sums_at(scan, clock) for scan in scans]), theta)
    return float(left)


def sums_at(scan: ClockScan, clock: Clock) -> Sums:
    """Return the sums over all windows for a clock, at the nearest shift."""
    at = round((clock.offset_s - float(scan.shifts[0])) / scan.spacing_s)
    return scan.sums(clock.rate).at(min(max(at, 0), len(scan.shifts) - 1))


def clock_of_log(
    t: Array,
    x: Array,
    stamps: Array,
    readings: Array,
    counts: Mask,
    expected: Clock,
    std_errors: tuple[float, float],
    *,
    reach: float = 3.0,
    coarse_s: float = 0.004,
    fine_s: float = 5e-4,
    better: float = 0.7,
) -> Clock:
    """Return the likeliest clock of one log, about one that is expected.

    Parameters
    ----------
    t, x : Array
        Instants (N,) s since the log began, and features (N, p) of the motion at these;
        the last one is a one.
    stamps, readings, counts : Array, Array, Mask
        (M,) s since the log began, (M, K), and (M,) which of them count.
    expected : Clock
        As a calibration has it.
    std_errors : tuple of float
        Of its offset [s] and rate [s/s]; `reach` times these are searched.
    coarse_s, fine_s : float
        Spacing of the clocks that are tried first, and then about the best of them.
    better : float
        Share of what the expected clock leaves, that another one must stay below.
    """

    def scan(clock: Clock, shifts: Array) -> list[ClockScan]:
        """Return the sums for shifts beyond a clock."""
        late = clock.at(t)

        def read(instants: Array) -> tuple[Array, Array]:
            at = instants + late
            values = [np.interp(at, stamps, channel) for channel in readings.T]
            weight = np.interp(at, stamps, counts.astype(np.float64)) > 0.999
            inside = (at >= stamps[0]) & (at <= stamps[-1])
            return np.column_stack(values), (weight & inside).astype(np.float64)

        return [scan_of(t, x, read, shifts)]

    def about(clock: Clock, reach_s: float, rate: float, spacing_s: float) -> Likeliest:
        """Return the best of the clocks within a reach of one, added to it."""
        steps = max(1, int(np.ceil((reach_s + rate * t[-1]) / spacing_s)))
        shifts = np.arange(-steps, steps + 1, dtype=np.float64) * spacing_s
        scans = scan(clock, shifts)
        best = search(scans, rates_of(scans, max_rate=rate))
        found = Clock(
            clock.offset_s + best.clock.offset_s, clock.rate + best.clock.rate
        )
        return Likeliest(found, best.cost)

    reach_s = reach * std_errors[0]
    coarse = about(expected, reach_s, reach * std_errors[1], coarse_s)
    before = left_at(scan(expected, np.zeros(1)), Clock())
    if not coarse.cost < better * before:
        return expected
    rate_step = 2.0 * coarse_s / max(float(t[-1]), 1.0)
    return about(coarse.clock, coarse_s, rate_step, fine_s).clock
