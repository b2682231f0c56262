"""Arm, friction and controllers in closed loop, many windows of time at once.

Everything is stepped together for B windows, so that a step costs a few calls of numpy,
however many windows there are. With the mass matrix M, gravity and Coriolis torques h,
friction f, and the damping D of controllers and viscous friction, a step of dt is

    (M + D dt/2) v' = (M - D dt/2) v + dt (u - h - f),    q' = q + dt v',

speeds between positions (leapfrog), which is of second order. Damping counts at the
mean of both speeds, so that stiff dampers of light joints do not oscillate. What else
depends on speeds (Coriolis torques, the model's friction) takes them at the positions,
by the two speeds before.

Friction is what opposes motion: f lies between its values for both directions, and is
inside where the joint stands. With A = M + D dt/2 this is a complementarity problem

    v' = A^-1 ((M - D dt/2) v + dt (u - h)) - dt A^-1 f,    f_lo <= f <= f_hi,

solved joint by joint in turn (projected Gauss-Seidel), beginning with the friction of
the step before. A torque at its limit has no damping of its own.

A joint that stands where its window begins is held by friction, whatever the torque: so
much it can hold until it moves.

A joint without a controller is led along its measured motion: by a damper to its
measured speed beside which its inertia counts for nothing.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from seqid_cli.drive.effects import EffectTorque, State
from seqid_cli.drive.friction_table import FrictionTable
from seqid_cli.model.torque import TorqueModel
from seqid_cli.typing import Array, Mask

STEP_S = 1e-3  # at most; half of it moves a replayed position by some 1e-6 rad
SWEEPS = 8  # over the joints, for friction; one joint is solved by the first
FASTEST = 1e3  # rad/s, that no joint reaches
HOLDS = 1e-9  # share by which friction holds more than it must: rounding moves nothing
LEADS = 1e7  # times the largest inertia, by which a joint is led


@dataclass(frozen=True, kw_only=True)
class Gains:
    """The controllers of n joints, (n,) each; see `equations`."""

    proportional: Array
    derivative: Array
    integral: Array
    velocity_feedforward: Array
    acceleration_feedforward: Array
    gravity: Array
    offset: Array  # N m
    torque_limit: Array  # N m, infinite where there is none
    # What the model of the arm lacks, and what windows of the logs have shown.
    velocity_limit: Array  # rad/s, infinite where there is none
    dead_band: Array  # rad, of the error of the position
    armature: Array  # kg m^2
    coulomb: Array  # N m
    viscous: Array  # N m s/rad
    friction_factor: Array  # of the model's friction
    stribeck: Array  # N m, by which friction is larger at rest
    stribeck_speed: Array  # rad/s, over which that falls off
    load_friction: Array  # N m per N m behind the gear


@dataclass(frozen=True, kw_only=True)
class Asked:
    """What the controllers take for their command, T steps of B windows."""

    c: Array  # (T, B, n) rad, delays in it
    dc: Array  # (T, B, n) rad/s
    ddc: Array  # (T, B, n) rad/s^2
    # (T, B, n) rad/s, of joints that are led; not a number where a controller moves one
    led: Array | None = None
    celsius: Array | None = None  # (B, n) degC of the joints, where it is logged
    # (B,) of each effect of the loop, the deflection of bristles where a window begins
    bristles: Sequence[Array] = ()


@dataclass(frozen=True, kw_only=True)
class Simulated:
    """States and torques at T steps of B windows, (T, B, n)."""

    q: Array
    dq: Array
    torque: Array


@dataclass(frozen=True, kw_only=True)
class _Motion:
    """Where B windows are, (B, n) each.

    Attributes
    ----------
    q : array
        rad.
    v : array
        rad/s, half a step before the positions; of the first one at these.
    v_before : array, optional
        rad/s, a step before; None where windows begin.
    friction : array
        N m, of the last step.
    """

    q: Array
    v: Array
    v_before: Array | None
    friction: Array

    @classmethod
    def begun(cls, q0: Array, v0: Array) -> "_Motion":
        """Return the motion where windows begin."""
        return cls(q=q0, v=v0, v_before=None, friction=np.zeros_like(q0))

    def stopped(self, standing: Mask) -> "_Motion":
        """Return the motion with joints (B, n) that stand."""
        return replace(self, v=np.where(standing, 0.0, self.v))

    @property
    def v_at_row(self) -> Array:
        """Speeds at the positions, as far as is known before the step."""
        if self.v_before is None:
            return self.v
        return np.asarray(1.5 * self.v - 0.5 * self.v_before)


@dataclass(frozen=True, kw_only=True)
class ClosedLoop:
    """An arm with its controllers."""

    model: TorqueModel
    gains: Gains
    friction: Sequence[FrictionTable]
    effects: Sequence[EffectTorque] = ()  # beside those in the tables

    def run(
        self,
        q0: Array,
        v0: Array,
        integral: Array,
        asked: Asked,
        step_s: float,
        standing: Mask | None = None,
    ) -> Simulated:
        """Run the windows from their first states.

        Parameters
        ----------
        q0, v0 : (B, n) arrays
            rad, rad/s.
        integral : (B, n) array
            rad s, with which controllers begin.
        asked : Asked
        step_s : float
        standing : (B, n) mask, optional
            Joints that stand where a window begins: friction holds them, whatever the
            torque, until they move.
        """
        gains = self.gains
        motion = _Motion.begun(q0, v0)
        holding = np.zeros_like(q0)
        added = self._added(q0, asked)
        out = Simulated(
            q=np.empty_like(asked.c),
            dq=np.empty_like(asked.c),
            torque=np.empty_like(asked.c),
        )
        error_before = asked.c[0] - q0
        is_free = np.ones(q0.shape, np.bool_)
        for k in range(len(asked.c)):
            q = motion.q
            v = motion.v_at_row
            # By trapezoids: of whole steps, half of one would be a part of kp. A
            # controller at its limit does not sum up what it cannot give.
            error = self._error(asked, k, q)
            if k:
                mean = 0.5 * (error_before + error)
                integral = integral + np.where(is_free, mean, 0.0) * step_s
            error_before = error
            # `wanted` lacks the damping, which counts in the middle of the step.
            wanted = self._law(asked, k, q, error, integral)
            damped = wanted - gains.derivative * v
            is_free = np.abs(damped) <= gains.torque_limit
            limited = np.clip(damped, -gains.torque_limit, gains.torque_limit)
            u = np.where(is_free, wanted, limited)
            kd = np.where(is_free, gains.derivative, 0.0)
            if k == 0 and standing is not None:
                motion = motion.stopped(standing)
                holding = self._holding(motion, u, standing, added)
            led = None if asked.led is None else asked.led[k]
            later = self._stepped(motion, u, kd, step_s, holding, added, led)
            out.q[k] = q
            out.dq[k] = v if k == 0 else 0.5 * (motion.v + later.v)
            out.torque[k] = u - kd * out.dq[k]
            added.travelled(later.q - q)
            holding = np.where(later.v == 0.0, holding, 0.0)
            motion = later
        return out

    def run_open(self, q0: Array, v0: Array, torque: Array, step_s: float) -> Simulated:
        """Run the windows by a given torque (T, B, n), without controllers."""
        motion = _Motion.begun(q0, v0)
        nothing = np.zeros_like(q0)
        out = Simulated(
            q=np.empty_like(torque), dq=np.empty_like(torque), torque=torque
        )
        added = self._added(q0, None)
        for k in range(len(torque)):
            later = self._stepped(motion, torque[k], nothing, step_s, nothing, added)
            out.q[k] = motion.q
            out.dq[k] = v0 if k == 0 else 0.5 * (motion.v + later.v)
            added.travelled(later.q - motion.q)
            motion = later
        return out

    def integrals_at_rest(self, q: Array) -> Array:
        """Return the integrals (B, n) [rad s] by which joints stay where they are."""
        gains = self.gains
        at_rest = np.zeros_like(q)
        left = (1.0 - gains.gravity) * self.model.rigid(q, at_rest, at_rest)
        is_there = gains.integral != 0.0
        divisor = np.where(is_there, gains.integral, 1.0)
        return np.where(is_there, (left - gains.offset) / divisor, 0.0)

    def _added(self, q: Array, asked: Asked | None) -> "AddedTorques":
        """Return what effects add, with their states where windows begin."""
        bristles = [np.zeros(len(q)) for _ in self.effects]
        if asked is not None and asked.bristles:
            bristles = [each.copy() for each in asked.bristles]
        return AddedTorques(
            model=self.model,
            effects=self.effects,
            bristles=bristles,
            celsius=None if asked is None else asked.celsius,
        )

    def _error(self, asked: Asked, k: int, q: Array) -> Array:
        """Return the error of the position (B, n) [rad] that counts."""
        error = asked.c[k] - q
        band = self.gains.dead_band
        return np.asarray(error - np.clip(error, -band, band))

    def _law(
        self, asked: Asked, k: int, q: Array, error: Array, integral: Array
    ) -> Array:
        """Return what the controllers ask for without their damping (B, n) N m."""
        gains = self.gains
        u = gains.proportional * error + gains.offset
        u = u + gains.velocity_feedforward * asked.dc[k]
        u = u + gains.acceleration_feedforward * asked.ddc[k]
        u = u + gains.integral * integral
        if gains.gravity.any():
            at_rest = np.zeros_like(q)
            u = u + gains.gravity * self.model.rigid(q, at_rest, at_rest)
        return np.asarray(u)

    def _stepped(
        self,
        motion: "_Motion",
        u: Array,
        kd: Array,
        step_s: float,
        holding: Array,
        added: "AddedTorques",
        led: Array | None = None,
    ) -> "_Motion":
        """Return the motion a step later."""
        q = motion.q
        v = motion.v_at_row
        # The first step brings speeds from their row to the middle of the step.
        h = 0.5 * step_s if motion.v_before is None else step_s
        M, rest = self._dynamics(q, v)
        rest = rest + added.torque(q, v, rest)
        n = q.shape[1]
        halved = 0.5 * h * (kd + self.gains.viscous)
        A = M + halved[:, :, None] * np.eye(n)
        momentum = np.einsum("bij,bj->bi", M, motion.v) - halved * motion.v
        if led is not None:
            damper = np.where(np.isfinite(led), LEADS * np.abs(M).max(), 0.0)
            A = A + damper[:, :, None] * np.eye(n)
            momentum = momentum + damper * np.nan_to_num(led)
        inverse = np.linalg.inv(A)
        w = np.einsum("bij,bj->bi", inverse, momentum + h * (u - rest))
        inverse = h * inverse

        low, high = self._friction(q, v, rest, added)
        low = low - holding
        high = high + holding
        f = motion.friction.copy()
        for _ in range(SWEEPS if n > 1 else 1):
            for j in range(n):
                speed = w[:, j] - np.einsum("bk,bk->b", inverse[:, j], f)
                f[:, j] = np.clip(
                    f[:, j] + speed / inverse[:, j, j], low[:, j], high[:, j]
                )
        v_next = w - np.einsum("bij,bj->bi", inverse, f)
        # Sweeps leave a joint that stands a speed of their own error.
        inside = (f > low) & (f < high)
        v_next = np.where(inside, 0.0, v_next)
        # A loop that is not stable stays a number, and far off.
        fastest = np.minimum(self.gains.velocity_limit, FASTEST)
        v_next = np.clip(np.nan_to_num(v_next), -fastest, fastest)
        return _Motion(q=q + step_s * v_next, v=v_next, v_before=motion.v, friction=f)

    def _friction(
        self, q: Array, v: Array, load: Array, added: "AddedTorques"
    ) -> tuple[Array, Array]:
        """Return the least and the largest friction (B, n) N m."""
        gains = self.gains
        size = gains.coulomb + gains.load_friction * np.abs(load)
        size = size + gains.stribeck * np.exp(-np.square(v / gains.stribeck_speed))
        limits = [
            table.limits(q[:, j], v[:, j]) for j, table in enumerate(self.friction)
        ]
        low = np.stack([low for low, _ in limits], axis=1)
        high = np.stack([high for _, high in limits], axis=1)
        low = gains.friction_factor * low - size
        high = gains.friction_factor * high + size
        if self.effects:
            low = low + added.friction(q, v, load, -1.0)
            high = high + added.friction(q, v, load, 1.0)
        return np.minimum(low, high), np.maximum(low, high)

    def _holding(
        self, motion: "_Motion", u: Array, standing: Mask, added: "AddedTorques"
    ) -> Array:
        """Return the torque (B, n) beyond its law by which friction holds joints."""
        q = motion.q
        v = motion.v
        _, rest = self._dynamics(q, v)
        rest = rest + added.torque(q, v, rest)
        low, high = self._friction(q, v, rest, added)
        beyond = np.maximum(u - rest - high, low - (u - rest))
        return np.where(standing, np.maximum(beyond, 0.0) * (1.0 + HOLDS), 0.0)

    def _dynamics(self, q: Array, v: Array) -> tuple[Array, Array]:
        """Return mass matrices (B, n, n), and Coriolis and gravity torque (B, n)."""
        B, n = q.shape
        # All in one call: the motion, rest, and a unit acceleration of each joint.
        zeros = np.zeros((B, n))
        accelerations = np.repeat(np.eye(n), B, axis=0)
        torque = self.model.rigid(
            np.tile(q, (n + 2, 1)),
            np.concatenate([v, np.zeros(((n + 1) * B, n))]),
            np.concatenate([zeros, zeros, accelerations]),
        ).reshape(n + 2, B, n)
        M = np.moveaxis(torque[2:] - torque[1], 0, 2) + np.diag(self.gains.armature)
        return np.asarray(M), np.asarray(torque[0])


@dataclass(kw_only=True)
class AddedTorques:
    """What effects add in B windows, with the deflection (B,) of bristles by effect."""

    model: TorqueModel
    effects: Sequence[EffectTorque]
    bristles: list[Array]
    celsius: Array | None

    def torque(self, q: Array, v: Array, load: Array) -> Array:
        """Return the torque (B, n) N m of those that are no friction."""
        total = np.zeros_like(q)
        state = State(q=q, dq=v, load=load, sign=np.sign(v), celsius=self.celsius)
        for each in self.effects:
            if not each.rubs:
                total[:, each.joint] += each.torque(state, self.model)
        return total

    def friction(self, q: Array, v: Array, load: Array, direction: float) -> Array:
        """Return the friction (B, n) N m that they add in a direction of all joints."""
        total = np.zeros_like(q)
        state = State(
            q=q,
            dq=direction * np.abs(v),
            load=load,
            sign=np.full_like(q, direction),
            celsius=self.celsius,
        )
        for each, bristle in zip(self.effects, self.bristles, strict=True):
            if each.rubs:
                total[:, each.joint] += each.torque(state, self.model, bristle)
        return total

    def travelled(self, way: Array) -> None:
        """Bend bristles by the way (B, n) [rad] that joints went."""
        for k, each in enumerate(self.effects):
            if each.bristles is None:
                continue
            travel = way[:, each.joint] / each.bristles.distance
            kept = np.exp(-np.abs(travel))
            self.bristles[k] = kept * self.bristles[k] + np.sign(travel) * (1.0 - kept)
