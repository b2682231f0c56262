"""How small the residual could become: noise in the band, that no model explains.

It is torque noise and what the encoder's noise makes of the motion. For the latter the
positions of a log, low-passed at a little more than its cut-off, are taken as the
truth. Their torque is the model's, with friction that flips within one sample. The
encoder's noise is drawn anew on them, and what comes back is predicted from it. Torque
noise is a property of a joint's drive, white and 1/f^a, looked for in all logs together
(see `spectra`); how much of it passes a log's low-pass depends on the log. It shows in

rests
    in which all joints stand for several periods of the cut-off: the raw torque;
motion
    while the joint slides: the raw torque above the cut-off, and what is left of the
    torque at the top of the band, where there is no motion.

Without rests, what colour the noise has below the top of the band stays open: the
interval reaches up to what noise of any shape would have there that is as large at the
top, or to all that is left where this is less. The estimate is one of its own: what a
model leaves of the torque does not bound it. Rests whose interval lies above all that
is left are refuted.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from seqid_cli.discover.survey.rows import Rows
from seqid_cli.logs.recording import Recording
from seqid_cli.model.effects.scene import Scene
from seqid_cli.model.torque import sampled_friction
from seqid_cli.motion.filters.bandwidth import encoder_step
from seqid_cli.motion.filters.butterworth import Lowpass
from seqid_cli.motion.filters.differentiation import differentiate, runs, shrink
from seqid_cli.motion.motion import encoder_resolution
from seqid_cli.motion.segmentation import unmoved
from seqid_cli.motion.torque_noise import (
    Slid,
    Spectrum,
    level_of,
    power_gain,
    stretches,
)
from seqid_cli.robot.types import Joint
from seqid_cli.typing import Array

BEYOND = 1.5  # of the cut-off, up to which positions are believed
SHARP = 1e-9  # width of the sign [rad/s]
SEED = 0
# periods of the cut-off: of a rest, at least, and per spectrum while joints move
STRETCH = 4.0
# of the residual's power that stays noise, whatever the encoder explains
LEAST_SHARE = 0.1
UNKNOWN = np.array([0.0, 0.0, 0.0, np.inf])
# a deviate's middle, ends of its interval, most
NORMAL_95 = np.array([0.0, -1.96, 1.96, 1.96])


@dataclass(frozen=True)
class NoiseFloor:
    """RMS (n,) N m that a right model leaves, and its 95 % interval `low`, `high` (n,).

    Of what spectra leave open, noise of logs so short scatters, and the encoder's part
    is unsure.
    """

    rms: Array
    low: Array
    high: Array

    def with_detail(self, detail: Array) -> "NoiseFloor":
        """The same where a right model may leave a detail, RMS (n,) N m, beside the noise."""
        return replace(self, high=np.hypot(self.high, detail))

    def interval(self, joint: int) -> tuple[float, float]:
        """95 % interval of one joint's floor, N m."""
        return float(self.low[joint]), float(self.high[joint])

    def doubts(self, left: Array, joints: Sequence[Joint]) -> tuple[str, ...]:
        """Joints at which a model leaves less, RMS (n,) N m, than the interval's lower end."""
        return tuple(
            f"joint {joint.name}: {rest:.3g} {joint.unit('N m')} is left, less than the"
            f" noise floor's interval, {low:.3g} to {high:.3g} {joint.unit('N m')}: the"
            " floor's estimate is doubtful there; a log with rests of several seconds"
            " gives a better one"
            for joint, rest, low, high in zip(
                joints, left, self.low, self.high, strict=True
            )
            if rest < low
        )


def noise_floor(
    recordings: Sequence[Recording],
    scenes: Sequence[Scene],
    residual: Sequence[Array],
    echo: Sequence[Array],
    *,
    rows: Rows | None = None,
    judged: int | None = None,
    encoder_error: float = 0.25,
) -> NoiseFloor:
    """Find the noise floor of every joint where it slides; an estimate of its own.

    `residual`, `echo` (N, n) N m per log, at the samples of its data set: what is left
    after all that was found has been taken out, zero where it does not count; the part
    of it that the encoder's noise makes (see `encoder_residuals`), known to a relative
    standard error of `encoder_error`. The floor is of `rows`, by default of all samples
    at which a joint slides, and of the first `judged` logs, by default of all: the
    others only help to find the noise.
    """
    logs = list(zip(recordings, scenes, residual, echo, strict=True))
    rests = [_rests(recording, scene) for recording, scene, *_ in logs]
    reference_hz, found = scenes[0].motion.lowpass.cutoff_hz, []
    for j in range(scenes[0].robot.n):
        of = [(scene, scene.slides[:, j]) for scene in scenes[:judged]]
        slid = [(x.motion, float(m.sum()) / x.motion.rate_hz) for x, m in of if m.any()]
        slides = [
            [x[m, j] for x, (_, m) in zip(v, of, strict=False)]
            for v in (echo, residual)
        ]
        heard, left = (rms(own[own != 0.0]) for own in map(np.concatenate, slides))
        heard = heard if rows is None else rms(rows.torque(j, [e[:, j] for e in echo]))
        encoder = heard * np.exp(encoder_error * NORMAL_95)
        still = [
            Spectrum.of(log.tau[:, j], *at, log.rate_hz, robust=False).at_least(
                _rounding(log, j)
            )
            for log, at in zip(recordings, rests, strict=True)
            if at[0] and log.tau is not None
        ]
        moving = [_above(log, scene, j) for log, scene, *_ in logs]
        moving += [_top_of_band(log, x, r[:, j], e[:, j], j) for log, x, r, e in logs]
        floor = np.hypot(_noise([*still, *moving], slid, reference_hz), encoder)
        # Of noise no more can be there than is left of the torque in all.
        refuted = bool(still) and floor[1] > left
        if refuted:
            floor = np.hypot(_noise(moving, slid, reference_hz), encoder)
        if refuted or not still:
            floor[2] = max(floor[2], min(left, floor[3]))
        found.append(floor[:3])
    return NoiseFloor(*np.array(found).T)


