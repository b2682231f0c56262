"""The robot's own position controller: an observer on the encoder, PD, a nominal
feedforward.
"""

from dataclasses import dataclass

import numpy as np

from tests import Array
from tests.plants.mechanics.rigid import Rigid
from tests.plants.motions.trajectories import Reference


@dataclass(frozen=True)
class Gains:
    """Per joint, (n,): stiffness N m/rad, damping N m s/rad,
    observer bandwidth rad/s.
    """

    stiffness: Array
    damping: Array
    observer: Array


def gains_for(inertia: Array, *, bandwidth: float, observer: float) -> Gains:
    """Critically damped PD of `bandwidth` rad/s on the given inertias (n,) kg m^2."""
    damping = 2.0 * inertia * bandwidth
    return Gains(inertia * bandwidth**2, damping, np.full_like(inertia, observer))


def feedforward(nominal: Rigid, reference: Reference, coulomb: Array) -> Array:
    """Nominal torque of the reference, (N, n) N m."""
    states = zip(reference.q, reference.dq, reference.ddq, strict=True)
    rigid = np.array([nominal.inverse(q, dq, ddq) for q, dq, ddq in states])
    return np.asarray(rigid + coulomb * np.sign(reference.dq))


class Controller:
    """Torque command from the encoder, one call per control period."""

    def __init__(self, gains: Gains, dt: float) -> None:
        self._gains, self._dt = gains, dt
        self._by_rate, self._by_change = 2.0 * gains.observer, dt * gains.observer**2
        self._error, self._rate = (np.zeros_like(gains.stiffness) for _ in range(2))

    def torque(self, encoder: Array, wanted: Array, ahead: Array) -> Array:
        """Command from encoder and reference, rad, and feedforward, N m."""
        gains = self._gains
        surprise = encoder - wanted - self._error
        self._error = self._error + self._dt * (self._rate + self._by_rate * surprise)
        self._rate = self._rate + self._by_change * surprise
        return ahead - gains.stiffness * self._error - gains.damping * self._rate
