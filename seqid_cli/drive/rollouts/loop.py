"""One joint under its controller, many windows and many sets of numbers at once.

With the whole inertia m, a damping D of friction and controller together and what the
rest of the arm asks for (`course`), a step of h is

    (m + D h/2) v' = (m - D h/2) v + h (u - b - s (q - q_m) - f),    q' = q + h v',

speeds between positions (leapfrog), which is of second order. Friction f is any torque
up to its limits where the joint stands, and the limit where it moves: for one joint the
answer is a clipped number. The controller's damping ends where its torque does.

A joint that stands where its window begins is held by friction, whatever the torque: so
much it can hold until it moves. A log of slow moves shows more friction at rest than
one law has for all of them.
"""

from dataclasses import dataclass, field, fields
from functools import cached_property

import numpy as np

from seqid_cli.drive.equations import INTEGRAL, PARTS, Delays
from seqid_cli.drive.friction_table import FrictionAlong, FrictionTable
from seqid_cli.drive.integrals import stretch_means
from seqid_cli.drive.rollouts.course import JointCourse
from seqid_cli.logs.raw import Rows
from seqid_cli.typing import Array

FASTEST = 1e3  # rad/s, that no joint reaches
FARTHEST = 1e3  # rad
HOLDS = 1e-9  # share by which friction holds more than it must: rounding moves nothing
# Steps of which all that is known before is computed at once: more of them take memory.
PIECE = 50


@dataclass(frozen=True, kw_only=True)
class LoopValues:
    """Numbers of S sets for one joint, (S, 1) each; see `equations` and `unknowns`."""

    proportional: Array
    derivative: Array  # N m s/rad, of the controller
    integral: Array
    velocity_feedforward: Array
    gravity_compensation: Array
    offset: Array  # N m
    command_delay: Array  # s
    armature: Array  # kg m^2 beside the model
    coulomb: Array  # N m beside the model
    viscous: Array  # N m s/rad beside the model
    friction_factor: Array  # of the model's friction
    stribeck: Array  # N m, by which friction is larger at rest
    stribeck_speed: Array  # rad/s, over which that falls off
    load_friction: Array  # N m per N m behind the gear
    dead_band: Array  # rad, of the controller's error
    start_offset: Array  # rad, rad/s, by which windows begin elsewhere than the log
    start_speed: Array

    def has(self, name: str) -> bool:
        """Tell whether a number is not zero in any set."""
        return bool(np.any(getattr(self, name)))


NAMES = tuple(each.name for each in fields(LoopValues))


@dataclass(frozen=True, kw_only=True)
class JointLoop:
    """A joint in its windows, ready to be simulated.

    `friction` is that of the model, None where it has none.
    """

    course: JointCourse
    friction: FrictionTable | None = field(repr=False)
    torque_limit: float = np.inf  # N m
    torque_lag: float = 0.0  # s, of a measured torque
    velocity_limit: float = np.inf  # rad/s

    def run(self, values: LoopValues) -> Array:
        """Simulate S sets; returns positions (S, R, B) [rad] at the rows."""
        return _Run(loop=self, values=values).positions()


