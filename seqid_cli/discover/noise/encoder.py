"""What the encoder's noise makes of a residual where the model is right.

The positions of a log, low-passed at a little more than its cut-off, are taken as the truth: at the
cut-off itself the next choice of a cut-off would come out lower. Their torque is the model's,
friction with a direction of motion that flips within one sample, and what the refitted base adds.
The encoder's noise is drawn anew on them, and what comes back is predicted from it.

Where a joint does not certainly slide its torque is the measured one. Such samples do not count;
but how long a joint sticks when it turns back reaches others through the low-pass. A push is not
kept even there.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from scipy.interpolate import CubicSpline
from scipy.ndimage import binary_erosion, uniform_filter1d

from seqid_cli.discover.noise.spectra import nearest
from seqid_cli.logs.recording import Recording
from seqid_cli.model.effects.scene import Scene
from seqid_cli.model.friction import FrictionSurface
from seqid_cli.model.friction_samples import sampled_friction
from seqid_cli.motion.filters.bandwidth import encoder_step
from seqid_cli.motion.filters.butterworth import Lowpass
from seqid_cli.motion.filters.differentiation import differentiate
from seqid_cli.typing import Array, Mask

SHARP = 1e-9  # width of the sign [rad/s]
SLOWEST = 1e-6  # rad/s, at which the friction of a direction is evaluated at least
SHARPENINGS = 4  # times that the low-pass of the deviation is partly undone
BEYOND = 1.5  # of the cut-off, up to which positions are believed
SEED = 0
RAMP = 0.12  # periods of the cut-off, half the length of a ramp from measured to modelled torque


def encoder_residuals(
    recordings: Sequence[Recording],
    scenes: Sequence[Scene],
    deviation: Sequence[Array] | None = None,
    events: Sequence[Mask] | None = None,
) -> list[Array]:
    """Residuals (N, n) N m that a right model has where only the encoder is noisy, drawn once.

    Parameters
    ----------
    recordings : sequence of Recording
        With torque.
    `scenes` : sequence of `Scene`
        Of the same logs, with the model that is to be right.
    deviation : sequence of (N, n) arrays, optional
        Low-passed torque [N m] that the refitted base adds to the model.
    events : sequence of (N,) masks, optional
        Samples of the data set at which something else acts on the arm.
    """
    added = deviation or [np.zeros_like(scene.motion.q) for scene in scenes]
    apart = events or [np.zeros(scene.samples, dtype=bool) for scene in scenes]
    given = zip(recordings, scenes, added, apart, strict=True)
    return [Noiseless(*one).residual for one in given]


@dataclass(frozen=True)
class Noiseless:
    """One log as it would be without noise; arguments as those of `encoder_residuals`."""

    recording: Recording
    scene: Scene
    deviation: Array
    event: Mask

    def read(self, rng: np.random.Generator) -> Array:
        """Positions (N, n) as the encoder would have reported them."""
        step, white = self._encoder
        q = self.position + white * rng.standard_normal(self.position.shape)
        phase = rng.random(len(step))
        unit = np.where(step > 0, step, 1.0)
        counted = (np.round(q / unit + phase) - phase) * unit
        return np.where(step > 0, counted, q)

    @cached_property
    def _encoder(self) -> tuple[Array, Array]:
        """Step (n,) rad and white noise (n,) rad that the step does not explain."""
        step = encoder_step(self.recording.q)
        power = 0.5 * self.scene.motion.cutoff.noise_density * self.recording.rate_hz
        rest = power - step**2 / 12.0
        # The quantisation of a slow joint is tones; no more than its own size counts as that.
        return step, np.sqrt(np.where(rest > step**2 / 12.0, rest, 0.0))

    @cached_property
    def residual(self) -> Array:
        """Residual (M, n) N m with the encoder's noise drawn once, and no torque noise."""
        motion, recording, model = self.scene.motion, self.recording, self.scene.model
        factor, valid = round(recording.rate_hz / motion.rate_hz), recording.valid
        lowpass = Lowpass(motion.lowpass.cutoff_hz, recording.rate_hz)
        tau = lowpass(lowpass(self.torque, valid), valid)[::factor]
        angle = lowpass(self.read(np.random.default_rng(SEED)), valid)
        seen = (angle, *differentiate(angle, recording.rate_hz, valid))
        q, dq, ddq = (values[::factor] for values in seen)
        rigid = model.rigid(q, dq, ddq) if motion.source == "encoder" else self.scene.rigid
        friction = sampled_friction(model.surfaces, replace(motion, q=q, dq=dq))
        friction = motion.filtered(friction, times=2)
        residual: Array = tau - motion.filtered(rigid) - friction - self.deviation
        return residual

    @cached_property
    def position(self) -> Array:
        """True positions (N, n) rad."""
        recording = self.recording
        cutoff = BEYOND * self.scene.motion.lowpass.cutoff_hz
        return Lowpass(cutoff, recording.rate_hz)(recording.q, recording.valid)

    @cached_property
    def _derivatives(self) -> tuple[Array, Array]:
        return differentiate(self.position, self.recording.rate_hz, self.recording.valid)

    @cached_property
    def resting(self) -> Array:
        """1 where torque stays as measured, 0 where the model makes it, (N, n).

        The ramps between them, straight, lie in what does not count.
        """
        motion, rate = self.scene.motion, self.recording.rate_hz
        away = ~(self.scene.slides | self.event[:, None])
        reach = max(1, round(RAMP * rate / motion.lowpass.cutoff_hz))
        size = (2 * reach + 1, 1)
        inner = binary_erosion(
            nearest(away, len(self.recording.t)), np.ones(size, dtype=bool), border_value=1
        )
        return uniform_filter1d(inner.astype(np.float64), size[0], axis=0, mode="nearest")

    @cached_property
    def torque(self) -> Array:
        """Torque (N, n) N m without noise; the measured one, noise included, at rest."""
        assert self.recording.tau is not None
        modelled = self.at_log(self._rigid + self._sharpened()) + self.friction
        return modelled + self.resting * (self.recording.tau - modelled)

    @property
    def _rigid(self) -> Array:
        """Rigid-body torque (M, n) at the data set's samples; IMUs' accelerations if any."""
        motion = self.scene.motion
        if motion.source != "encoder":
            return self.scene.rigid
        factor = round(self.recording.rate_hz / motion.rate_hz)
        q, dq, ddq = (values[::factor] for values in (self.position, *self._derivatives))
        return self.scene.model.rigid(q, dq, ddq)

    @cached_property
    def friction(self) -> Array:
        """Friction torque (N, n) N m of a direction of motion that flips within one sample."""
        ahead, back = self._friction_of_directions()
        moving = nearest(self.scene.motion.moving, len(self.recording.t))
        forward = _held(self._derivatives[0] > 0, moving)
        return np.where(forward, self.at_log(ahead), self.at_log(back))

    def _friction_of_directions(self) -> tuple[Array, Array]:
        """Friction (M, n) at the data set's positions and speeds, forward and backward."""
        motion, surfaces = self.scene.motion, self.scene.model.surfaces
        ahead, back = np.zeros(motion.q.shape), np.zeros(motion.q.shape)
        for j, surface in enumerate(surfaces):
            if surface is not None:
                speed = np.maximum(np.abs(motion.dq[:, j]), SLOWEST)
                ahead[:, j], back[:, j] = _both_ways(surface, motion.q[:, j], speed)
        return ahead, back

    def _sharpened(self) -> Array:
        """The deviation (M, n), its low-pass undone as far as it carries (Van Cittert)."""
        motion = self.scene.motion
        result = self.deviation
        if not np.any(result):
            return result
        for _ in range(SHARPENINGS):
            result = result + self.deviation - motion.filtered(result, times=2)
        return result

    def at_log(self, values: Array) -> Array:
        """Values (M, n) at the data set's samples, at the log's own (N, n)."""
        if len(values) == len(self.recording.t):
            return values
        t, own = self.recording.t, self.scene.motion.t
        # Past the last sample there is less than one of its intervals.
        return np.asarray(CubicSpline(own, values)(np.minimum(t, own[-1])))


def _both_ways(surface: FrictionSurface, q: Array, speed: Array) -> tuple[Array, Array]:
    sharp = replace(surface, sign_width=SHARP)
    return sharp.torque(q, speed), sharp.torque(q, -speed)


def _held(forward: Mask, moving: Mask) -> Mask:
    """Direction (N, n) of motion, taken from the nearest moving sample where a joint stands."""
    result = forward.copy()
    at = np.arange(len(forward))
    for j in range(forward.shape[1]):
        there = np.flatnonzero(moving[:, j])
        if 0 < len(there) < len(at):
            after = np.clip(np.searchsorted(there, at), 0, len(there) - 1)
            before = np.maximum(after - 1, 0)
            closer = np.abs(there[before] - at) <= np.abs(there[after] - at)
            result[:, j] = forward[np.where(closer, there[before], there[after]), j]
    return result
