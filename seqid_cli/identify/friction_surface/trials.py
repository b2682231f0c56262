"""Constant-velocity trials: averages over slices of time, which replace a low-pass."""

from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field, replace
from functools import partial
from typing import Any, NamedTuple, TypeVar

import numpy as np
from numpy.polynomial import Chebyshev

from seqid_cli.identify.log_set import mapped
from seqid_cli.identify.regression.equations import survey_of
from seqid_cli.logs import long as long_logs
from seqid_cli.logs.long import LongLog
from seqid_cli.logs.recording import Block, Recording, UniformLog
from seqid_cli.motion.blocks import joined
from seqid_cli.motion.hunting import stops, torque_swing
from seqid_cli.motion.motion import encoder_resolution
from seqid_cli.motion.segmentation import (
    Stretch,
    constant_velocity,
    motion_reach,
    moving_mask,
)
from seqid_cli.robot.types import Robot
from seqid_cli.typing import Array, Mask

SLICES = 64
NONE: Array = np.zeros(0)


class Ramps(NamedTuple):
    """A joint's ramps to speed and back: means (R,) under windows.

    `tau = I ddq + ...` holds for them.
    """

    q: Array = NONE  # rad
    dq: Array = NONE
    ddq: Array = NONE
    tau: Array = NONE  # N m
    weight: float = 0.0  # samples of a window
    noise: float = 0.0  # of ddq, standard deviation for positions with one of 1 rad


@dataclass(frozen=True, kw_only=True)
class Trial:
    """One joint at constant velocity.

    `q`, `dq` (K,) rad, rad/s and `tau` (K,) N m are slice averages; `ddq` (K,) rad/s^2
    is what acceleration is left, `ramps` how the joint got up to speed and back,
    `configuration` (n,) rad where every joint stood, the moving one at the middle of
    its range, `places` (K, n) rad where they were slice by slice, to the `count` (n,)
    rad of their encoders. `celsius` is the mean of the joint's temperature, NaN where
    none was logged; `inertia_error` kg m^2 is the standard error of the inertia whose
    torque was taken off. `swing` N m s and `stopped` tell whether the joint hunts, see
    `motion.hunting`.
    """

    joint: int
    velocity: float
    q: Array
    dq: Array
    ddq: Array
    tau: Array
    ramps: Ramps
    weight: float  # samples per slice
    configuration: Array
    places: Array
    t: Array  # (K,) s since the log began
    seconds: float  # of a slice
    log: int = 0  # which one
    celsius: float = np.nan
    inertia_error: float = 0.0
    count: Array = field(default_factory=lambda: np.zeros(1))  # 0: not known
    swing: float = 0.0
    stopped: bool = False

    @property
    def speed(self) -> float:
        """Magnitude of the velocity, rad/s."""
        return abs(self.velocity)

    def part(self, chosen: Mask) -> "Trial":
        """Return the trial with the chosen of its slices (K,) alone."""
        names = ("q", "dq", "ddq", "tau", "places", "t")
        return replace(self, **{name: getattr(self, name)[chosen] for name in names})


def collect_trials(recordings: Iterable[Recording], robot: Robot) -> list[Trial]:
    """Return constant-velocity trials of all logs, slowest first.

    Raises InputError where a log has no torque.
    """
    logs = mapped(recordings, partial(trials_of, robot), long_logs.LONG)
    return sorted(
        (trial for trials in logs for trial in trials), key=lambda trial: trial.speed
    )


def trials_of(
    robot: Robot, log: Recording | LongLog, number: int, *, rows: int = 65_536
) -> list[Trial]:
    """Return constant-velocity trials of one log.

    It comes in pieces of `rows` samples or more.
    """
    survey = survey_of(log)
    resolution = encoder_resolution(robot)
    count = survey.count(resolution)
    temperature = _smooth_celsius(log) if isinstance(log, Recording) else None
    return [
        _trial(block, stretch, log.rate_hz, number, temperature, count)
        for block, stretches in pieces(log, survey.noise_step(resolution), rows=rows)
        for stretch in stretches
    ]


