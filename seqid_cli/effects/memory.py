"""What laws remember: quantities that follow from more than the instant.

Each says how it comes out of a whole log; exported code has the same as a state with
its update (`export.laws`), causal, one sample after the other.
"""

import abc
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import ClassVar, Literal

import numpy as np

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
class Rope:
    """State of a rope or hose that rubs, as a share of its largest.

    `distance` rad is the way over which it settles, `sharpness` the exponent n of
    Bouc and Wen, 0 for Dahl's law.
    """

    distance: float
    sharpness: int
    takes: ClassVar[tuple[str, ...]] = ("q",)

    def of_scene(
        self, scene: Scene, joint: int, remembered: Mapping[str, Array | float]
    ) -> Array:
        """Return the state (N,) of a joint."""
        q = scene.motion.q[:, joint]
        if self.sharpness == 0:
            return deflection(q, self.distance)
        return wound(q, self.distance, self.sharpness)


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


class _OfTorque(abc.ABC):
    """What follows from the modelled torque of a joint over time."""

    takes: ClassVar[tuple[str, ...]] = ("tau",)

    def of_scene(
        self, scene: Scene, joint: int, remembered: Mapping[str, Array | float]
    ) -> Array:
        """Return what is remembered (N,) of a joint."""
        return self.of_series(scene.modelled[:, [joint]], scene.motion)[:, 0]

    @abc.abstractmethod
    def of_series(self, torque: Array, motion: Motion) -> Array:
        """Return what is remembered (N, k) of torques (N, k) at a motion's rate."""


@dataclass(frozen=True)
class Late(_OfTorque):
    """The modelled torque as it was some `seconds` before; negative ones are later."""

    seconds: float

    def of_series(self, torque: Array, motion: Motion) -> Array:
        """Return torques (N, k) as they were `seconds` before."""
        return delayed(torque, self.seconds, motion.rate_hz)


@dataclass(frozen=True)
class AsLogged:
    """The modelled torque as late as the parameter file says that it is logged."""

    takes: ClassVar[tuple[str, ...]] = ("tau",)

    def of_scene(
        self, scene: Scene, joint: int, remembered: Mapping[str, Array | float]
    ) -> Array:
        """Return the late torque (N,) of a joint."""
        return self.of_joints(scene.modelled[:, [joint]], scene, [joint])[:, 0]

    def of_joints(self, torque: Array, scene: Scene, joints: Sequence[int]) -> Array:
        """Return torques (N, k) of k joints, each as late as its own is logged."""
        late = torque.copy()
        delays_s = scene.model.delays_s
        if delays_s is None:
            return late
        for k, joint in enumerate(joints):
            if delays_s[joint] != 0.0:
                late[:, [k]] = delayed(
                    torque[:, [k]], float(delays_s[joint]), scene.motion.rate_hz
                )
        return late

    def kept(
        self, torque: Array, name: str, scene: Scene, joints: Sequence[int]
    ) -> Array:
        """Return late torques (N, k) of k joints, which the scene keeps by their name.

        Settings of an effect make no difference to them.
        """
        late = []
        for k, joint in enumerate(joints):
            key = (f"{name} torque as logged", joint)
            if key not in scene.memo:
                scene.memo[key] = (self.of_joints(torque[:, [k]], scene, [joint]),)
            late.append(scene.memo[key][0])
        return np.hstack(late)


@dataclass(frozen=True)
class Averaged(_OfTorque):
    """Mean of the modelled torque over the last `seconds`."""

    seconds: float

    def of_series(self, torque: Array, motion: Motion) -> Array:
        """Return the running mean of torques (N, k)."""
        return averaged(torque, self.seconds, motion.rate_hz)


@dataclass(frozen=True)
class Lagged(_OfTorque):
    """The modelled torque after a first-order low-pass of time constant `seconds`."""

    seconds: float

    def of_series(self, torque: Array, motion: Motion) -> Array:
        """Return low-passed torques (N, k)."""
        return lagged(torque, self.seconds, motion.rate_hz)


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


Memory = Bristles | Rope | Rate | Late | AsLogged | Averaged | Lagged | FrictionSlope
# Memories that follow from one joint's torque over time alone.
OfSeries = Rate | Late | Averaged | Lagged


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
    from scipy.ndimage import shift

    samples = delay_s * rate_hz
    return np.asarray(shift(values, (samples, 0.0), order=3, mode="nearest"))


