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

from seqid_cli.drive.friction_table import FrictionTable
from seqid_cli.drive.rollouts.course import JointCourse
from seqid_cli.logs.raw import Rows
from seqid_cli.typing import Array

FASTEST = 1e3  # rad/s, that no joint reaches
FARTHEST = 1e3  # rad
HOLDS = 1e-9  # share by which friction holds more than it must: rounding moves nothing


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
    friction_factor: Array  # of the model's friction
    stribeck: Array  # N m, by which friction is larger at rest
    stribeck_speed: Array  # rad/s, over which that falls off
    load_friction: Array  # N m per N m behind the gear
    dead_band: Array  # rad, of the controller's error

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
    velocity_limit: float = np.inf  # rad/s

    def run(self, values: LoopValues) -> Array:
        """Simulate S sets; returns positions (S, R, B) [rad] at the rows."""
        return _Run(loop=self, values=values).positions()


@dataclass(kw_only=True)
class _Run:
    """A simulation on its way: S sets in B windows."""

    loop: JointLoop
    values: LoopValues
    holding: Array | float = 0.0  # (S, B) N m, of friction beyond its law at rest

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
        q = np.broadcast_to(course.q0, self.shape).copy()
        v = np.broadcast_to(course.v0, self.shape).copy()
        summed: Array | None = None
        out = np.empty((self.shape[0], len(course.q), self.shape[1]))
        out[:, 0] = q
        for k in range(len(course.along)):
            u, error = self._law(k, q)
            if self.values.has("integral"):
                if summed is None:
                    summed = self._first_integral(u, v)
                u = u + self.values.integral * summed
                summed = summed + error * course.step_s
            if k == 0:
                self._hold(u, v)
            v = self._next_speed(k, q, v, u)
            q = q + course.step_s * v
            if (k + 1) % per_row == 0:
                out[:, (k + 1) // per_row] = q
        # A loop that is not stable stays a number, and far off.
        return np.clip(np.nan_to_num(out, nan=FARTHEST), -FARTHEST, FARTHEST)

    def _law(self, k: int, q: Array) -> tuple[Array, Array]:
        """Return what a controller asks for without damping, and its error (S, B)."""
        values = self.values
        _, of_set = self.of_delay
        error = self.commands[of_set, k] - q
        if values.has("dead_band"):
            error = error - np.clip(error, -values.dead_band, values.dead_band)
        u = values.proportional * error + values.offset
        if self.command_speeds is not None:
            u = u + values.velocity_feedforward * self.command_speeds[of_set, k]
        if values.has("gravity_compensation"):
            u = u + values.gravity_compensation * self.course.gravity[k]
        return u, error

    def _hold(self, u: Array, v: Array) -> None:
        """Let friction hold what stands at the first step."""
        wanted = u - self.values.derivative * v - self.course.rest[0]
        low, high = self._friction(0, v)
        beyond = np.maximum(wanted - high, low - wanted)
        held = np.where(self.course.stands, np.maximum(beyond, 0.0), 0.0)
        self.holding = held * (1.0 + HOLDS)
        v[:, self.course.stands] = 0.0

    def _first_integral(self, u: Array, v: Array) -> Array:
        """Return the integral that has what the torque has beside the law's rest."""
        values = self.values
        rest = self.course.torque - u + values.derivative * v
        is_there = values.integral != 0.0
        divisor = np.where(is_there, values.integral, 1.0)
        return np.where(is_there, rest / divisor, 0.0)

    def _next_speed(self, k: int, q: Array, v: Array, u: Array) -> Array:
        """Return speeds (S, B) in the middle of the step."""
        course = self.course
        damping = self.values.derivative
        limit = self.loop.torque_limit
        if np.isfinite(limit):
            damped = u - damping * v
            is_free = np.abs(damped) <= limit
            u = np.where(is_free, u, np.sign(damped) * limit)
            damping = np.where(is_free, damping, 0.0)

        # The first step brings the speed from its row to the middle of the step.
        h = course.step_s if k else 0.5 * course.step_s
        m = course.inertia[k] + self.values.armature
        halved = 0.5 * h * damping
        asked = course.rest[k] + course.slope[k] * (q - course.along[k])
        momentum = (m - halved) * v + h * (u - asked)
        low, high = self._friction(k, v)
        low = low - self.holding
        high = high + self.holding
        v_next = (momentum - np.clip(momentum, h * low, h * high)) / (m + halved)
        fastest = min(self.loop.velocity_limit, FASTEST)
        v_next = np.asarray(np.clip(v_next, -fastest, fastest))
        self.holding = np.where(v_next == 0.0, self.holding, 0.0)
        return v_next

    def _friction(self, k: int, v: Array) -> tuple[Array, Array]:
        """Return the least and the largest friction (S, B) N m."""
        values = self.values
        size = values.coulomb
        if values.has("stribeck"):
            size = size + values.stribeck * np.exp(
                -np.square(v / values.stribeck_speed)
            )
        if values.has("load_friction"):
            size = size + values.load_friction * np.abs(self.course.load[k])
        low = -size
        high = size
        if self.loop.friction is not None:
            at = np.broadcast_to(self.course.along[k], self.shape)
            below, above = self.loop.friction.limits(at.ravel(), v.ravel())
            low = low + values.friction_factor * below.reshape(self.shape)
            high = high + values.friction_factor * above.reshape(self.shape)
        return low, high