def pieces(
    log: UniformLog, step: Array, *, rows: int
) -> Iterator[tuple[Block, list[Stretch]]]:
    """Find the stretches of constant velocity of a log.

    They lie within runs of samples at which one and the same joint moves alone. A log
    is cut between such runs into pieces of `rows` samples or more, each with so many
    samples more on either side as the search for motion reaches; what is found is what
    the whole log gives.

    `step` (n,): encoder noise [rad], see `noise_step`. Yields samples, and stretches
    within them.
    """
    rate = log.rate_hz
    margin = motion_reach(log.rate_hz)

    def searched(block: Block, first: int, stop: int) -> tuple[Block, list[Stretch]]:
        inside = block.valid.copy()
        inside[:first] = False
        inside[stop:] = False
        return block, constant_velocity(block.q, rate, step=step, valid=inside)

    held: Block | None = None
    wait = rows
    start = 0  # samples before `start` have been searched
    for block in log.blocks():
        held = block if held is None else joined([held, block])
        if held.samples - start < wait + margin:
            continue

        # The last sample, away from the end, at which another joint moves than before
        # it.
        moving = moving_mask(held.q, rate, step)
        alone = held.valid & (moving.sum(axis=1) == 1)
        mover = np.where(alone, moving.argmax(axis=1), -1)[
            start : held.samples - margin
        ]
        changes = np.flatnonzero(np.diff(mover))
        if not len(changes):  # one move that goes on and on
            wait = 2 * (held.samples - start)
            continue

        cut = start + int(changes[-1]) + 1
        yield searched(held, start, cut)
        low = max(0, cut - margin)
        held = held.part(slice(low, held.samples))
        start = cut - low
        wait = rows
    if held is not None:
        yield searched(held, start, held.samples)


