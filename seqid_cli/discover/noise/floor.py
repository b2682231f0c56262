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
from seqid_cli.effects.scene import Scene
from seqid_cli.logs.recording import Recording
from seqid_cli.model.torque import sampled_friction
from seqid_cli.motion.filters.bandwidth import encoder_step
from seqid_cli.motion.filters.butterworth import Lowpass
from seqid_cli.motion.filters.differentiation import differentiate, runs, shrink
from seqid_cli.motion.motion import Motion, encoder_resolution
from seqid_cli.motion.segmentation import unmoved
from seqid_cli.motion.torque_noise import (
    Slid,
    Spectrum,
    level_of,
    power_gain,
    stretches,
)
from seqid_cli.robot.types import Joint
from seqid_cli.robust import rms
from seqid_cli.typing import Array

BEYOND = 1.5  # of the cut-off, up to which positions are believed
SHARP = 1e-9  # width of the sign [rad/s]
SEED = 0
# periods of the cut-off: of a rest, at least, and per spectrum while joints move
STRETCH = 4.0
# of the residual's power that stays noise, whatever the encoder explains
LEAST_SHARE = 0.1
# RMS, ends of its interval and the most, where no spectrum shows any noise
UNKNOWN = np.array([0.0, 0.0, 0.0, np.inf])
# a deviate's middle, ends of its interval, most
NORMAL_95 = np.array([0.0, -1.96, 1.96, 1.96])


@dataclass(frozen=True)
class NoiseFloor:
    """RMS torque that a right model leaves, and its 95 % interval.

    The interval covers what spectra leave open, how much noise of logs so short
    scatters, and how unsure the encoder's part is.

    Attributes
    ----------
    rms : (n,) array
        N m; N where prismatic.
    low, high : (n,) arrays
        Ends of the interval.
    """

    rms: Array
    low: Array
    high: Array

    def with_detail(self, detail: Array) -> "NoiseFloor":
        """Return the floor of a model that may leave a detail, RMS (n,) N m, too."""
        return replace(
            self, rms=np.hypot(self.rms, detail), high=np.hypot(self.high, detail)
        )

    def interval(self, joint: int) -> tuple[float, float]:
        """Return the 95 % interval of one joint's floor, N m."""
        return float(self.low[joint]), float(self.high[joint])

    def doubts(self, residual_rms: Array, joints: Sequence[Joint]) -> tuple[str, ...]:
        """Return notes on joints that leave less, RMS (n,) N m, than the interval."""
        notes = []
        for joint, rms_left, low, high in zip(
            joints, residual_rms, self.low, self.high, strict=True
        ):
            if rms_left < low:  # not of NaN: such a joint never slides
                unit = joint.unit("N m")
                notes.append(
                    f"joint {joint.name}: {rms_left:.3g} {unit} is left, less than the"
                    f" noise floor's interval, {low:.3g} to {high:.3g} {unit}: the"
                    " floor's estimate is doubtful there; a log with rests of several"
                    " seconds gives a better one"
                )
        return tuple(notes)


@dataclass(frozen=True, kw_only=True)
class _NoisyLog:
    """One log with what noise is estimated from."""

    recording: Recording
    scene: Scene
    residual: Array  # (N, n) N m
    encoder_residual: Array  # (N, n) N m, what the encoder's noise makes of it
    rests: "_Rests"


