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
"""

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from seqid_cli.logs.raw import Rows
from seqid_cli.model.friction import FrictionSurface
from seqid_cli.model.torque import TorqueModel
from seqid_cli.typing import Array

STEP_S = 1e-3  # at most; half of it moves a replayed position by less than 1e-4 of it
SWEEPS = 8  # over the joints, for friction; one joint is solved by the first
# Widths of the sign over which friction changes sides: beyond them it is whole.
FULL_WIDTHS = 5.0
FASTEST = 1e3  # rad/s, that no joint reaches
POSITIONS = 33  # of the friction tables
SPEEDS = 65


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


@dataclass
class FrictionTable:
    """Friction of one joint for either direction, on a grid of positions and speeds.

    A surface is a polynomial that costs much to evaluate at every step.
    """

    positions: Array
    speeds: Array
    forward: Array = field(repr=False)  # (POSITIONS, SPEEDS) N m
    backward: Array = field(repr=False)

    @classmethod
    def of(
        cls, surface: FrictionSurface | None, low: float, high: float, fastest: float
    ) -> "FrictionTable":
        """Fill the table over some positions, up to a speed."""
        positions = np.linspace(low, high, POSITIONS)
        speeds = np.linspace(0.0, fastest, SPEEDS)
        if surface is None:
            nothing = np.zeros((POSITIONS, SPEEDS))
            return cls(positions, speeds, nothing, nothing)
        full = np.maximum(speeds, FULL_WIDTHS * surface.sign_width)
        q = np.repeat(positions, SPEEDS)
        v = np.tile(full, POSITIONS)
        shape = (POSITIONS, SPEEDS)
        return cls(
            positions,
            speeds,
            surface.torque(q, v).reshape(shape),
            surface.torque(q, -v).reshape(shape),
        )

    def limits(self, q: Array, v: Array) -> tuple[Array, Array]:
        """Return the least and the largest friction (B,) N m."""
        i, x = _place(self.positions, q)
        k, y = _place(self.speeds, np.abs(v))

        def at(table: Array) -> Array:
            before = table[i, k] * (1.0 - y) + table[i, k + 1] * y
            after = table[i + 1, k] * (1.0 - y) + table[i + 1, k + 1] * y
            return np.asarray(before * (1.0 - x) + after * x)

        low = at(self.backward)
        high = at(self.forward)
        return np.minimum(low, high), np.maximum(low, high)


def _place(grid: Array, values: Array) -> tuple[Rows, Array]:
    """Return the cell of each value on an even grid, and the place in it, 0 to 1."""
    place = (values - grid[0]) / (grid[1] - grid[0])
    place = np.clip(place, 0.0, len(grid) - 1.000001)
    cell: Rows = place.astype(np.intp)
    return cell, np.asarray(place - cell)


@dataclass(frozen=True, kw_only=True)
class ClosedLoop:
    """An arm with its controllers."""

    model: TorqueModel
    gains: Gains
    friction: Sequence[FrictionTable]

    def run(
        self, q0: Array, v0: Array, first_torque: Array, asked: Asked, step_s: float
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
        """
        gains = self.gains
        steps = len(asked.c)
        q = q0.copy()
        v = v0.copy()
        f = np.zeros_like(q)
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
            q, v, f = self._stepped(q, v, f, u, kd, step_s)
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
            q, v, f = self._stepped(q, v, f, torque[k], np.zeros_like(q), step_s)
        return out

    def _law(self, asked: Asked, k: int, q: Array, v: Array, integral: Array) -> Array:
        """Return what the controllers ask for without their damping (B, n) N m."""
        gains = self.gains
        u = gains.proportional * (asked.c[k] - q) + gains.offset
        u = u + gains.velocity_feedforward * asked.dc[k]
        u = u + gains.acceleration_feedforward * asked.ddc[k]
        u = u + gains.integral * integral
        if gains.gravity.any():
            at_rest = np.zeros_like(q)
            u = u + gains.gravity * self.model.rigid(q, at_rest, at_rest)
        return np.asarray(u)

    def _stepped(
        self, q: Array, v: Array, f: Array, u: Array, kd: Array, step_s: float
    ) -> tuple[Array, Array, Array]:
        """Return positions, speeds and friction (B, n) a step later."""
        M, h = self._dynamics(q, v)
        n = q.shape[1]
        A = M + step_s * kd[:, :, None] * np.eye(n)
        inverse = np.linalg.inv(A)
        momentum = np.einsum("bij,bj->bi", M, v)
        w = np.einsum("bij,bj->bi", inverse, momentum + step_s * (u - h))
        inverse = step_s * inverse

        limits = [self.friction[j].limits(q[:, j], v[:, j]) for j in range(n)]
        f = f.copy()
        for _ in range(SWEEPS if n > 1 else 1):
            for j, (low, high) in enumerate(limits):
                speed = w[:, j] - np.einsum("bk,bk->b", inverse[:, j], f)
                f[:, j] = np.clip(f[:, j] + speed / inverse[:, j, j], low, high)
        v_next = w - np.einsum("bij,bj->bi", inverse, f)
        # A loop that is not stable stays a number, and far off.
        v_next = np.clip(np.nan_to_num(v_next), -FASTEST, FASTEST)
        return q + step_s * v_next, v_next, f

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
        M = np.moveaxis(torque[2:] - torque[1], 0, 2)
        return np.asarray(M), np.asarray(torque[0])