def wound(q: Array, distance: float, sharpness: int) -> Array:
    """Compute the state of Bouc and Wen's law as a share of its largest.

    Parameters
    ----------
    q : Array
        Positions (N,) [rad], taken as monotonic between samples.
    distance : float
        x_0 [rad].
    sharpness : int
        n, 1 or 2.

    Returns
    -------
    Array
        z (N,) within +-1, from 0 on.
    """
    ways = np.diff(q, prepend=q[:1]) / distance
    directions = np.sign(ways)

    # Along a way in one direction the law has a closed form: only turns are a loop.
    moves = np.flatnonzero(directions)
    state = np.zeros(len(q))
    if not len(moves):
        return state
    turns = np.flatnonzero(np.diff(directions[moves])) + 1
    firsts = moves[np.concatenate([[0], turns])]
    ends = np.concatenate([firsts[1:], [len(q)]])
    reached = 0.0
    for first, end in zip(firsts, ends, strict=True):
        gone = np.cumsum(np.abs(ways[first:end]))
        ahead = advanced(directions[first] * reached, gone, sharpness)
        state[first:end] = directions[first] * ahead
        reached = float(state[end - 1])
    return state


def advanced(start: float, way: Array, sharpness: int) -> Array:
    """Return where a state is after ways in its own positive direction.

    It unwinds along a straight line, and winds up towards 1 by

        dz = (1 - z^n) dx.

    Parameters
    ----------
    start : float
        State before, within +-1.
    way : Array
        (N,) ways over x_0, not negative.
    sharpness : int
        n, 1 or 2.
    """
    # What is left of the way once the state has come to 0 from below.
    beyond = way + min(start, 0.0)
    unwound = np.maximum(beyond, 0.0)
    above = max(start, 0.0)
    if sharpness == 1:
        wound_up = 1.0 - (1.0 - above) * np.exp(-unwound)
    else:
        # tanh(a + b) by tanh(a) and tanh(b): `above` may be 1.
        gained = np.tanh(unwound)
        wound_up = (above + gained) / (1.0 + above * gained)
    return np.asarray(np.where(beyond < 0.0, beyond, wound_up))


def averaged(values: Array, seconds: float, rate_hz: float) -> Array:
    """Return the mean of values over some time before; they are held at the start.

    Parameters
    ----------
    values : Array
        (N, k), joined by straight lines.
    seconds : float
        Length of the window, above 0.
    rate_hz : float
    """
    if not len(values):
        return values.copy()
    window = seconds * rate_hz
    n_before = int(np.ceil(window)) + 1
    held = np.concatenate([np.repeat(values[:1], n_before, axis=0), values])
    steps = 0.5 * (held[1:] + held[:-1])
    integral = np.concatenate([np.zeros_like(held[:1]), np.cumsum(steps, axis=0)])

    # The window begins between two samples: its part of that interval is exact.
    begin = np.arange(len(values)) + n_before - window
    sample = np.floor(begin).astype(int)
    part = (begin - sample)[:, None]
    slope = held[sample + 1] - held[sample]
    up_to_begin = integral[sample] + part * (held[sample] + 0.5 * part * slope)
    return np.asarray((integral[n_before:] - up_to_begin) / window)


def lagged(values: Array, time_constant_s: float, rate_hz: float) -> Array:
    """Return values after a first-order low-pass, settled at the start.

    Parameters
    ----------
    values : Array
        (N, k), joined by straight lines.
    time_constant_s : float
        Above 0.
    rate_hz : float
    """
    if not len(values):
        return values.copy()
    from scipy.linalg.lapack import dtbtrs

    decay = float(np.exp(-1.0 / (rate_hz * time_constant_s)))
    ramp = rate_hz * time_constant_s * (1.0 - decay)

    # low[k] - decay low[k - 1] is what came in: solved from the first row on.
    came_in = (1.0 - ramp) * values
    came_in[1:] += (ramp - decay) * values[:-1]
    came_in[0] += ramp * values[0]
    bands = np.ones((2, len(values)))
    bands[1] = -decay
    low, _ = dtbtrs(bands, came_in, uplo="L", diag="U")
    return np.asarray(low)