@dataclass(frozen=True)
class _Rests:
    """Pieces of equal length in which all joints stand."""

    starts: list[int]  # first samples, at the log's own rate
    length: int  # samples


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
    """Find the noise floor of every joint where it slides.

    Parameters
    ----------
    recordings : sequence of Recording
        The logs.
    `scenes` : sequence of `Scene`
        Their data sets.
    residual : sequence of (N, n) arrays
        What is left [N m; N where prismatic] at the samples of each data set after all
        effects have been taken out, zero where it does not count.
    echo : sequence of (N, n) arrays
        The part of it that the encoder's noise makes (see `encoder_residuals`).
    rows : Rows, optional
        What the floor is of; by default all samples at which a joint slides.
    judged : int, optional
        The floor is of the first so many logs, by default of all. The other logs only
        help to find the noise.
    encoder_error : float
        Relative standard error of the encoder's part.

    Returns
    -------
    NoiseFloor
        An estimate of its own: what a model leaves does not bound it.
    """
    logs = [
        _NoisyLog(
            recording=recording,
            scene=scene,
            residual=of_log,
            encoder_residual=of_encoder,
            rests=_rests(recording, scene),
        )
        for recording, scene, of_log, of_encoder in zip(
            recordings, scenes, residual, echo, strict=True
        )
    ]
    floors = [
        _floor_of_joint(
            logs, joint, rows=rows, judged=judged, encoder_error=encoder_error
        )
        for joint in range(scenes[0].robot.n)
    ]
    by_end = np.array(floors).T
    return NoiseFloor(rms=by_end[0], low=by_end[1], high=by_end[2])


def _floor_of_joint(
    logs: Sequence[_NoisyLog],
    joint: int,
    *,
    rows: Rows | None,
    judged: int | None,
    encoder_error: float,
) -> Array:
    """Return the RMS (3,) of one joint's floor and the ends of its interval, N m."""
    slid: list[tuple[Motion, float]] = []  # motions, with the time [s] of sliding
    sliding_echo = []
    sliding_residual = []
    for log in logs[:judged]:
        slides = log.scene.slides[:, joint]
        sliding_echo.append(log.encoder_residual[slides, joint])
        sliding_residual.append(log.residual[slides, joint])
        if slides.any():
            motion = log.scene.motion
            slid.append((motion, float(slides.sum()) / motion.rate_hz))

    # The encoder's part is drawn, not spectral: it adds to torque noise in squares.
    if rows is None:
        encoder_rms = _rms_where_counted(sliding_echo)
    else:
        encoder_rms = rms(
            rows.torque(joint, [log.encoder_residual[:, joint] for log in logs])
        )
    encoder = encoder_rms * np.exp(encoder_error * NORMAL_95)
    residual_rms = _rms_where_counted(sliding_residual)

    reference_hz = logs[0].scene.motion.lowpass.cutoff_hz
    at_rest = [
        _at_rest(log, joint)
        for log in logs
        if log.rests.starts and log.recording.tau is not None
    ]
    moving = [_above(log.recording, log.scene, joint) for log in logs]
    moving += [
        _top_of_band(
            log.recording,
            log.scene,
            log.residual[:, joint],
            log.encoder_residual[:, joint],
            joint,
        )
        for log in logs
    ]
    floor = np.hypot(_torque_noise([*at_rest, *moving], slid, reference_hz), encoder)

    # Of noise no more can be there than is left of the torque in all: rests that say
    # so show something else, a drive's own motion.
    rests_are_refuted = bool(at_rest) and floor[1] > residual_rms
    if rests_are_refuted:
        floor = np.hypot(_torque_noise(moving, slid, reference_hz), encoder)
    if rests_are_refuted or not at_rest:
        # Below the top of the band noise may have any shape.
        floor[2] = max(floor[2], min(residual_rms, floor[3]))
    return np.asarray(floor[:3])


def _rms_where_counted(parts: Sequence[Array]) -> float:
    """Return the RMS of all parts; a zero says that a sample does not count."""
    values = np.concatenate(parts)
    return rms(values[values != 0.0])


def _torque_noise(
    spectra: Sequence[Spectrum], slid: Slid, reference_hz: float
) -> Array:
    """Return the RMS (4,) N m of low-passed torque noise.

    It is the estimate, the ends of its interval, and the most of any shape of noise.
    Without any spectrum nothing is known: it may be from nothing to anything.
    """
    filled = [spectrum for spectrum in spectra if len(spectrum.frequency)]
    if not (filled and slid):
        return UNKNOWN
    return level_of(filled, reference_hz).rms(slid)


