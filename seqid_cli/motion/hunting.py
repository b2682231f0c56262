"""Signs of a joint that hunts: it stops and starts between two counts of its encoder.

A controller sees a coarse encoder's joint stand and then jump by a count. Its torque
pushes once a count, or to and fro between two of them, and drives the velocity up and
down with it,

    dv(t) = 1 / J  integral (tau - mean) dt.

Where dv is as large as the speed, the joint comes to rest within every count, or turns
back. Stuck it bears any torque up to stiction, so the mean torque of such a trial is
less than friction: a tenth less, or half. Friction that changes with the position makes
torque swing too, but there the torque follows friction and the velocity does not
change. Both are told apart by their frequency: a motion that never leaves a count but
reaches the speed v has a frequency of v / (2 pi count) or more, and friction over so
short a way does not change.

The readings show it only where the joint stops for longer than a count: it passes one
count or none where it should pass five.
"""

import numpy as np
from numpy.polynomial import Chebyshev

from seqid_cli.typing import Array

# Share of the frequency of counts: the lowest frequency of a motion within one count.
WITHIN_COUNT = 1.0 / (2.0 * np.pi)


def torque_swing(
    tau: Array,
    rate_hz: float,
    counts_hz: float,
    *,
    floor: float = 0.3,
    above: float = 2.0,
) -> float:
    """Return the amplitude of the torque's integral from the frequency of counts on.

    Parameters
    ----------
    tau : ndarray, (N,)
        Torque of a joint at constant speed [N m].
    rate_hz : float
        Samples per second.
    counts_hz : float
        Counts of the encoder that the joint passes per second.
    floor : float
        Quantile of the density that counts as white noise: lines of counts stand above
        it.
    above : float
        Times that density which is taken off. A density from one spectrum scatters.

    Returns
    -------
    float
        Amplitude [N m s] of a sine with the same power; 0 where the trial is too short
        to tell.
    """
    order = min(12, len(tau) // 8)
    time = np.linspace(-1.0, 1.0, len(tau))
    without_trend = tau - Chebyshev.fit(time, tau, order)(time)
    window = np.hanning(len(tau))
    power = np.abs(np.fft.rfft(without_trend * window)) ** 2
    f = np.fft.rfftfreq(len(tau), 1.0 / rate_hz)
    density = 2.0 * power / (rate_hz * float(window @ window))

    lowest = max(WITHIN_COUNT * counts_hz, 2.0 * rate_hz / len(tau))
    inside = f >= lowest
    if np.count_nonzero(inside) < 4:
        return 0.0
    noise = above * np.quantile(density[inside], floor)
    lines = np.clip(density[inside] - noise, 0.0, None)

    # Integration over time divides each line by its angular frequency.
    of_integral = lines / (2.0 * np.pi * f[inside]) ** 2
    variance = float(np.sum(of_integral)) * rate_hz / len(tau)
    return float(np.sqrt(2.0 * variance))


def stops(
    q: Array,
    rate_hz: float,
    speed: float,
    count: float,
    *,
    counts: float = 5.0,
    least_s: float = 0.1,
) -> bool:
    """Return whether a joint passes one count or none in the time of several.

    Parameters
    ----------
    q : Array
        Positions (N,) rad of the joint.
    rate_hz : float
    speed : float
        Mean speed [rad/s].
    count : float
        The encoder's step [rad].
    counts : float
        Counts that it should pass.
    least_s : float
        Least time [s]: below it a logger that repeats its values would stop as well.
    """
    seconds = max(counts * count / speed, least_s)
    samples = int(np.ceil(seconds * rate_hz))
    if count <= 0.0 or samples >= len(q):
        return False
    travel = np.abs(q[samples:] - q[:-samples])
    return bool(travel.min() < 1.5 * count)
