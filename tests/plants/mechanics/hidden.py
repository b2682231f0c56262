"""What a plant has and its robot file does not say: drives, transmissions, torques,
instruments.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from tests import Array

# (t, q, dq) -> (n,) N m acting on the joints
TorqueSource = Callable[[float, Array, Array], Array]
# (t, torque, drive angle) -> torque, (n,) N m
Stage = Callable[[float, Array, Array], Array]


class Run(NamedTuple):
    """One log: start s since power-on, duration s, control period s,
    seed of all noise.
    """

    start: float
    duration: float
    dt: float
    seed: int


@dataclass(frozen=True)
class Spring:
    """Stiff element between drive and link of one joint; angles at the joint, odd in
    the wind.

    No torque within +-gap/2 (backlash), `stiffness` N m/rad after it; `damping` N m
    s/rad while in contact, which never pulls across a gap.
    """

    joint: int
    stiffness: float
    damping: float
    gap: float = 0.0

    def torque(self, wind: float, rate: float) -> float:
        """Torque on the link, N m, for drive minus link of `wind` rad and
        `rate` rad/s.
        """
        sign = 1.0 if wind >= 0.0 else -1.0
        depth = sign * wind - 0.5 * self.gap
        if depth <= 0.0:
            return 0.0
        push = self.stiffness * depth + self.damping * sign * rate
        return sign * max(push, 0.0) if self.gap > 0.0 else sign * push

    def wind_at(self, torque: float) -> float:
        """Wind, rad, that carries `torque` N m at rest."""
        return float(np.sign(torque)) * (abs(torque) / self.stiffness + 0.5 * self.gap)


@dataclass(frozen=True)
class Hidden:
    """Everything undeclared; the empty one leaves the plant as its robot file says."""

    # on the links, begun anew in each run
    torques: tuple[Callable[[Run], TorqueSource], ...] = ()
    # what the motor makes of the current's torque
    drives: tuple[Callable[[Run], Stage], ...] = ()
    # the drives' angles are what controller and log read
    springs: tuple[Spring, ...] = ()
    # true angle (..., n) rad -> error to add
    encoders: tuple[Callable[[Array], Array], ...] = ()
    # (t (N,) s since power-on, current (N, n) A) -> what the log says of it, (N, n) A
    currents: tuple[Callable[[Array, Array], Array], ...] = ()
    # A (n, n): drive rates = A dq; friction maps back with A^T
    coupling: Array | None = None
