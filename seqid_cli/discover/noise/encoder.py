"""What the encoder's noise makes of a residual where the model is right.

The positions of a log, low-passed at a little more than its cut-off, are taken as the truth. Their
torque is the model's, with friction that flips within one sample. The encoder's noise is drawn anew
on them, and what comes back is predicted from it.
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from seqid_cli.logs.recording import Recording
from seqid_cli.model.effects.scene import Scene
from seqid_cli.model.torque import sampled_friction
from seqid_cli.motion.filters.bandwidth import encoder_step
from seqid_cli.motion.filters.butterworth import Lowpass
from seqid_cli.motion.filters.differentiation import differentiate
from seqid_cli.typing import Array

BEYOND = 1.5  # of the cut-off, up to which positions are believed
SHARP = 1e-9  # width of the sign [rad/s]
SEED = 0


def encoder_residuals(recordings: Sequence[Recording], scenes: Sequence[Scene]) -> list[Array]:
    """Residuals (N, n) N m that a right model has where only the encoder is noisy, drawn once."""
    rng = np.random.default_rng(SEED)
    return [_drawn(log, scene, rng) for log, scene in zip(recordings, scenes, strict=True)]


def _drawn(recording: Recording, scene: Scene, rng: np.random.Generator) -> Array:
    motion, rate, valid = scene.motion, recording.rate_hz, recording.valid
    lowpass, every = Lowpass(motion.lowpass.cutoff_hz, rate), round(rate / motion.rate_hz)
    truth = Lowpass(BEYOND * motion.lowpass.cutoff_hz, rate)(recording.q, valid)
    step, density = encoder_step(recording.q), motion.cutoff.noise_density
    read = encoder_readings(truth, step, density, rate, rng)

    def seen(angle: Array) -> tuple[Array, ...]:
        """Motion as it is estimated from such readings."""
        low = lowpass(angle, valid)
        return tuple(x[::every] for x in (low, *differentiate(low, rate, valid)))

    q, dq, _ = seen(read)
    friction = sampled_friction(scene.model.surfaces, replace(motion, q=q, dq=dq))
    rigid = scene.model.rigid(*seen(read if motion.source == "encoder" else truth))
    sharp = [s and replace(s, sign_width=SHARP) for s in scene.model.surfaces]
    v, a = differentiate(truth, rate, valid)
    torque = scene.model.rigid(truth, v, a)
    torque += replace(scene.model, surfaces=sharp).friction(truth, v)
    right = lowpass(lowpass(torque, valid), valid)[::every]
    residual: Array = right - motion.filtered(rigid) - motion.filtered(friction, times=2)
    return residual


def encoder_readings(
    q: Array, step: Array, density: Array, rate_hz: float, rng: np.random.Generator
) -> Array:
    """Positions (N, n) as an encoder reports them, with white noise of density (n,) rad^2 / Hz."""
    power, counting = 0.5 * density * rate_hz, step**2 / 12.0
    # The quantisation of a slow joint is tones; no more than its own size counts as white noise.
    white = np.sqrt(np.where(power > 2.0 * counting, power - counting, 0.0))
    q = q + white * rng.standard_normal(q.shape)
    unit, phase = np.where(step > 0, step, 1.0), rng.random(len(step))
    return np.where(step > 0, (np.round(q / unit + phase) - phase) * unit, q)