def _rests(recording: Recording, scene: Scene) -> _Rests:
    """Find pieces in which all joints stand, a period of the cut-off off moves."""
    period = recording.rate_hz / scene.motion.lowpass.cutoff_hz
    still = unmoved(
        recording.q, encoder_resolution(scene.robot), round(STRETCH * period)
    )
    quiet = shrink(still & recording.valid, round(period))
    lengths = [
        stop - start
        for start, stop in runs(quiet, len(quiet))
        if stop - start >= STRETCH * period
    ]
    length = int(np.median(lengths or [0]))
    return _Rests(starts=stretches(quiet, length) if length else [], length=length)


def _at_rest(log: _NoisyLog, joint: int) -> Spectrum:
    """Return the spectrum of the raw torque while all joints stand."""
    assert log.recording.tau is not None
    spectrum = Spectrum.of(
        log.recording.tau[:, joint],
        log.rests.starts,
        log.rests.length,
        log.recording.rate_hz,
        robust=False,
    )
    return spectrum.at_least(_rounding(log.recording, joint))


def _above(
    recording: Recording,
    scene: Scene,
    joint: int,
    *,
    above: float = 1.5,
    up_to: float = 10.0,
) -> Spectrum:
    """Return the spectrum of the raw torque above the cut-off where the joint slides.

    `above` and `up_to` limit the band, in cut-offs. Where the joint never slides for
    long, the spectrum is of all that is valid.
    """
    assert recording.tau is not None
    rate_hz = recording.rate_hz
    cutoff_hz = scene.motion.lowpass.cutoff_hz
    n_samples = len(recording.t)
    length = min(round(STRETCH * rate_hz / cutoff_hz), n_samples)

    # Sliding is known at the samples of the data set, of which there may be fewer.
    nearest = np.linspace(0, scene.samples - 1, n_samples).round().astype(int)
    slides = scene.slides[nearest, joint] & recording.valid
    starts = stretches(slides, length) or stretches(recording.valid, length)
    spectrum = Spectrum.of(
        recording.tau[:, joint], starts, length, rate_hz, robust=True
    )
    in_band = spectrum.within(above * cutoff_hz, up_to * cutoff_hz)
    return in_band.at_least(_rounding(recording, joint))


def _top_of_band(
    recording: Recording,
    scene: Scene,
    residual: Array,
    echo: Array,
    joint: int,
    *,
    band: tuple[float, float] = (0.45, 0.95),
) -> Spectrum:
    """Return the spectrum of what is left (N,) at the top of the band, not low-passed.

    Steps of the torque, which reach above the cut-off, the model has below it. What the
    encoder's noise makes (N,) is taken off. Between the cut-offs `band` nothing moves.
    """
    lowpass = scene.motion.lowpass
    rate_hz = scene.motion.rate_hz
    low_hz = high_hz = 0.0
    if lowpass.active:
        low_hz = band[0] * lowpass.cutoff_hz
        high_hz = band[1] * lowpass.cutoff_hz

    length = min(round(STRETCH * rate_hz / lowpass.cutoff_hz), scene.samples)
    starts = stretches(scene.slides[:, joint] & (residual != 0.0), length)
    of_residual = Spectrum.of(residual, starts, length, rate_hz, robust=True)
    of_encoder = Spectrum.of(echo, starts, length, rate_hz, robust=True)
    in_band = of_residual.within(low_hz, high_hz)
    made_by_encoder = of_encoder.within(low_hz, high_hz)

    # Both scatter: a difference may be negative, a share of the whole is not.
    density = np.maximum(
        in_band.density - made_by_encoder.density, LEAST_SHARE * in_band.density
    )
    raw = replace(in_band, density=density / power_gain(lowpass, in_band.frequency, 2))
    return raw.at_least(_rounding(recording, joint))


