"""Joint motion and torque of one log, filtered alike and ready for regression."""

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from seqid_cli.errors import InputError
from seqid_cli.logs.recording import Recording
from seqid_cli.motion.filters.bandwidth import HIGHEST_HZ, Cutoff
from seqid_cli.motion.filters.butterworth import Lowpass
from seqid_cli.motion.filters.differentiation import differentiate, runs, shrink
from seqid_cli.motion.filters.survey import survey_of_positions
from seqid_cli.motion.options import MotionOptions
from seqid_cli.motion.segmentation import moving_mask
from seqid_cli.robot.types import Robot
from seqid_cli.typing import Array, Mask

SAMPLES_PER_CUTOFF = 10


@dataclass(frozen=True)
class Motion:
    """Motion on a uniform time base.

    `q`, `dq`, `ddq` (N, n) went through the low-pass once, `tau` (N, n) N m twice:
    terms computed from the motion are to be filtered once more with `lowpass` (see
    `filtered`), friction twice.
    """

    t: Array
    q: Array
    dq: Array
    ddq: Array
    tau: Array | None
    moving: Mask
    usable: Mask  # (N,) false near ends and gaps, where the filter has not settled
    valid: Mask
    rate_hz: float
    lowpass: Lowpass
    cutoff: Cutoff
    # Or "imu" (`dq` and `ddq` by Eq. 30-42), "fused" (all by the smoother).
    source: str = "encoder"
    imus: tuple[str, ...] = ()  # that took part
    # (n,) rad/s^2, standard deviation of `ddq` that they leave
    error: Array | None = None
    encoder_error: Array | None = None  # that of the encoders alone
    # Of fused motion below the encoders' cut-off, and the part of both errors by which
    # links and drives disagree, (n,) rad/s^2; known where IMUs were asked.
    fused_error: Array | None = None
    disagreement: Array | None = None
    # (n,) rad/s, standard deviation of `dq` by IMUs
    velocity_error: Array | None = None
    warnings: tuple[str, ...] = ()  # what was not as it should be
    # (N, n) the joints' temperatures, NaN where none was logged
    celsius: Array | None = None

    PER_SAMPLE = ("t", "q", "dq", "ddq", "tau", "moving", "usable", "valid")

    @property
    def samples(self) -> int:
        """Number of samples."""
        return len(self.t)

    @property
    def acceleration_error(self) -> Array:
        """Standard deviation (n,) rad/s^2 of `ddq`."""
        return self.cutoff.acceleration_noise if self.error is None else self.error

    def part(self, where: slice) -> "Motion":
        """Some samples; the filter stays."""
        values = {name: getattr(self, name) for name in self.PER_SAMPLE}
        own: dict[str, Any] = {
            n: None if v is None else v[where] for n, v in values.items()
        }
        celsius = None if self.celsius is None else self.celsius[where]
        return replace(self, celsius=celsius, **own)

    def filtered(self, values: Array, times: int = 1, *, every: int = 1) -> Array:
        """Send computed terms (N, ...) through the motion's own low-pass; see its call."""
        return self.lowpass(values, self.valid, times=times, every=every)


def estimate_motion(
    recording: Recording, robot: Robot, options: MotionOptions
) -> Motion:
    """Filter and differentiate the encoder positions of one log (Sec. 2.1, parallel filtering).

    Returns: at the log's own rate. Raises InputError: no stretch is long enough to
    filter.
    """
    rate, resolution = recording.rate_hz, encoder_resolution(robot)
    survey = survey_of_positions(recording.q, rate)
    cutoff = survey.cutoff(resolution, highest_hz=highest_bridged(recording))
    if recording.sha256 not in options.own:
        cutoff = as_asked(cutoff, recording.path, rate, options)
    moving = moving_mask(recording.q, rate, survey.noise_step(resolution))
    motion = filtered_motion(
        recording.t, recording.q, recording.valid, rate, cutoff, moving
    )
    tau, usable = filtered_torque(recording, motion.lowpass)
    return replace(
        motion,
        tau=tau,
        usable=usable,
        warnings=recording.health.mended,
        celsius=recording.temperature,
    )


