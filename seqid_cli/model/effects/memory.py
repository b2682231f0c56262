"""What laws remember: quantities that follow from more than the instant.

Each says how it comes out of a whole log; exported code has the same as a state with
its update (`export.laws`), causal, one sample after the other.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import ClassVar, Literal

import numpy as np
from scipy.ndimage import shift

from seqid_cli.model.effects.scene import Scene
from seqid_cli.motion.filters.differentiation import differentiate
from seqid_cli.motion.motion import Motion
from seqid_cli.typing import Array

NOTHING = (
    1e-30  # share of the past that is forgotten; keeps products out of the denormals
)


@dataclass(frozen=True)
class Bristles:
    """Deflection of Dahl's bristles as a share of their largest; `distance` rad."""

    distance: float
    takes: ClassVar[tuple[str, ...]] = ("q",)

    def of_scene(
        self, scene: Scene, joint: int, remembered: Mapping[str, Array | float]
    ) -> Array:
        """Return the deflection (N,) of a joint."""
        return deflection(scene.motion.q[:, joint], self.distance)


@dataclass(frozen=True)
class Rate:
    """Derivative over time of the modelled torque or of the load, once or twice."""

    of: Literal["tau", "load"]
    order: int = 1

    @property
    def takes(self) -> tuple[str, ...]:
        """The quantity that is differentiated."""
        return (self.of,)

    def of_scene(
        self, scene: Scene, joint: int, remembered: Mapping[str, Array | float]
    ) -> Array:
        """Return the derivative (N,) at a joint, N m/s or N m/s^2."""
        torque = scene.load if self.of == "load" else scene.modelled
        return self.of_series(torque[:, joint], scene.motion)

    def of_series(self, torque: Array, motion: Motion) -> Array:
        """Return the derivative (N, ...) of torques (N, ...) at a motion's rate."""
        return differentiate(torque, motion.rate_hz, motion.valid)[self.order - 1]


@dataclass(frozen=True)
class Late:
    """The modelled torque as it was some `seconds` before; later, where they are negative."""

    seconds: float
    takes: ClassVar[tuple[str, ...]] = ("tau",)

    def of_scene(
        self, scene: Scene, joint: int, remembered: Mapping[str, Array | float]
    ) -> Array:
        """Return the late torque (N,) of a joint."""
        return self.of_series(scene.modelled[:, [joint]], scene.motion)[:, 0]

    def of_series(self, torque: Array, motion: Motion) -> Array:
        """Return late torques (N, k)."""
        return delayed(torque, self.seconds, motion.rate_hz)


@dataclass(frozen=True)
class FrictionSlope:
    """Secant slope of the joint's own friction, to the speed that `lead` times `per` adds."""

    lead: str  # the memory that holds it
    per: float
    takes: ClassVar[tuple[str, ...]] = ("q", "dq", "ddq")

    def of_scene(
        self, scene: Scene, joint: int, remembered: Mapping[str, Array | float]
    ) -> Array:
        """Return the slope (N,) N m s/rad of a joint."""
        return scene.friction_slope(joint, np.asarray(remembered[self.lead]) * self.per)


Memory = Bristles | Rate | Late | FrictionSlope


def deflection(q: Array, distance: float) -> Array:
    """Deflection (N,) of Dahl's bristles as a share of their largest: within +-1, from 0 on.

    Each sample maps the deflection before it affinely, x <- keep x + gain. Maps are
    composed by doubling, in log2(N) sweeps over all samples, so there is no loop over
    time. Positions q (N,) [rad] are taken as monotonic between samples; `distance` is
    z_max [rad].
    """
    way = np.diff(q, prepend=q[:1]) / distance
    keep = np.exp(-np.abs(way))
    gain = -np.sign(way) * np.expm1(-np.abs(way))
    span = 1
    while span < len(q):
        gain[span:] += keep[span:] * gain[:-span]
        keep[span:] = keep[span:] * keep[:-span]
        keep[keep < NOTHING] = 0.0
        if not keep[span:].any():
            break
        span *= 2
    return np.asarray(np.clip(gain, -1.0, 1.0))  # rounding


def delayed(values: Array, delay_s: float, rate_hz: float) -> Array:
    """Values (N, k) as they were `delay_s` before, held at the ends, by cubic splines."""
    if not len(values):
        return values.copy()
    return np.asarray(shift(values, (delay_s * rate_hz, 0.0), order=3, mode="nearest"))
