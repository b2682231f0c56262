"""What a plant has and its robot file does not say: drives, transmissions, torques, instruments."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import NamedTuple, Protocol

import numpy as np

from tests import Array

TorqueSource = Callable[[float, Array, Array], Array]  # (t, q, dq) -> (n,) N m acting on the joints
Stage = Callable[[float, Array, Array], Array]  # (t, torque, drive angle) -> torque, (n,) N m
EncoderError = Callable[[Array], Array]  # true angle (..., n) rad -> error to add, rad


class Run(NamedTuple):
    """One log: start s since power-on, duration s, control period s, seed of all noise."""

    start: float
    duration: float
    dt: float
    seed: int


class TorqueModel(Protocol):
    """A torque on the links with fresh internal state for one run."""

    def begin(self, run: Run) -> TorqueSource:
        """Return the source of one run."""
        ...


class DriveStage(Protocol):
    """Turns the torque that the current stands for into the one that the motor makes."""

    def begin(self, run: Run) -> Stage:
        """Return the stage of one run."""
        ...


class CurrentError(Protocol):
    """Falsifies the current reading."""

    def read(self, t: Array, current: Array, run: Run) -> Array:
        """Turn current (N, n) A at t (N,) s since power-on into what the log says."""
        ...


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

    `coupling` is A (n, n) in drive rates = A dq; friction acts on them and maps back with A^T.
    `springs` lie between drive and link; controller and log read the drives' angles.
    """

    torques: tuple[TorqueModel, ...] = ()
    drives: tuple[DriveStage, ...] = ()
    springs: tuple[Spring, ...] = ()
    encoders: tuple[EncoderError, ...] = ()
    currents: tuple[CurrentError, ...] = ()
    coupling: Array | None = None

    def with_torque(self, model: TorqueModel) -> Hidden:
        """Add a torque on the links."""
        return replace(self, torques=(*self.torques, model))

    def with_drive(self, stage: DriveStage) -> Hidden:
        """Add a stage of the drives."""
        return replace(self, drives=(*self.drives, stage))

    def with_spring(self, spring: Spring) -> Hidden:
        """Put a spring into a joint."""
        return replace(self, springs=(*self.springs, spring))

    def with_encoder(self, error: EncoderError) -> Hidden:
        """Add an error of the encoders."""
        return replace(self, encoders=(*self.encoders, error))

    def with_current(self, error: CurrentError) -> Hidden:
        """Add an error of the current reading."""
        return replace(self, currents=(*self.currents, error))
