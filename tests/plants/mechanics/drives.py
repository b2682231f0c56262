"""Drives and instruments that are not what the robot file says."""

from dataclasses import dataclass

import numpy as np

from tests import Array
from tests.plants.mechanics.hidden import Run, Stage


@dataclass(frozen=True)
class Gain:
    """The motor's torque is (1 + error) times what its current stands for; `error` (n,)."""

    error: Array

    def begin(self, run: Run) -> Stage:
        """Return the stage of one run."""
        factor = 1.0 + self.error

        def stage(t: float, torque: Array, angle: Array) -> Array:
            return np.asarray(factor * torque)

        return stage


@dataclass(frozen=True)
class Saturation:
    """torque (1 - share (torque/rated)^2): `share` (n,) is lost at `rated` (n,) N m.

    The torque stays at its maximum beyond the current where it no longer grows.
    """

    share: Array
    rated: Array

    def begin(self, run: Run) -> Stage:
        """Return the stage of one run."""
        with np.errstate(divide="ignore"):
            top = self.rated / np.sqrt(3.0 * self.share)

        def stage(t: float, torque: Array, angle: Array) -> Array:
            most = np.clip(torque, -top, top)
            return np.asarray(most * (1.0 - self.share * (most / self.rated) ** 2))

        return stage


@dataclass(frozen=True)
class Lag:
    """The motor's torque follows the command with `time` (n,) s, first order."""

    time: Array

    def begin(self, run: Run) -> Stage:
        """Return the stage of one run, from the first command; its mean delay is `time`."""
        share = run.dt / (run.dt + self.time)
        now: Array | None = None

        def stage(t: float, torque: Array, angle: Array) -> Array:
            nonlocal now
            now = torque.copy() if now is None else now + share * (torque - now)
            return now

        return stage


@dataclass(frozen=True)
class Ripple:
    """Adds constant sin(order gear angle + phase) at one joint.

    `angle` is the drive's, at the joint; `constant` N m at the joint, also without current.
    """

    joint: int
    order: float
    gear: float
    phase: float
    constant: float

    def begin(self, run: Run) -> Stage:
        """Return the stage of one run."""
        i, pace = self.joint, self.order * self.gear

        def stage(t: float, torque: Array, angle: Array) -> Array:
            out = torque.copy()
            out[i] += self.constant * np.sin(pace * angle[i] + self.phase)
            return out

        return stage


@dataclass(frozen=True)
class EncoderWave:
    """Eccentric encoder disc of one drive: amplitude sin(order angle + phase), rad at the joint."""

    joint: int
    amplitude: float
    order: float
    phase: float

    def __call__(self, angle: Array) -> Array:
        out = np.zeros_like(angle)
        out[..., self.joint] = self.amplitude * np.sin(
            self.order * angle[..., self.joint] + self.phase
        )
        return out


@dataclass(frozen=True)
class Offset:
    """Adds offset + slope t to the current reading, (n,) A and A/s, t since power-on."""

    offset: Array
    slope: Array

    def read(self, t: Array, current: Array, run: Run) -> Array:
        """Add to current (N, n) A at t (N,) s."""
        return np.asarray(current + self.offset + self.slope * t[:, None])


@dataclass(frozen=True)
class Hum:
    """Adds a line of `frequency` Hz to the current reading, amplitude (n,) A."""

    amplitude: Array
    frequency: float

    def read(self, t: Array, current: Array, run: Run) -> Array:
        """Add to current (N, n) A at t (N,) s; one phase for the whole time since power-on."""
        wave = np.sin(2.0 * np.pi * self.frequency * t + 1.1)
        return np.asarray(current + self.amplitude * wave[:, None])


@dataclass(frozen=True)
class Skew:
    """The current reading is `delay` (n,) s old."""

    delay: Array

    def read(self, t: Array, current: Array, run: Run) -> Array:
        """Shift current (N, n) A at t (N,) s; the ends are held."""
        columns = [np.interp(t - d, t, x) for d, x in zip(self.delay, current.T, strict=True)]
        return np.column_stack(columns)