@dataclass(kw_only=True)
class _Run:
    """A simulation on its way: S sets in B windows."""

    loop: JointLoop
    values: LoopValues
    holding: Array | None = None  # (S, B) N m, of friction beyond its law at rest

    @cached_property
    def course(self) -> JointCourse:
        return self.loop.course

    @cached_property
    def shape(self) -> tuple[int, int]:
        return len(self.values.proportional), self.course.windows

    @cached_property
    def of_delay(self) -> tuple[Array, Rows]:
        """Distinct delays (D,) [s], and which of them each set has (S,)."""
        delays, numbers = np.unique(self.values.command_delay, return_inverse=True)
        return delays, numbers.ravel()

    @cached_property
    def commands(self) -> Array:
        """Commands (D, K, B) rad at each delay."""
        delays, _ = self.of_delay
        return np.stack([self.course.command(float(delay)) for delay in delays])

    @cached_property
    def command_speeds(self) -> Array | None:
        """Their velocities (D, K, B) rad/s, None where no controller takes them."""
        if not self.values.has("velocity_feedforward"):
            return None
        delays, _ = self.of_delay
        return np.stack(
            [self.course.slopes_of_command(float(delay)) for delay in delays]
        )

    def positions(self) -> Array:
        """Step through the windows; returns positions (S, R, B) [rad] at the rows."""
        course = self.course
        per_row = course.per_row
        q = np.broadcast_to(course.q0, self.shape) + self.values.start_offset
        v = np.broadcast_to(course.v0, self.shape) + self.values.start_speed
        integral = _Integral(self) if self.values.has("integral") else None
        v_before = v
        out = np.empty((self.shape[0], len(course.q), self.shape[1]))
        out[:, 0] = q
        # A loop that is not stable stays a number, and far off.
        with np.errstate(over="ignore", invalid="ignore"):
            for steps in _pieces(len(course.along)):
                piece = _Piece(run=self, steps=steps)
                for i, k in enumerate(range(steps.start, steps.stop)):
                    u = piece.law(i, q)
                    if integral is not None:
                        u = integral.added(k, u, q)
                    if k == 0:
                        self._hold(piece, u, v)
                        v_before = v
                    # Speeds are half a step behind positions, but for the first ones.
                    v_at_row = v if k == 0 else 1.5 * v - 0.5 * v_before
                    limits = piece.friction(i, v_at_row)
                    v_before = v
                    v = self._next_speed(piece, k, q, v, u, limits)
                    q = q + course.step_s * v
                    if (k + 1) % per_row == 0:
                        out[:, (k + 1) // per_row] = q
        return np.clip(np.nan_to_num(out, nan=FARTHEST), -FARTHEST, FARTHEST)

    def _hold(self, piece: "_Piece", u: Array, v: Array) -> None:
        """Let friction hold what stands at the first step."""
        if not self.course.stands.any():
            return
        wanted = u - self.values.derivative * v - self.course.rest[0]
        low, high = piece.friction(0, v)
        beyond = np.maximum(wanted - high, low - wanted)
        held = np.where(self.course.stands, np.maximum(beyond, 0.0), 0.0)
        self.holding = held * (1.0 + HOLDS)
        v[:, self.course.stands] = 0.0

    def _next_speed(
        self,
        piece: "_Piece",
        k: int,
        q: Array,
        v: Array,
        u: Array,
        limits: tuple[Array, Array],
    ) -> Array:
        """Return speeds (S, B) in the middle of the step, given limits of friction."""
        i = k - piece.steps.start
        damping = self.values.derivative
        limit = self.loop.torque_limit
        if np.isfinite(limit):
            damped = u - damping * v
            is_free = np.abs(damped) <= limit
            u = np.where(is_free, u, np.sign(damped) * limit)
            damping = np.where(is_free, damping, 0.0)
        damping = damping + self.values.viscous

        # The first step brings the speed from its row to the middle of the step.
        h = self.course.step_s if k else 0.5 * self.course.step_s
        m = piece.inertia[i]
        halved = 0.5 * h * damping
        momentum = (m - halved) * v + h * (u - piece.rest(i, q))
        low, high = limits
        if self.holding is not None:
            low = low - self.holding
            high = high + self.holding
        opposed = np.minimum(np.maximum(momentum, h * low), h * high)
        v_next = (momentum - opposed) / (m + halved)
        fastest = min(self.loop.velocity_limit, FASTEST)
        v_next = np.fmin(np.fmax(v_next, -fastest), fastest)
        if self.holding is not None:
            self.holding = np.where(v_next == 0.0, self.holding, 0.0)
            if not self.holding.any():
                self.holding = None
        return np.asarray(v_next)


class _Integral:
    """The integral of a controller, and its torque."""

    def __init__(self, run: _Run) -> None:
        self.run = run
        _, of_set = run.of_delay
        self.commands = run.commands[of_set]
        self.summed = self._first()  # (S, B) rad s
        self.error_before: Array | None = None

    def added(self, k: int, u: Array, q: Array) -> Array:
        """Return a torque (S, B) with that of the integral, and sum up the error."""
        values = self.run.values
        error = self.commands[:, k] - q
        if values.has("dead_band"):
            error = error - np.clip(error, -values.dead_band, values.dead_band)
        if self.error_before is not None:
            # By trapezoids: of whole steps, half of one would be a part of kp.
            mean = 0.5 * (self.error_before + error)
            self.summed = self.summed + mean * self.run.course.step_s
        self.error_before = error
        return np.asarray(u + values.integral * self.summed)

    def _first(self) -> Array:
        """Return the integrals (S, B) with which windows begin, by the logs."""
        values = self.run.values
        pairs = np.column_stack([values.command_delay, values.dead_band])
        distinct, numbers = np.unique(pairs, axis=0, return_inverse=True)
        of_logs = np.array([place.log for place in self.run.course.places])
        begun = np.empty(self.run.shape)
        for number, (delay_s, dead_band) in enumerate(distinct):
            sets = np.flatnonzero(numbers.ravel() == number)
            for log in np.unique(of_logs):
                windows = np.flatnonzero(of_logs == log)
                begun[np.ix_(sets, windows)] = self._first_of(
                    sets, windows, float(delay_s), float(dead_band)
                )
        return begun

    def _first_of(
        self, sets: Rows, windows: Rows, delay_s: float, dead_band: float
    ) -> Array:
        """Return those of some sets that have one delay, in windows of one log."""
        course = self.run.course
        values = self.run.values
        parts = {name: getattr(values, name) for name in PARTS if name in NAMES}
        places = [course.places[int(k)] for k in windows]
        means = stretch_means(
            course.logs[places[0].log],
            course.joint,
            course.course,
            np.array([place.start for place in places]),
            [name for name in parts if name != INTEGRAL and values.has(name)],
            Delays(command=delay_s, torque=self.run.loop.torque_lag),
            torque_limit=self.run.loop.torque_limit,
            dead_band=dead_band,
        )
        return means.integrals(
            {name: part[sets] for name, part in parts.items()},
            offset=values.offset[sets],
            armature=values.armature[sets],
            viscous=values.viscous[sets],
            coulomb=values.coulomb[sets],
        )


def _pieces(steps: int) -> list[range]:
    """Cut steps into pieces of which everything known before is computed at once."""
    return [range(first, min(first + PIECE, steps)) for first in range(0, steps, PIECE)]


@dataclass(kw_only=True)
class _Piece:
    """What is known before of some steps, T of them: only the state is added later."""

    run: _Run
    steps: range

    @property
    def values(self) -> LoopValues:
        return self.run.values

    def _of(self, name: str) -> Array:
        """Return a quantity of the course at the steps (T, 1, B)."""
        whole: Array = getattr(self.run.course, name)
        return whole[self.steps.start : self.steps.stop, None]

    @cached_property
    def command(self) -> Array:
        """(T, S, B) rad."""
        return self._of_sets(self.run.commands)

    def _of_sets(self, by_delay: Array) -> Array:
        _, of_set = self.run.of_delay
        chosen = by_delay[:, self.steps.start : self.steps.stop][of_set]
        return np.swapaxes(chosen, 0, 1)

    @cached_property
    def asked(self) -> Array:
        """The law where the position is zero (T, S, B) N m."""
        values = self.values
        u = values.proportional * self.command + values.offset
        speeds = self.run.command_speeds
        if speeds is not None:
            u = u + values.velocity_feedforward * self._of_sets(speeds)
        if values.has("gravity_compensation"):
            u = u + values.gravity_compensation * self._of("gravity")
        return np.asarray(u)

    def law(self, i: int, q: Array) -> Array:
        """Return what a controller asks for without damping and integral (S, B)."""
        values = self.values
        u = self.asked[i] - values.proportional * q
        if self._has_dead_band:
            error = self.command[i] - q
            inside = np.clip(error, -values.dead_band, values.dead_band)
            u = u - values.proportional * inside
        return np.asarray(u)

    @cached_property
    def _has_dead_band(self) -> bool:
        return self.values.has("dead_band")

    @cached_property
    def inertia(self) -> Array:
        """(T, S, B) or (T, 1, B) kg m^2."""
        if self.values.has("armature"):
            return np.asarray(self._of("inertia") + self.values.armature)
        return self._of("inertia")

    @cached_property
    def _rest(self) -> Array:
        """What the rest of the arm asks where the position is zero (T, 1, B) N m."""
        return self._of("rest") - self._of("slope") * self._of("along")

    def rest(self, i: int, q: Array) -> Array:
        """Return what the rest of the arm asks (S, B) N m."""
        return np.asarray(self._rest[i] + self.run.course.slope[self.steps[i]] * q)

    @cached_property
    def _size(self) -> Array:
        """Friction of either direction beside the model's (T, S, B) N m."""
        size = self.values.coulomb
        if self.values.has("load_friction"):
            return size + self.values.load_friction * np.abs(self._of("load"))
        return np.broadcast_to(size, (len(self.steps), *size.shape))

    @cached_property
    def _has_stribeck(self) -> bool:
        return self.values.has("stribeck")

    @cached_property
    def _of_model(self) -> FrictionAlong | None:
        table = self.run.loop.friction
        return None if table is None else table.along(self._of("along")[:, 0])

    def friction(self, i: int, v: Array) -> tuple[Array, Array]:
        """Return the least and the largest friction (S, B) N m."""
        values = self.values
        size = self._size[i]
        if self._has_stribeck:
            size = size + values.stribeck * np.exp(
                -np.square(v / values.stribeck_speed)
            )
        if self._of_model is None:
            return -size, size
        low, high = self._of_model.limits(i, v)
        return values.friction_factor * low - size, values.friction_factor * high + size
