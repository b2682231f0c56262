"""Joint friction as physics: a set-valued dry part and a smooth part."""

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple, Protocol

import numpy as np
from scipy.linalg.lapack import dgesv

from tests import Array


class Friction(NamedTuple):
    """Friction of n joints, N m: dry level for dq > 0 and for dq < 0 (both >= 0),
    smooth torque.
    """

    forward: Array
    backward: Array
    smooth: Array

    def sliding(self, dq: Array) -> Array:
        return np.where(dq > 0, self.forward, -self.backward) + self.smooth


# (t [s], q, dq, load [N m]) -> Friction
Law = Callable[[float, Array, Array, Array], Friction]


class FrictionModel(Protocol):
    """Makes a law with fresh internal state for one run."""

    def begin(self) -> Law: ...


@dataclass(frozen=True)
class SurfaceFriction:
    """Dry friction that depends on position, with a Stribeck hump, and viscous
    friction.

    level = coulomb [1 + sum_k amplitude_k sin(k q + phase_k)] + stribeck
    exp(-(dq/v_s)^2) smooth = viscous dq, v_s = stribeck_speed. All (n,), harmonics (n,
    K); N m, rad/s, N m s/rad.
    """

    coulomb: Array
    viscous: Array
    stribeck: Array
    stribeck_speed: Array
    amplitude: Array
    phase: Array

    def __call__(self, t: float, q: Array, dq: Array, load: Array) -> Friction:
        """Evaluate at one instant; q and dq are (..., n)."""
        if self._is_plain:
            level = np.broadcast_to(self.coulomb, dq.shape)
            return Friction(level, level, self.viscous * dq)
        waves = self.amplitude * np.sin(q[..., None] * self._orders + self.phase)
        level = self.coulomb * (1.0 + np.add.reduce(waves, axis=-1))
        level = level + self.stribeck * np.exp(-((dq / self.stribeck_speed) ** 2))
        return Friction(level, level, self.viscous * dq)

    @cached_property
    def _is_plain(self) -> bool:
        """Whether there is Coulomb and viscous friction alone."""
        return not (np.any(self.amplitude) or np.any(self.stribeck))

    @cached_property
    def _orders(self) -> Array:
        return np.arange(1, self.amplitude.shape[1] + 1)

    def begin(self) -> Law:
        return self.__call__


class Frictionless:
    """No friction at all, for checks of the mechanics."""

    def begin(self) -> Law:
        return lambda t, q, dq, load: Friction(*np.zeros((3, *q.shape)))


def stick_slip(
    mass: Array, force: Array, velocity: Array, dt: float, dry: Friction, sign: Array
) -> tuple[Array, Array, Array]:
    """Acceleration and dry friction of one step, with joints at rest held where
    friction can.

    Sticking is exact: a reversal passes through stiction without a regularised sign.
    `mass` (n, n) kg m^2, `force` (n,) N m of everything but dry friction, `velocity`
    (n,) rad/s before the step of `dt` s, levels of `dry` friction, and a first guess of
    the direction of slip after the step, `sign` (n,), 0 where stuck. Returns ddq (n,)
    rad/s^2, the torque of dry friction (n,) N m and the sign (n,).
    """
    stop = -velocity / dt
    if np.count_nonzero(sign) == len(sign):  # most steps: everything slips on
        friction = np.where(sign > 0, dry.forward, -dry.backward)
        _, _, ddq, _ = dgesv(mass, force - friction)
        if min(((velocity + dt * ddq) * sign).tolist()) >= 0:
            return np.asarray(ddq), np.asarray(friction), sign
    for _ in range(12):
        friction = np.where(
            sign > 0, dry.forward, np.where(sign < 0, -dry.backward, 0.0)
        )
        stuck = sign == 0
        matrix, right = mass, force - friction
        if stuck.any():
            matrix = np.where(stuck[:, None], np.eye(len(sign)), mass)
            right = np.where(stuck, stop, right)
        ddq = np.linalg.solve(matrix, right)
        friction = np.where(stuck, force - mass @ ddq, friction)
        after = velocity + dt * ddq
        halted = ~stuck & (after * sign < 0)
        freed = stuck & ((friction > dry.forward) | (friction < -dry.backward))
        if not (halted.any() or freed.any()):
            break
        sign = np.where(halted, 0.0, np.where(freed, np.sign(friction), sign))
    return np.asarray(ddq), np.asarray(friction), sign
