"""What a plant has and its robot file does not say: drives, transmissions, torques, instruments."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from tests import Array

TorqueSource = Callable[[float, Array, Array], Array]  # (t, q, dq) -> (n,) N m acting on the joints
Stage = Callable[[float, Array, Array], Array]  # (t, torque, drive angle) -> torque, (n,) N m
EncoderError = Callable[[Array], Array]  # true angle (..., n) rad -> error to add, rad
# (t (N,) s since power-on, current (N, n) A) -> what the log says of it, (N, n) A
CurrentError = Callable[[Array, Array], Array]


class Run(NamedTuple):
    """One log: start s since power-on, duration s, control period s, seed of all noise."""

    start: float
    duration: float
    dt: float
    seed: int


@dataclass(frozen=True)
class Spring:
    """Stiff element between drive and link of one joint; angles at the joint, odd in the wind.

    No torque within +-gap/2 (backlash), `stiffness` N m/rad after it; `damping` N m s/rad while in
    contact, which never pulls across a gap.
    """

    joint: int
    stiffness: float
    damping: float
    gap: float = 0.0

    def torque(self, wind: float, rate: float) -> float:
        """Torque on the link, N m, for drive minus link of `wind` rad and `rate` rad/s."""
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
    """Everything undeclared; the empty one leaves the plant as its robot file says.

    `torques` on the links and `drives`, which turn the torque that the current stands for into the
    one that the motor makes, are begun anew in each run. `encoders` and `currents` falsify what the
    log says.

    `coupling` is A (n, n) in drive rates = A dq; friction acts on them and maps back with A^T.
    `springs` lie between drive and link; controller and log read the drives' angles.
    """

    torques: tuple[Callable[[Run], TorqueSource], ...] = ()
    drives: tuple[Callable[[Run], Stage], ...] = ()
    springs: tuple[Spring, ...] = ()
    encoders: tuple[EncoderError, ...] = ()
    currents: tuple[CurrentError, ...] = ()
    coupling: Array | None = None
