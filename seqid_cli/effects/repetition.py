"""Whether a motion repeats itself, and with it all that it makes.

Periodic excitation is what identification asks for (J. Swevers et al., "Optimal robot
excitation and identification", IEEE Trans. Robotics and Automation 13(5), 1997). Then
every error of a model comes back once a period, and has lines at its multiples which
last as long as the log. No line there can be told from one of the motion.
"""

import numpy as np

from seqid_cli.effects.scene import Scene
from seqid_cli.spectra import correlated
from seqid_cli.typing import Array, Mask

# Mean square of the difference over that of both, from which positions have nothing to
# do with each other, and below which they are the same. Faded ends and rests are in it.
APART = 0.5
SAME = 0.1
# Of one over the length of a log, within which a frequency is a multiple.
NEAR = 0.5
# Share to which a period is known: faded ends, and other joints' part in the motion.
KNOWN_TO = 2e-4


def repeats_with_motion(scene: Scene, frequencies: Array) -> Mask:
    """Return which frequencies (F,) Hz are multiples of that of a joint's motion."""
    length_s = scene.samples / scene.motion.rate_hz
    repeats = np.zeros(len(frequencies), dtype=bool)
    for joint in range(scene.motion.q.shape[1]):
        period_s = joint_period_s(scene, joint)
        if np.isfinite(period_s):
            cycles = frequencies * period_s
            near = NEAR * period_s / length_s + KNOWN_TO * cycles
            repeats |= np.abs(cycles - np.round(cycles)) < near
    return repeats


def joint_period_s(scene: Scene, joint: int) -> float:
    """Return the time [s] after which a joint's motion repeats, infinite if never."""
    key = ("period", joint)
    if key not in scene.memo:
        motion = scene.motion
        period = period_in_samples(motion.q[:, joint]) / motion.rate_hz
        scene.memo[key] = (np.array(period),)
    (period_s,) = scene.memo[key]
    return float(period_s)


def period_in_samples(q: Array) -> float:
    """Return the period of positions q (N,), in samples and parts of one.

    It is infinite where they do not repeat, within half of their time.
    """
    x = q - np.mean(q)
    longest = len(x) // 2
    difference = _difference(x, longest)
    parted = np.flatnonzero(difference > APART)
    if not len(parted):
        return np.inf

    # The first time at which it comes back, and the last multiple of that: it tells the
    # period better by as many times.
    same = np.flatnonzero(difference[parted[0] :] < SAME) + parted[0]
    if not len(same):
        return np.inf
    end = same[0] + np.argmax(np.append(np.diff(same), 2) > 1)
    period = _lowest(difference, int(same[0]), int(end))
    n_periods = 1
    while (n_periods + 1) * period < longest - 2:
        near = round((n_periods + 1) * period)
        reach = max(2, round(0.02 * period))
        last = _lowest(difference, near - reach, min(near + reach, longest - 1))
        n_periods += 1
        period = last / n_periods
    return period


def _difference(x: Array, longest: int) -> Array:
    """Return the mean square of x(t + lag) - x(t) over that of both, by lag."""
    products = correlated(x, x)[len(x) - 1 :][:longest]
    squares = np.concatenate([[0.0], np.cumsum(x**2)])
    lags = np.arange(longest)
    first = squares[len(x) - lags]
    last = squares[-1] - squares[lags]
    return np.asarray(
        (first + last - 2.0 * products) / np.maximum(first + last, 1e-300)
    )


def _lowest(difference: Array, start: int, stop: int) -> float:
    """Return the lag of the smallest value from start to stop, by a parabola."""
    k = start + int(np.argmin(difference[start : stop + 1]))
    return k + vertex(difference, k)


def vertex(values: Array, at: int) -> float:
    """Return how far from a lowest value the parabola through its neighbours is."""
    if not 0 < at < len(values) - 1:
        return 0.0
    before, here, after = values[at - 1 : at + 2]
    bend = before - 2.0 * here + after
    return float(0.5 * (before - after) / bend) if bend > 0.0 else 0.0
