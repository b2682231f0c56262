"""Arm, friction and controllers in closed loop, many windows of time at once.

Everything is stepped together for B windows, so that a step costs a few calls of numpy,
however many windows there are. With the mass matrix M, gravity and Coriolis torques h,
friction f and a controller whose damping kd counts at the new speed (stiff dampers of
light joints would otherwise oscillate), a step of dt is

    (M + dt kd) v' = M v + dt (u - h - f),    q' = q + dt v'.

Friction is what opposes motion: f lies between its values for both directions, and is
inside where the joint stands. With A = M + dt kd this is a complementarity problem

    v' = A^-1 (M v + dt (u - h)) - dt A^-1 f,    f_lo <= f <= f_hi,

solved joint by joint in turn (projected Gauss-Seidel), beginning with the friction of
the step before. A torque at its limit has no damping of its own.

A joint that stands where its window begins is held by friction, whatever the torque: so
much it can hold until it moves.

A joint without a controller is led along its measured motion: by a damper to its
measured speed beside which its inertia counts for nothing.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from seqid_cli.drive.effects import EffectTorque, State
from seqid_cli.drive.friction_table import FrictionTable
from seqid_cli.model.torque import TorqueModel
from seqid_cli.typing import Array, Mask

STEP_S = 1e-3  # at most; half of it moves a replayed position by less than 1e-4 of it
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
        first_torque: Array,
        asked: Asked,
        step_s: float,
        standing: Mask | None = None,
    ) -> Simulated:
        """Run the windows from their first states.

        Parameters
        ----------
        q0, v0 : (B, n) arrays
            rad, rad/s.
        first_torque : (B, n) array
            N m, by which integrals begin where they must be.
        asked : Asked
        step_s : float
        standing : (B, n) mask, optional
            Joints that stand where a window begins: friction holds them, whatever the
            torque, until they move.
        """
        gains = self.gains
        steps = len(asked.c)
        q = q0.copy()
        v = v0.copy()
        f = np.zeros_like(q)
        holding = np.zeros_like(q)
        added = self._added(q, asked)
        out = Simulated(
            q=np.empty_like(asked.c),
            dq=np.empty_like(asked.c),
            torque=np.empty_like(asked.c),
        )
        # The integral holds whatever the torque has beside the rest of the law.
        first = self._law(asked, 0, q, v, np.zeros_like(q))
        integral = np.where(
            gains.integral != 0.0,
            (first_torque - first + gains.derivative * v)
            / np.where(gains.integral != 0.0, gains.integral, 1.0),
            0.0,
        )
        for k in range(steps):
            # `wanted` lacks the damping, which counts at the new speed.
            wanted = self._law(asked, k, q, v, integral)
            damped = wanted - gains.derivative * v
            is_free = np.abs(damped) <= gains.torque_limit
            limited = np.clip(damped, -gains.torque_limit, gains.torque_limit)
            u = np.where(is_free, wanted, limited)
            kd = np.where(is_free, gains.derivative, 0.0)
            out.q[k] = q
            out.dq[k] = v
            out.torque[k] = u - kd * v
            if k == 0 and standing is not None:
                v = np.where(standing, 0.0, v)
                holding = self._holding(q, v, u, standing, added)
            led = None if asked.led is None else asked.led[k]
            before = q
            q, v, f = self._stepped(q, v, f, u, kd, step_s, holding, added, led)
            added.travelled(q - before)
            holding = np.where(v == 0.0, holding, 0.0)
            # A controller at its limit does not sum up what it cannot give.
            integral = integral + np.where(is_free, asked.c[k] - q, 0.0) * step_s
        return out

    def run_open(self, q0: Array, v0: Array, torque: Array, step_s: float) -> Simulated:
        """Run the windows by a given torque (T, B, n), without controllers."""
        q = q0.copy()
        v = v0.copy()
        f = np.zeros_like(q)
        out = Simulated(
            q=np.empty_like(torque), dq=np.empty_like(torque), torque=torque
        )
        added = self._added(q, None)
        for k in range(len(torque)):
            out.q[k] = q
            out.dq[k] = v
            nothing = np.zeros_like(q)
            before = q
            q, v, f = self._stepped(q, v, f, torque[k], nothing, step_s, nothing, added)
            added.travelled(q - before)
        return out

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

    def _law(self, asked: Asked, k: int, q: Array, v: Array, integral: Array) -> Array:
        """Return what the controllers ask for without their damping (B, n) N m."""
        gains = self.gains
        error = asked.c[k] - q
        error = error - np.clip(error, -gains.dead_band, gains.dead_band)
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
        q: Array,
        v: Array,
        f: Array,
        u: Array,
        kd: Array,
        step_s: float,
        holding: Array,
        added: "AddedTorques",
        led: Array | None = None,
    ) -> tuple[Array, Array, Array]:
        """Return positions, speeds and friction (B, n) a step later."""
        M, h = self._dynamics(q, v)
        h = h + added.torque(q, v, h)
        n = q.shape[1]
        A = M + step_s * kd[:, :, None] * np.eye(n)
        momentum = np.einsum("bij,bj->bi", M, v)
        if led is not None:
            damper = np.where(np.isfinite(led), LEADS * np.abs(M).max(), 0.0)
            A = A + damper[:, :, None] * np.eye(n)
            momentum = momentum + damper * np.nan_to_num(led)
        inverse = np.linalg.inv(A)
        w = np.einsum("bij,bj->bi", inverse, momentum + step_s * (u - h))
        inverse = step_s * inverse

        low, high = self._friction(q, v, h, added)
        low = low - holding
        high = high + holding
        f = f.copy()
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
        return q + step_s * v_next, v_next, f

    def _friction(
        self, q: Array, v: Array, load: Array, added: "AddedTorques"
    ) -> tuple[Array, Array]:
        """Return the least and the largest friction (B, n) N m."""
        gains = self.gains
        size = gains.coulomb + gains.viscous * np.abs(v)
        size = size + gains.load_friction * np.abs(load)
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
        self, q: Array, v: Array, u: Array, standing: Mask, added: "AddedTorques"
    ) -> Array:
        """Return the torque (B, n) beyond its law by which friction holds joints."""
        _, h = self._dynamics(q, v)
        h = h + added.torque(q, v, h)
        low, high = self._friction(q, v, h, added)
        beyond = np.maximum(u - h - high, low - (u - h))
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