def _trial(
    block: Block,
    stretch: Stretch,
    rate_hz: float,
    number: int,
    temperature: Array | None,
    count: Array,
) -> Trial:
    """Return the trial of one stretch, with averages over its slices."""
    j = stretch.joint
    slices = int(np.clip(stretch.samples // 4, 4, SLICES))
    length = stretch.samples // slices
    stop = stretch.start + slices * length
    steady = slice(stretch.start, stop)
    move = slice(stretch.move_start, stretch.move_stop)

    # Time within the trial runs from -1 to 1.
    half = (stop - stretch.start) / rate_hz / 2
    middles = (np.arange(slices) + 0.5) / slices * 2 - 1
    places = block.q[steady].reshape(slices, length, -1).mean(axis=1)
    path = _path(middles, places[:, j])
    places[:, j] = path(middles)

    celsius = (
        np.zeros(0)
        if temperature is None
        else temperature[block.start :][stretch.start : stretch.stop, j]
    )
    celsius = celsius[np.isfinite(celsius)]
    counts_hz = abs(stretch.velocity) / count[j] if count[j] > 0.0 else np.inf

    return Trial(
        joint=j,
        count=count,
        swing=torque_swing(block.tau[steady, j], rate_hz, counts_hz),
        stopped=stops(
            block.q[steady, j], rate_hz, abs(stretch.velocity), float(count[j])
        ),
        velocity=stretch.velocity,
        q=places[:, j].copy(),
        dq=path.deriv()(middles) / half,
        ddq=path.deriv(2)(middles) / half**2,
        tau=block.tau[steady, j].reshape(slices, length).mean(axis=1),
        ramps=_ramps(block.q[move, j], block.tau[move, j], rate_hz, stretch),
        weight=float(length),
        configuration=np.array(stretch.configuration),
        places=places,
        t=(block.start + stretch.start) / rate_hz + (middles + 1) * half,
        seconds=length / rate_hz,
        log=number,
        celsius=float(celsius.mean()) if len(celsius) else np.nan,
    )


def _path(time: Array, q: Array, *, most_order: int = 12) -> Chebyshev:
    """Fit a polynomial over [-1, 1] to positions averaged over slices (K,).

    It is finer than counts.
    """
    # Its order, two at least, is that of least BIC: gravity and friction that change
    # with the position leave their trace in the speed that a soft controller holds.
    most = max(2, min(most_order, len(q) // 3))
    orders = range(min(3, most), most + 1)

    def score(fit: Chebyshev) -> float:
        square = max(float(np.mean((q - fit(time)) ** 2)), 1e-24)
        return float(len(q) * np.log(square) + len(fit.coef) * np.log(len(q)))

    return min(
        (Chebyshev.fit(time, q, order, domain=[-1, 1]) for order in orders), key=score
    )


def _ramps(
    q: Array,
    tau: Array,
    rate_hz: float,
    stretch: Stretch,
    *,
    window_s: float = 0.08,
    least_window: int = 8,
    zeros: int = 4,
) -> Ramps:
    """Average the accelerating part of a move (N,) under raised cosines.

    The windows overlap by half.
    """
    # With a window that ends in zeros the means of its derivatives are derivatives of
    # its means: sums over positions times the window's own differences, without
    # differentiating positions.
    length = max(least_window, round(window_s * rate_hz))
    window = np.zeros(length + 2 * zeros)
    window[zeros:-zeros] = 1.0 - np.cos(
        2.0 * np.pi * (np.arange(length) + 0.5) / length
    )
    window /= window.sum()
    starts = np.arange(0, len(q) - len(window) + 1, max(1, length // 2))
    middles = starts + len(window) // 2 + stretch.move_start
    starts = starts[(middles < stretch.start) | (middles >= stretch.stop)]
    if not len(starts):
        return Ramps()
    pieces = starts[:, None] + np.arange(len(window))
    first = -np.gradient(window) * rate_hz
    second = np.gradient(np.gradient(window)) * rate_hz**2
    positions = q[pieces]
    # the sums of the differences are zero but for rounding
    off = positions - positions[:, :1]
    return Ramps(
        q=positions @ window,
        dq=off @ first,
        ddq=off @ second,
        tau=tau[pieces] @ window,
        weight=length / 2,
        noise=float(np.linalg.norm(second)),
    )


def _smooth_celsius(log: Recording, *, degree: int = 3) -> Array | None:
    """Return the joints' temperatures (N, n) degC without the steps of their sensors.

    Drives report them in steps of half a kelvin or a whole one, and a joint warms up by
    little more in a log. It does so over minutes: a polynomial of the time knows it
    between the steps.
    """
    if log.temperature is None:
        return None
    smooth = log.temperature.copy()
    for j, celsius in enumerate(log.temperature.T):
        is_logged = np.isfinite(celsius)
        if np.count_nonzero(is_logged) > degree + 1:
            fit = Chebyshev.fit(log.t[is_logged], celsius[is_logged], degree)
            smooth[is_logged, j] = fit(log.t[is_logged])
    return smooth


def kelvin_of(trial: Trial, celsius: float | None) -> float:
    """Return how much warmer than `celsius` a joint was in a trial, 0 if unknown."""
    if celsius is None or not np.isfinite(trial.celsius - celsius):
        return 0.0
    return float(trial.celsius - celsius)


S = TypeVar("S", bound=Any)  # what was measured at a `speed`, rad/s


def speed_levels(trials: list[S], *, same_speed: float = 0.12) -> list[list[S]]:
    """Group measurements at speeds within 12 percent of the slowest of a group."""
    levels: list[list[S]] = []
    for trial in sorted(trials, key=lambda t: t.speed):
        if not levels or trial.speed > levels[-1][0].speed * (1 + same_speed):
            levels.append([])
        levels[-1].append(trial)
    return levels
