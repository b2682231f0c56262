"""What laws remember: quantities that follow from more than the instant.

Each says how it comes out of a whole log; exported code has the same as a state with
its update (`export.laws`), causal, one sample after the other.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import ClassVar, Literal

import numpy as np
from scipy.ndimage import shift

from seqid_cli.effects.scene import Scene
from seqid_cli.motion.filters.differentiation import differentiate
from seqid_cli.motion.motion import Motion
from seqid_cli.typing import Array

# Share of the past below which it is forgotten. It keeps products out of the denormals,
# with which processors are slow.
NOTHING = 1e-30


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
    """The modelled torque as it was some `seconds` before; negative ones are later."""

    seconds: float
    takes: ClassVar[tuple[str, ...]] = ("tau",)

    def of_scene(
        self, scene: Scene, joint: int, remembered: Mapping[str, Array | float]
    ) -> Array:
        """Return the late torque (N,) of a joint."""
        return self.of_series(scene.modelled[:, [joint]], scene.motion)[:, 0]

    def of_series(self, torque: Array, motion: Motion) -> Array:
        """Return torques (N, k) as they were `seconds` before."""
        return delayed(torque, self.seconds, motion.rate_hz)


@dataclass(frozen=True)
class FrictionSlope:
    """Secant slope of a joint's friction, up to `lead` times `per` more speed."""

    lead: str  # the memory that holds it
    per: float
    takes: ClassVar[tuple[str, ...]] = ("q", "dq", "ddq")

    def of_scene(
        self, scene: Scene, joint: int, remembered: Mapping[str, Array | float]
    ) -> Array:
        """Return the slope (N,) N m s/rad of a joint."""
        added_speed = np.asarray(remembered[self.lead]) * self.per
        return scene.friction_slope(joint, added_speed)


Memory = Bristles | Rate | Late | FrictionSlope


def deflection(q: Array, distance: float) -> Array:
    """Compute the deflection of Dahl's bristles as a share of their largest.

    Parameters
    ----------
    q : Array
        Positions (N,) [rad], taken as monotonic between samples.
    distance : float
        z_max [rad].

    Returns
    -------
    Array
        x (N,) within +-1; the bristles start undeflected.
    """
    travel = np.diff(q, prepend=q[:1]) / distance

    # Each sample maps the deflection before it affinely, x <- keep x + gain. Maps are
    # composed by doubling, in log2(N) sweeps over all samples, so there is no loop over
    # time: after each sweep a map is of `span` samples.
    keep = np.exp(-np.abs(travel))
    gain = -np.sign(travel) * np.expm1(-np.abs(travel))
    span = 1
    while span < len(q):
        gain[span:] += keep[span:] * gain[:-span]
        keep[span:] = keep[span:] * keep[:-span]
        keep[keep < NOTHING] = 0.0
        if not keep[span:].any():
            break
        span *= 2

    # Rounding may carry it a little beyond its largest.
    return np.asarray(np.clip(gain, -1.0, 1.0))


def delayed(values: Array, delay_s: float, rate_hz: float) -> Array:
    """Return values as they were some time before, by cubic splines.

    They are held at the ends.

    Parameters
    ----------
    values : Array
        (N, k).
    delay_s : float
        Negative for values as they will be.
    rate_hz : float
    """
    if not len(values):
        return values.copy()
    samples = delay_s * rate_hz
    return np.asarray(shift(values, (samples, 0.0), order=3, mode="nearest"))