def _rounding(recording: Recording, joint: int) -> float:
    """Return the density [N^2 m^2 / Hz] of the noise that rounding the torque makes."""
    assert recording.tau is not None
    step = encoder_step(recording.tau[:, [joint]])[0]
    return float(step**2 / 12.0 / recording.rate_hz)


def encoder_residuals(
    recordings: Sequence[Recording], scenes: Sequence[Scene]
) -> list[Array]:
    """Draw the residuals of a right model where only the encoder is noisy.

    Parameters
    ----------
    recordings : sequence of Recording
        The logs.
    `scenes` : sequence of `Scene`
        Their data sets.

    Returns
    -------
    list of (N, n) arrays
        N m (N where prismatic), one per data set, drawn once.
    """
    rng = np.random.default_rng(SEED)
    return [
        _encoder_residual(recording, scene, rng)
        for recording, scene in zip(recordings, scenes, strict=True)
    ]


def _encoder_residual(
    recording: Recording, scene: Scene, rng: np.random.Generator
) -> Array:
    """Draw the residual (N, n) N m of one log."""
    motion = scene.motion
    rate_hz = recording.rate_hz
    valid = recording.valid
    stride = round(rate_hz / motion.rate_hz)
    lowpass = Lowpass(motion.lowpass.cutoff_hz, rate_hz)

    def estimated(angle: Array) -> tuple[Array, Array, Array]:
        """Return motion q, dq, ddq as it is estimated from such readings."""
        low = lowpass(angle, valid)
        dq, ddq = differentiate(low, rate_hz, valid)
        return low[::stride], dq[::stride], ddq[::stride]

    # Positions up to a little above the cut-off are taken as the truth.
    truth = Lowpass(BEYOND * motion.lowpass.cutoff_hz, rate_hz)(recording.q, valid)
    readings = encoder_readings(
        truth,
        encoder_step(recording.q),
        motion.cutoff.noise_density,
        rate_hz,
        rng,
    )

    # What the model makes of the noisy readings.
    q, dq, _ = estimated(readings)
    friction = sampled_friction(scene.model.surfaces, replace(motion, q=q, dq=dq))
    rigid_source = readings if motion.source == "encoder" else truth
    rigid = scene.model.rigid(*estimated(rigid_source))

    # The torque of the truth, in which friction flips within one sample.
    sharp_surfaces = [
        surface and replace(surface, sign_width=SHARP)
        for surface in scene.model.surfaces
    ]
    dq_true, ddq_true = differentiate(truth, rate_hz, valid)
    torque = scene.model.rigid(truth, dq_true, ddq_true)
    torque += replace(scene.model, surfaces=sharp_surfaces).friction(truth, dq_true)

    measured = lowpass(lowpass(torque, valid), valid)[::stride]
    predicted_friction = motion.filtered(friction, times=2)
    return np.asarray(measured - motion.filtered(rigid) - predicted_friction)


def encoder_readings(
    q: Array, step: Array, density: Array, rate_hz: float, rng: np.random.Generator
) -> Array:
    """Return positions as an encoder reports them.

    Parameters
    ----------
    q : (N, n) array
        True positions [rad; m where prismatic].
    step : (n,) array
        Quantisation step of each encoder; zero where there is none.
    density : (n,) array
        Density of its white noise [rad^2 / Hz].
    rate_hz : float
        Of the samples.
    rng : numpy Generator
        What draws the noise and the phase of the quantisation.

    Returns
    -------
    (N, n) array
        In the unit of `q`.
    """
    power = 0.5 * density * rate_hz
    quantisation = step**2 / 12.0
    # The quantisation of a slow joint is tones; no more than its own size counts as
    # white noise.
    is_noisier = power > 2.0 * quantisation
    white = np.sqrt(np.where(is_noisier, power - quantisation, 0.0))
    q = q + white * rng.standard_normal(q.shape)

    unit = np.where(step > 0, step, 1.0)
    phase = rng.random(len(step))
    return np.where(step > 0, (np.round(q / unit + phase) - phase) * unit, q)
