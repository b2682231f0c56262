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
    """Motion of n joints on a uniform time base.

    Terms computed from the motion are to be filtered once more with `lowpass` (see
    `filtered`), friction twice: torque went through it twice.

    Attributes
    ----------
    t : Array
        (N,) s.
    q, dq, ddq : Array
        (N, n) rad, rad/s, rad/s^2 (m for slides), low-passed once.
    tau : Array, optional
        (N, n) N m, low-passed twice.
    moving : Mask
        (N, n), where each joint moves.
    usable : Mask
        (N,), false near ends and gaps, where the filter has not settled.
    valid : Mask
        (N,), false in gaps.
    rate_hz : float
        Samples per second.
    lowpass : Lowpass
        The filter of all quantities.
    cutoff : Cutoff
        What its cut-off was chosen from.
    source : {"encoder", "imu", "fused"}
        "imu": `dq` and `ddq` by Eq. 30-42; "fused": all by the smoother.
    imus : tuple of str
        IMUs that took part.
    error : Array, optional
        (n,) rad/s^2, standard deviation of `ddq` by IMUs.
    encoder_error : Array, optional
        (n,) rad/s^2, standard deviation of `ddq` by the encoders alone.
    fused_error : Array, optional
        (n,) rad/s^2, that of fused motion below the encoders' cut-off.
    disagreement : Array, optional
        (n,) rad/s^2, the part of both errors by which links and drives disagree. It
        and `fused_error` are known where IMUs were asked.
    velocity_error : Array, optional
        (n,) rad/s, standard deviation of `dq` by IMUs.
    warnings : tuple of str
        What was not as it should be.
    celsius : Array, optional
        (N, n), the joints' temperatures, NaN where none was logged.
    """

    t: Array
    q: Array
    dq: Array
    ddq: Array
    tau: Array | None
    moving: Mask
    usable: Mask
    valid: Mask
    rate_hz: float
    lowpass: Lowpass
    cutoff: Cutoff
    source: str = "encoder"
    imus: tuple[str, ...] = ()
    error: Array | None = None
    encoder_error: Array | None = None
    fused_error: Array | None = None
    disagreement: Array | None = None
    velocity_error: Array | None = None
    warnings: tuple[str, ...] = ()
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
        """Return some samples; the filter stays."""
        taken: dict[str, Any] = {}
        for name in (*self.PER_SAMPLE, "celsius"):
            values = getattr(self, name)
            taken[name] = None if values is None else values[where]
        return replace(self, **taken)

    def filtered(self, values: Array, times: int = 1, *, every: int = 1) -> Array:
        """Send computed terms (N, ...) through the motion's own low-pass."""
        return self.lowpass(values, self.valid, times=times, every=every)


def estimate_motion(
    recording: Recording, robot: Robot, options: MotionOptions
) -> Motion:
    """Filter and differentiate the encoder positions of one log.

    Parameters
    ----------
    recording : Recording
    robot : Robot
    options : MotionOptions

    Returns
    -------
    Motion
        At the log's own rate.

    Raises
    ------
    InputError
        No stretch is long enough to filter.
    """
    cutoff = cutoff_of(recording, robot, options)
    survey = survey_of_positions(recording.q, recording.rate_hz)
    step = survey.noise_step(encoder_resolution(robot))
    moving = moving_mask(recording.q, recording.rate_hz, step)
    return motion_below(recording, cutoff, moving)


def cutoff_of(recording: Recording, robot: Robot, options: MotionOptions) -> Cutoff:
    """Return the cut-off of one log: the one chosen from it, or the one asked for."""
    rate_hz = recording.rate_hz
    survey = survey_of_positions(recording.q, rate_hz)
    resolution = encoder_resolution(robot)
    cutoff = survey.cutoff(resolution, highest_hz=highest_bridged(recording))
    if recording.sha256 in options.logs_with_own_cutoff:
        return cutoff
    return as_asked(cutoff, recording.path, rate_hz, options)


