"""What one joint sees in windows of its logs, besides its own law.

The other joints move as they were measured. The torque that the rest of the arm asks of
joint j at its acceleration a is, near the measured position q_m,

    m a + b + s (q - q_m),

with m the entry (j, j) of the mass matrix, b the torque of gravity, Coriolis and the
other joints' accelerations, and s its slope over the joint's position. All three are
computed once from the logs, so that a simulated joint costs a few numbers a step,
however many joints the arm has.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.interpolate import CubicSpline

from seqid_cli.drive.signals import (
    STANDS_S,
    STANDS_STEPS,
    DriveSignals,
    mean_command,
    slopes_at,
)
from seqid_cli.logs.raw import Rows
from seqid_cli.model.torque import TorqueModel
from seqid_cli.motion.filters.butterworth import Lowpass
from seqid_cli.motion.filters.differentiation import differentiate, runs
from seqid_cli.motion.filters.survey import survey_of_positions
from seqid_cli.motion.motion import encoder_resolution
from seqid_cli.typing import Array, Mask

STEP_S = 1e-3  # about; the scheme is of second order
# Of steps by which structures are compared and starts are searched, before numbers are
# found in steps of `STEP_S`.
ROUGH_STEP_S = 2.5e-3
# Of a joint's position, over which the slope of its torque is taken [rad].
SLOPE_RAD = 1e-3
# Windows in which the command changes by less than this share of the usual are holds.
# A few of them tell what a joint at rest does; more of them repeat it.
HOLD_SHARE = 0.02
HOLDS_KEPT = 0.1  # of the number of windows that move


@dataclass(frozen=True, kw_only=True)
class Place:
    """A window: rows [start, stop) of a log."""

    log: int
    start: int
    stop: int


@dataclass(frozen=True, kw_only=True)
class JointCourse:
    """B windows of one joint, K steps and R rows each.

    Attributes
    ----------
    places : sequence of Place
    q : (R, B) array
        rad, as the encoder says.
    q0, v0 : (B,) arrays
        rad, rad/s, where each window begins.
    along : (K, B) array
        rad, the measured position at the steps.
    inertia : (K, B) array
        kg m^2.
    rest : (K, B) array
        N m, what the rest of the arm asks of the joint without acceleration of it.
    slope : (K, B) array
        N m/rad.
    gravity : (K, B) array
        N m, by the model.
    load : (K, B) array
        N m, the torque behind the joint's gear.
    stands : (B,) mask
        Whether the joint has stood still for a moment where the window begins.
    times : (K, B) array
        s on the clock of each log.
    step_s : (B,) array
        s, of each window.
    per_row : int
        Steps of a row.
    """

    logs: Sequence[DriveSignals]
    joint: int
    course: str
    places: Sequence[Place]
    q: Array
    q0: Array
    v0: Array
    along: Array
    inertia: Array
    rest: Array
    slope: Array
    gravity: Array
    load: Array
    stands: Mask
    times: Array
    step_s: Array
    per_row: int

    @property
    def windows(self) -> int:
        """Number of windows."""
        return len(self.places)

    @property
    def row_s(self) -> float:
        """Seconds of a row, about."""
        return float(self.step_s.mean()) * self.per_row

    @property
    def seconds(self) -> float:
        """Length of a window [s], about."""
        return float(self.step_s.mean()) * len(self.along)

    def command(self, delay_s: float) -> Array:
        """Return what the controller takes for its command (K, B) [rad]."""
        c = np.empty_like(self.along)
        of_logs = np.array([place.log for place in self.places])
        # A step counts with the mean of its command: what steps between two steps of
        # the simulation moves on smoothly with the delay.
        for number in np.unique(of_logs):
            chosen = of_logs == number
            t = self.times[:, chosen] - delay_s
            c[:, chosen] = mean_command(
                self.logs[number],
                self.course,
                self.joint,
                t,
                float(self.step_s[chosen][0]),
            )
        return c

    def slopes_of_command(self, delay_s: float) -> Array:
        """Return the velocity of that command (K, B) [rad/s]."""
        dc = np.empty_like(self.along)
        for b, place in enumerate(self.places):
            t = self.times[:, b] - delay_s
            dc[:, b] = slopes_at(self.logs[place.log], self.course, self.joint, t)
        return dc

    def finer(self) -> "JointCourse":
        """Return the same windows in steps of half the length."""
        return self.stepped(2 * self.per_row)

    def rough(self) -> "JointCourse":
        """Return the same windows in steps of about `ROUGH_STEP_S`, or as they are."""
        per_row = max(1, round(self.row_s / ROUGH_STEP_S))
        return self if per_row >= self.per_row else self.stepped(per_row)

    def stepped(self, per_row: int) -> "JointCourse":
        """Return the same windows in so many steps a row."""
        longer = self.per_row / per_row
        step_s = longer * self.step_s
        count = len(self.times) * per_row // self.per_row
        places: Array = longer * np.arange(count, dtype=np.float64)
        return replace(
            self,
            along=_between(self.along, places),
            inertia=_between(self.inertia, places),
            rest=_between(self.rest, places),
            slope=_between(self.slope, places),
            gravity=_between(self.gravity, places),
            load=_between(self.load, places),
            times=self.times[0] + np.arange(count)[:, None] * step_s,
            step_s=step_s,
            per_row=per_row,
        )

    def of(self, chosen: Rows) -> "JointCourse":
        """Return some of the windows."""
        return JointCourse(
            logs=self.logs,
            joint=self.joint,
            course=self.course,
            places=[self.places[int(k)] for k in chosen],
            q=self.q[:, chosen],
            q0=self.q0[chosen],
            v0=self.v0[chosen],
            along=self.along[:, chosen],
            inertia=self.inertia[:, chosen],
            rest=self.rest[:, chosen],
            slope=self.slope[:, chosen],
            gravity=self.gravity[:, chosen],
            load=self.load[:, chosen],
            stands=self.stands[chosen],
            times=self.times[:, chosen],
            step_s=self.step_s[chosen],
            per_row=self.per_row,
        )


def _between(values: Array, places: Array) -> Array:
    """Return values (K, B) at places (L,) between the steps, on straight lines."""
    beyond = 2.0 * values[-1:] - values[-2:-1]
    after = np.concatenate([values[1:], beyond])
    step = np.floor(places).astype(np.intp)
    share = (places - step)[:, None]
    return np.asarray((1.0 - share) * values[step] + share * after[step])


@dataclass(frozen=True, kw_only=True)
class ArmMotion:
    """A log's motion, and what the model says of it, (N, n) each.

    The motion goes through a low-pass that suits accelerations: that of the fit by rows
    may be wider.
    """

    log: DriveSignals
    q: Array
    dq: Array
    ddq: Array
    inertia: Array  # kg m^2, the mass matrix' diagonal
    rest: Array  # N m, of each joint without its own acceleration
    slope: Array  # N m/rad, of each joint's torque over its own position
    gravity: Array  # N m
    load: Array  # N m


def stands(motion: ArmMotion, joint: int, row: int) -> bool:
    """Tell whether a joint has stood still for a moment before a row."""
    rows = max(1, round(STANDS_S * motion.log.rate_hz))
    before = motion.log.raw.q[max(0, row - rows) : row + 1, joint]
    return bool(np.ptp(before) <= STANDS_STEPS * motion.log.noise_step[joint])


def arm_motion(
    log: DriveSignals, model: TorqueModel, *, share: float = 1.0
) -> ArmMotion:
    """Compute what joints ask of their drives along a log.

    `share` of the cut-off is taken, to see what the choice does to a fit.
    """
    raw = log.raw
    survey = survey_of_positions(raw.q, log.rate_hz)
    chosen = survey.cutoff(encoder_resolution(model.robot)).hz
    lowpass = Lowpass(share * min(chosen, 0.2 * log.rate_hz), log.rate_hz)
    q = lowpass(raw.q, raw.valid)
    dq, ddq = differentiate(q, log.rate_hz, raw.valid)
    still = np.zeros_like(q)

    load = model.rigid(q, dq, ddq)
    gravity = model.rigid(q, still, still)
    inertia = np.empty_like(q)
    slope = np.empty_like(q)
    for j in range(q.shape[1]):
        unit = still.copy()
        unit[:, j] = 1.0
        inertia[:, j] = (model.rigid(q, still, unit) - gravity)[:, j]
        moved = model.rigid(q + SLOPE_RAD * unit, dq, ddq)
        slope[:, j] = (moved - load)[:, j] / SLOPE_RAD
    return ArmMotion(
        log=log,
        q=q,
        dq=dq,
        ddq=ddq,
        inertia=inertia,
        rest=load - inertia * ddq,
        slope=slope,
        gravity=gravity,
        load=load,
    )


def courses_of(
    motions: Sequence[ArmMotion],
    joint: int,
    course: str,
    *,
    window_s: float,
    most: int,
) -> list[JointCourse]:
    """Cut logs into windows of one joint, one result for each number of rows.

    Parameters
    ----------
    motions : sequence of ArmMotion
    joint : int
    course : str
        What commands do between two stamps.
    window_s : float
    most : int
        Windows at most, of all logs; of more they are taken evenly.
    """
    by_rows: dict[int, list[Place]] = {}
    for number, motion in enumerate(motions):
        log = motion.log
        usable = log.usable[:, joint]
        cuts = cut(usable, log.rate_hz, window_s)
        places = by_rows.setdefault(round(window_s * log.rate_hz), [])
        places += [Place(log=number, start=start, stop=stop) for start, stop in cuts]
    total = sum(len(places) for places in by_rows.values())
    results = []
    for places in by_rows.values():
        chosen = _telling(motions, joint, places, most * len(places) // max(1, total))
        if chosen:
            results.append(_course(motions, joint, course, chosen))
    return results


def cut(usable: Mask, rate_hz: float, window_s: float) -> list[tuple[int, int]]:
    """Return the rows [start, stop) of windows in which all samples are usable."""
    rows = round(window_s * rate_hz)
    return [
        (first, first + rows + 1)
        for start, stop in runs(usable, len(usable))
        for first in range(start, stop - rows, rows)
    ]


def _telling(
    motions: Sequence[ArmMotion], joint: int, places: Sequence[Place], most: int
) -> list[Place]:
    """Return windows in which a joint is moved, and a few in which it is held."""
    changes = []
    for place in places:
        command = motions[place.log].log.raw.command
        assert command is not None
        asked = command[place.start : place.stop, joint]
        q = motions[place.log].q[place.start : place.stop, joint]
        changes.append(max(float(np.ptp(np.nan_to_num(asked))), float(np.ptp(q))))
    change = np.array(changes)
    if not len(change):
        return []
    moves = change > HOLD_SHARE * np.quantile(change, 0.9)
    moving = evenly(np.flatnonzero(moves), most)
    held = evenly(np.flatnonzero(~moves), round(HOLDS_KEPT * len(moving)))
    return [places[int(k)] for k in np.sort(np.concatenate([moving, held]))]


def evenly(numbers: Rows, most: int) -> Rows:
    """Return so many of some numbers at most, evenly."""
    if len(numbers) <= most:
        return numbers
    places = np.linspace(0.0, len(numbers) - 1.0, most)
    return np.asarray(numbers[places.astype(np.intp)])


def _course(
    motions: Sequence[ArmMotion], joint: int, course: str, places: Sequence[Place]
) -> JointCourse:
    """Gather what a joint sees in some windows of as many rows."""
    rates_hz = np.array([motions[place.log].log.rate_hz for place in places])
    # A row of one log takes a little longer than one of another.
    per_row = max(1, round(1.0 / (float(rates_hz.mean()) * STEP_S)))
    step_s = 1.0 / (rates_hz * per_row)
    rows = places[0].stop - places[0].start
    steps = (rows - 1) * per_row
    at = np.arange(steps) / per_row

    def of_rows(name: str) -> Array:
        parts = [
            getattr(motions[place.log], name)[place.start : place.stop, joint]
            for place in places
        ]
        return np.stack(parts, axis=1)

    def at_steps(name: str) -> Array:
        # Chords between rows would be short of every bend by a thousandth.
        curve = CubicSpline(np.arange(rows), of_rows(name))
        return np.asarray(curve(at), np.float64)

    raw_rows = [
        motions[place.log].log.raw.q[place.start : place.stop, joint]
        for place in places
    ]
    starts = [motions[place.log].log.raw.t[place.start] for place in places]
    return JointCourse(
        logs=[motion.log for motion in motions],
        joint=joint,
        course=course,
        places=places,
        q=np.stack(raw_rows, axis=1),
        q0=of_rows("q")[0],
        v0=of_rows("dq")[0],
        along=at_steps("q"),
        inertia=at_steps("inertia"),
        rest=at_steps("rest"),
        slope=at_steps("slope"),
        gravity=at_steps("gravity"),
        load=at_steps("load"),
        stands=np.array([stands(motions[p.log], joint, p.start) for p in places]),
        times=np.array(starts) + np.arange(steps)[:, None] * step_s,
        step_s=step_s,
        per_row=per_row,
    )