def rms(values: Array) -> float:
    """Root of the mean square; zero of nothing."""
    return float(np.sqrt(np.mean(values**2))) if len(values) else 0.0


def _noise(spectra: Sequence[Spectrum], slid: Slid, reference_hz: float) -> Array:
    """RMS of low-passed torque noise, ends of its interval, the most (4,), N m; 0 if unknown."""
    shown = [one for one in spectra if len(one.frequency)]
    return level_of(shown, reference_hz).rms(slid) if shown and slid else UNKNOWN


def _rests(recording: Recording, scene: Scene) -> tuple[list[int], int]:
    """First samples, and length, of pieces in which all joints stand, a period from moves."""
    period = recording.rate_hz / scene.motion.lowpass.cutoff_hz
    still = unmoved(
        recording.q, encoder_resolution(scene.robot), round(STRETCH * period)
    )
    quiet = shrink(still & recording.valid, round(period))
    lengths = [b - a for a, b in runs(quiet, len(quiet)) if b - a >= STRETCH * period]
    length = int(np.median(lengths or [0]))
    return stretches(quiet, length) if length else [], length


def _above(
    recording: Recording,
    scene: Scene,
    joint: int,
    *,
    above: float = 1.5,
    up_to: float = 10.0,
) -> Spectrum:
    """The raw torque above the cut-off where the joint slides; if never for long, of all."""
    assert recording.tau is not None
    rate, cutoff, samples = (
        recording.rate_hz,
        scene.motion.lowpass.cutoff_hz,
        len(recording.t),
    )
    length = min(round(STRETCH * rate / cutoff), samples)
    nearest = np.linspace(0, scene.samples - 1, samples).round().astype(int)
    slides = scene.slides[nearest, joint] & recording.valid
    starts = stretches(slides, length) or stretches(recording.valid, length)
    whole = Spectrum.of(recording.tau[:, joint], starts, length, rate, robust=True)
    return whole.within(above * cutoff, up_to * cutoff).at_least(
        _rounding(recording, joint)
    )


def _top_of_band(
    recording: Recording,
    scene: Scene,
    residual: Array,
    echo: Array,
    joint: int,
    *,
    band: tuple[float, float] = (0.45, 0.95),
) -> Spectrum:
    """What is left (N,) of the torque at the top of the band, the low-pass undone.

    Steps of the torque, which reach above the cut-off, the model has below it. What the
    encoder's noise makes (N,) is taken off. Between the cut-offs `band` nothing moves.
    """
    lowpass, rate = scene.motion.lowpass, scene.motion.rate_hz
    length = min(round(STRETCH * rate / lowpass.cutoff_hz), scene.samples)
    starts = stretches(scene.slides[:, joint] & (residual != 0.0), length)
    limits = (
        [edge * lowpass.cutoff_hz for edge in band] if lowpass.active else [0.0, 0.0]
    )
    spectra = (
        Spectrum.of(x, starts, length, rate, robust=True) for x in (residual, echo)
    )
    whole, heard = (spectrum.within(*limits) for spectrum in spectra)
    density = np.maximum(whole.density - heard.density, LEAST_SHARE * whole.density)
    raw = replace(whole, density=density / power_gain(lowpass, whole.frequency, 2))
    return raw.at_least(_rounding(recording, joint))


def _rounding(recording: Recording, joint: int) -> float:
    """Density of the noise that rounding the torque makes."""
    assert recording.tau is not None
    return float(
        encoder_step(recording.tau[:, [joint]])[0] ** 2 / 12.0 / recording.rate_hz
    )


def encoder_residuals(
    recordings: Sequence[Recording], scenes: Sequence[Scene]
) -> list[Array]:
    """Residuals (N, n) N m that a right model has where only the encoder is noisy, drawn once."""
    rng = np.random.default_rng(SEED)
    return [
        _drawn(log, scene, rng) for log, scene in zip(recordings, scenes, strict=True)
    ]


def _drawn(recording: Recording, scene: Scene, rng: np.random.Generator) -> Array:
    motion, rate, valid = scene.motion, recording.rate_hz, recording.valid
    lowpass, every = (
        Lowpass(motion.lowpass.cutoff_hz, rate),
        round(rate / motion.rate_hz),
    )
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
    return np.asarray(
        right - motion.filtered(rigid) - motion.filtered(friction, times=2)
    )


def encoder_readings(
    q: Array, step: Array, density: Array, rate_hz: float, rng: np.random.Generator
) -> Array:
    """Positions (N, n) as an encoder reports them, with white noise of density (n,) rad^2 / Hz."""
    power, counting = 0.5 * density * rate_hz, step**2 / 12.0
    # The quantisation of a slow joint is tones; no more than its own size counts as
    # white noise.
    white = np.sqrt(np.where(power > 2.0 * counting, power - counting, 0.0))
    q = q + white * rng.standard_normal(q.shape)
    unit, phase = np.where(step > 0, step, 1.0), rng.random(len(step))
    return np.where(step > 0, (np.round(q / unit + phase) - phase) * unit, q)