def filtered_motion(
    t: Array, q: Array, valid: Mask, rate_hz: float, cutoff: Cutoff, moving: Mask
) -> Motion:
    """Filter and differentiate positions q (N, n) at times t (N,); no torque yet."""
    lowpass = Lowpass(cutoff.hz, rate_hz)
    q = lowpass(q, valid)
    dq, ddq = differentiate(q, rate_hz, valid)
    usable = shrink(valid, 2 * lowpass.settling)
    return Motion(t, q, dq, ddq, None, moving, usable, valid, rate_hz, lowpass, cutoff)


def filtered_torque(
    recording: Recording, lowpass: Lowpass
) -> tuple[Array | None, Mask]:
    """Torque (N, n) after two passes, if any, and the samples at which it has settled."""
    usable = shrink(recording.valid, 2 * lowpass.settling)
    if recording.bridged is not None:
        usable &= ~recording.bridged
    if not usable.any():
        raise too_short(recording.path, lowpass.cutoff_hz)
    if recording.tau is None:
        return None, usable
    return lowpass(lowpass(recording.tau, recording.valid), recording.valid), usable


def too_short(path: Path, cutoff_hz: float) -> InputError:
    """The error of a log without a stretch that is long enough to filter."""
    message = (
        f"no stretch without a gap is long enough for a low-pass of {cutoff_hz:.3g} Hz"
    )
    hint = "record longer, mend the gaps, or give a higher --cutoff"
    return InputError(message, hint=hint, where=str(path))


def as_asked(
    chosen: Cutoff,
    path: Path,
    rate_hz: float,
    options: MotionOptions,
    *,
    min_samples: float = 4.0,
) -> Cutoff:
    """The cut-off of a log: the one that it has chosen, or the user's.

    Raises InputError: it is too slow for the cut-off of the model to be used.
    """
    hz, highest = options.cutoff_hz, rate_hz / min_samples
    if hz is None:
        return chosen
    if hz > highest and options.origin not in ("", "as given"):
        few = (
            f"{rate_hz:.4g} samples per second are too few for the cut-off of"
            f" {hz:.3g} Hz"
        )
        message = (
            f"{few}, {options.origin}; the highest that this log allows is"
            f" {highest:.3g} Hz"
        )
        hint = (
            f"identify and use the model with --cutoff {highest:.3g}, or leave this"
            " log out"
        )
        raise InputError(message, hint=hint, where=str(path))
    return replace(chosen, hz=hz, alone_hz=chosen.hz)


def highest_bridged(
    recording: Recording, *, min_share: float = 0.05, max_periods: float = 0.2
) -> float:
    """Highest cut-off [Hz] that bridged holes allow, where more than `min_share` of samples are."""
    # A cubic across a hole of h seconds falls short of an acceleration of f Hz by (2 pi
    # f h)^2 / 12: 13 percent at `max_periods` / h. A few holes are left out of the
    # equations instead.
    if recording.bridged is None or recording.bridged.mean() < min_share:
        return HIGHEST_HZ
    lengths = [
        stop - start for start, stop in runs(recording.bridged, len(recording.t))
    ]
    return max_periods * recording.rate_hz / (float(np.median(lengths)) + 1.0)


def encoder_resolution(robot: Robot) -> Array:
    """Encoder step of each joint (n,) rad; zero where the robot file does not give one."""
    return np.array([joint.encoder_resolution or 0.0 for joint in robot.joints])


def decimated(motion: Motion, samples_per_cutoff: float = SAMPLES_PER_CUTOFF) -> Motion:
    """Keep every k-th sample, at least `samples_per_cutoff` per period of the cut-off."""
    # Low-passed signals lose nothing by it; the filter of computed terms runs on at the
    # lower rate.
    factor = int(motion.rate_hz / (samples_per_cutoff * motion.lowpass.cutoff_hz))
    return thinned(motion, factor) if factor > 1 and motion.lowpass.active else motion


def thinned(
    motion: Motion, factor: int, start: int = 0, stop: int | None = None
) -> Motion:
    """Keep every `factor`-th sample of [start, stop), valid if all up to the next one are."""
    stop = motion.samples if stop is None else stop
    rate, groups = motion.rate_hz / factor, np.arange(0, stop - start, factor)
    valid = np.logical_and.reduceat(motion.valid[start:stop], groups)
    lowpass = Lowpass(motion.lowpass.cutoff_hz, rate, factor * motion.lowpass.every)
    part = motion.part(slice(start, stop, factor))
    return replace(part, valid=valid, rate_hz=rate, lowpass=lowpass)
