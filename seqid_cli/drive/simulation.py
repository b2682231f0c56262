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
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from seqid_cli.drive.friction_table import FrictionTable
from seqid_cli.model.torque import TorqueModel
from seqid_cli.typing import Array, Mask

STEP_S = 1e-3  # at most; half of it moves a replayed position by less than 1e-4 of it
SWEEPS = 8  # over the joints, for friction; one joint is solved by the first
FASTEST = 1e3  # rad/s, that no joint reaches
HOLDS = 1e-9  # share by which friction holds more than it must: rounding moves nothing


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
            u = np.where(is_free, wanted, np.sign(damped) * gains.torque_limit)
            kd = np.where(is_free, gains.derivative, 0.0)
            out.q[k] = q
            out.dq[k] = v
            out.torque[k] = u - kd * v
            if k == 0 and standing is not None:
                v = np.where(standing, 0.0, v)
                holding = self._holding(q, v, u, standing)
            q, v, f = self._stepped(q, v, f, u, kd, step_s, holding)
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
        for k in range(len(torque)):
            out.q[k] = q
            out.dq[k] = v
            nothing = np.zeros_like(q)
            q, v, f = self._stepped(q, v, f, torque[k], nothing, step_s, nothing)
        return out

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
    ) -> tuple[Array, Array, Array]:
        """Return positions, speeds and friction (B, n) a step later."""
        M, h = self._dynamics(q, v)
        n = q.shape[1]
        A = M + step_s * kd[:, :, None] * np.eye(n)
        inverse = np.linalg.inv(A)
        momentum = np.einsum("bij,bj->bi", M, v)
        w = np.einsum("bij,bj->bi", inverse, momentum + step_s * (u - h))
        inverse = step_s * inverse

        low, high = self._friction(q, v, h)
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

    def _friction(self, q: Array, v: Array, load: Array) -> tuple[Array, Array]:
        """Return the least and the largest friction (B, n) N m."""
        gains = self.gains
        size = gains.coulomb + gains.load_friction * np.abs(load)
        size = size + gains.stribeck * np.exp(-np.square(v / gains.stribeck_speed))
        limits = [
            table.limits(q[:, j], v[:, j]) for j, table in enumerate(self.friction)
        ]
        low = np.stack([low for low, _ in limits], axis=1)
        high = np.stack([high for _, high in limits], axis=1)
        return gains.friction_factor * low - size, gains.friction_factor * high + size

    def _holding(self, q: Array, v: Array, u: Array, standing: Mask) -> Array:
        """Return the torque (B, n) beyond its law by which friction holds joints."""
        _, h = self._dynamics(q, v)
        low, high = self._friction(q, v, h)
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