def motion_below(recording: Recording, cutoff: Cutoff, moving: Mask) -> Motion:
    """Filter and differentiate the encoder positions of one log below a cut-off.

    All quantities go through the same filter (Sec. 2.1, parallel filtering).

    Parameters
    ----------
    recording : Recording
    cutoff : Cutoff
    moving : Mask
        (N, n), where each joint moves.

    Returns
    -------
    Motion
        At the log's own rate.

    Raises
    ------
    InputError
        No stretch is long enough to filter.
    """
    motion = filtered_motion(
        recording.t, recording.q, recording.valid, recording.rate_hz, cutoff, moving
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
    """Filter and differentiate positions; torque is left out.

    Parameters
    ----------
    t : Array
        (N,) s.
    q : Array
        (N, n) rad, not filtered yet.
    valid : Mask
        (N,), false in gaps.
    rate_hz : float
    cutoff : Cutoff
    moving : Mask
        (N, n), where each joint moves.
    """
    lowpass = Lowpass(cutoff.hz, rate_hz)
    q = lowpass(q, valid)
    dq, ddq = differentiate(q, rate_hz, valid)
    return Motion(
        t=t,
        q=q,
        dq=dq,
        ddq=ddq,
        tau=None,
        moving=moving,
        usable=shrink(valid, 2 * lowpass.settling),
        valid=valid,
        rate_hz=rate_hz,
        lowpass=lowpass,
        cutoff=cutoff,
    )


def filtered_torque(
    recording: Recording, lowpass: Lowpass
) -> tuple[Array | None, Mask]:
    """Return the torque (N, n) after two passes, if any, and where (N,) it has settled.

    Raises
    ------
    InputError
        It settles nowhere.
    """
    usable = shrink(recording.valid, 2 * lowpass.settling)
    if recording.bridged is not None:
        usable &= ~recording.bridged
    if not usable.any():
        raise too_short(recording.path, lowpass.cutoff_hz)
    if recording.tau is None:
        return None, usable
    return lowpass(recording.tau, recording.valid, times=2), usable


def too_short(path: Path, cutoff_hz: float) -> InputError:
    """Make the error of a log without a stretch that is long enough to filter."""
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
    """Return the cut-off of a log: the one chosen from it, or the one asked for.

    Parameters
    ----------
    chosen : Cutoff
        The one chosen from the log.
    path : Path
        Of the log.
    rate_hz : float
        Of the log.
    options : MotionOptions
    min_samples : float
        Samples per period of the cut-off that a log must have.

    Raises
    ------
    InputError
        The log is too slow for the cut-off of the model to be used.
    """
    hz = options.cutoff_hz
    if hz is None:
        return chosen
    highest = rate_hz / min_samples
    is_of_model = options.origin not in ("", "as given")
    if hz > highest and is_of_model:
        message = (
            f"{rate_hz:.4g} samples per second are too few for the cut-off of"
            f" {hz:.3g} Hz, {options.origin}; the highest that this log allows is"
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
    """Return the highest cut-off [Hz] that bridged holes allow.

    A cubic across a hole of h seconds falls short of an acceleration of f Hz by
    (2 pi f h)^2 / 12: 13 percent at `max_periods` / h. Where less than `min_share` of
    the samples are bridged, they are left out of the equations instead.

    Parameters
    ----------
    recording : Recording
    min_share : float
        Of the samples.
    max_periods : float
        Length of a hole in periods of the cut-off.
    """
    if recording.bridged is None or recording.bridged.mean() < min_share:
        return HIGHEST_HZ
    holes = runs(recording.bridged, len(recording.t))
    lengths = [stop - start for start, stop in holes]
    return max_periods * recording.rate_hz / (float(np.median(lengths)) + 1.0)


def encoder_resolution(robot: Robot) -> Array:
    """Return the encoder steps (n,) rad of the robot file; zero where not given."""
    return np.array([joint.encoder_resolution or 0.0 for joint in robot.joints])


def decimated(motion: Motion, samples_per_cutoff: float = SAMPLES_PER_CUTOFF) -> Motion:
    """Keep every k-th sample, `samples_per_cutoff` or more per cut-off period."""
    # Low-passed signals lose nothing by it; the filter of computed terms runs on at the
    # lower rate.
    factor = int(motion.rate_hz / (samples_per_cutoff * motion.lowpass.cutoff_hz))
    if factor > 1 and motion.lowpass.active:
        return thinned(motion, factor)
    return motion


def thinned(
    motion: Motion, factor: int, start: int = 0, stop: int | None = None
) -> Motion:
    """Keep every `factor`-th sample of [start, stop).

    One is valid if all samples up to the next one are.

    Parameters
    ----------
    motion : Motion
    factor : int
    start, stop : int
        Samples of the motion; all by default.
    """
    stop = motion.samples if stop is None else stop
    groups = np.arange(0, stop - start, factor)
    valid = np.logical_and.reduceat(motion.valid[start:stop], groups)

    rate_hz = motion.rate_hz / factor
    every = factor * motion.lowpass.every
    lowpass = Lowpass(motion.lowpass.cutoff_hz, rate_hz, every)
    part = motion.part(slice(start, stop, factor))
    return replace(part, valid=valid, rate_hz=rate_hz, lowpass=lowpass)
