"""Motion from encoders and IMUs together: by the smoother, filtered like all motion.

The smoother's error is uncorrelated with its estimate, as that of every posterior mean
is: it adds to the noise of the torque, but does not shrink a least-squares inertia as
noise of a differentiated encoder does (Berkson's errors, not the classical ones). What
it leaves out of the acceleration above its own bandwidth the low-pass takes from torque
and motion alike.
"""

from __future__ import annotations

import hashlib
from collections import OrderedDict
from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import msgspec
import numpy as np

from seqid_cli.errors import InputError
from seqid_cli.imu.smoother.imus import mounted_imus
from seqid_cli.imu.smoother.left_out import Compliance, beyond_noise, compliance_of
from seqid_cli.logs.recording import Recording, cut
from seqid_cli.motion.filters import bandwidth
from seqid_cli.motion.filters.butterworth import Lowpass
from seqid_cli.motion.filters.differentiation import differentiate
from seqid_cli.motion.motion import (
    Motion,
    estimate_motion,
    filtered_motion,
    filtered_torque,
)
from seqid_cli.motion.options import MotionOptions
from seqid_cli.params.schema import ImuStage
from seqid_cli.robot.types import Robot
from seqid_cli.typing import Array, Mask

if TYPE_CHECKING:
    from seqid_cli.imu.smoother.smooth import Smoothed


def fused_motion(
    log: Recording,
    robot: Robot,
    stage: ImuStage | None,
    encoder: Motion,
    *,
    insist: bool = False,
) -> Motion:
    """Smooth a log with all its IMUs that can be believed, and filter it once.

    Parameters
    ----------
    log : Recording
    robot : Robot
    stage : ImuStage, optional
    encoder : Motion
        By the encoders alone, at the log's own rate; its cut-off is kept where a user
        gave it.
    insist : bool
        Whether fused motion is kept whatever its left-out error (see `left_out`) and
        what it contradicts (see `disagreement`).

    Returns
    -------
    Motion
        Of source "fused" at that rate. The encoders' own, with both errors and
        warnings, where its left-out error is smaller, or where no IMU is calibrated,
        recorded and believed.

    Raises
    ------
    InputError
        No stretch of the log is long enough to filter.
    """
    warnings = (*encoder.warnings, *absent_imus(log, robot, stage))
    if not mounted_imus(log, robot, stage):
        return replace(encoder, warnings=warnings)

    smoothed = _smoothed(log, robot, stage)
    judged = _left_out(log, encoder, smoothed)
    warnings = (*warnings, *smoothed.notes, *_bending(robot, judged.bent))
    encoder_alone = replace(
        _with_left_out_errors(encoder, smoothed, judged), warnings=warnings
    )
    if not smoothed.mounted:
        return encoder_alone

    disagrees = disagreement(encoder, encoder.lowpass(smoothed.ddq, log.valid))
    if disagrees.any():
        names = ", ".join(robot.joint_names[j] for j in np.flatnonzero(disagrees))
        doubt = f"{', '.join(smoothed.mounted)} and the encoder of {names} disagree"
        if not insist:
            warning = f"{doubt}: encoders alone are used"
            return replace(encoder_alone, warnings=(*warnings, warning))
        warnings = (*warnings, doubt)
    if not insist and not _smaller_error(judged, smoothed, encoder):
        return encoder_alone
    return replace(_filtered(log, encoder, smoothed, judged), warnings=warnings)


def _smaller_error(judged: LeftOut, smoothed: Smoothed, encoder: Motion) -> bool:
    """Return whether fused motion errs less than the encoders.

    The geometric mean over the joints that move counts. What is left out was compared
    below the encoders' own cut-off. Where a model asks for a higher one, the noise up
    to there counts, of which differentiated encoders have more by hz^5.
    """
    moving = encoder.moving.any(axis=0)
    if not moving.any():
        return True
    hz = encoder.cutoff.hz
    density = encoder.cutoff.noise_density
    noise = bandwidth.smoothed_error(smoothed.typical(encoder.valid), density, hz)
    fused = noise + judged.beyond_noise + judged.bent
    differentiated = bandwidth.differentiated_error(density, hz) + judged.bent
    ratio = fused[moving] / np.maximum(differentiated[moving], 1e-300)
    return bool(np.mean(np.log(np.maximum(ratio, 1e-300))) < 0.0)


def _bending(robot: Robot, bent: Array) -> Iterator[str]:
    """Say which links do not follow their encoders; (n,) (rad/s^2)^2 by how much."""
    for j in np.flatnonzero(bent):
        joint = robot.joints[j]
        size = f"{np.sqrt(bent[j]):.2g} {joint.unit('rad/s^2')} (RMS)"
        yield (
            f"the link of {joint.name} accelerates by {size} otherwise than its encoder"
            " says: the joint bends; the errors of both sources hold that"
        )


def _with_left_out_errors(
    encoder: Motion, smoothed: Smoothed, judged: LeftOut
) -> Motion:
    """Return the encoders' motion with what the IMUs say of its error."""
    ddq = encoder.lowpass(smoothed.ddq, encoder.valid)
    bent = judged.compliance.power(ddq, encoder.lowpass, encoder.usable)
    return replace(
        encoder,
        error=np.sqrt(encoder.cutoff.acceleration_noise**2 + bent),
        encoder_error=judged.encoder_error,
        fused_error=judged.fused_error,
        disagreement=np.sqrt(judged.bent),
    )


def score_of_smoothed(
    recording: Recording,
    robot: Robot,
    stage: ImuStage | None,
    encoder: Motion,
    cutoffs: Array,
) -> bandwidth.Score:
    """Score cut-offs by the motion that the smoother makes of a log.

    Parameters
    ----------
    recording : Recording
    robot : Robot
    stage : ImuStage, optional
    encoder : Motion
        By the encoders alone, at the log's own rate.
    cutoffs : Array
        (C,) Hz.
    """
    return _score(_smoothed(recording, robot, stage), encoder, cutoffs)


def _score(smoothed: Smoothed, encoder: Motion, cutoffs: Array) -> bandwidth.Score:
    """Score cut-offs (C,) Hz by a smoothed motion."""
    variance = smoothed.typical(encoder.valid)
    density = encoder.cutoff.noise_density
    moves = np.any(encoder.moving, axis=0)
    errors = [bandwidth.smoothed_error(variance, density, hz)[moves] for hz in cutoffs]
    score = bandwidth.smoothed_score(
        smoothed.dq[:, moves],
        smoothed.ddq[:, moves],
        np.array(errors),
        encoder.rate_hz,
        cutoffs,
    )
    assert score.shares is not None
    return replace(score, shares=score.shares.of_joints(moves))


def _cutoff(smoothed: Smoothed, encoder: Motion) -> bandwidth.Cutoff:
    """Return the cut-off that suits a smoothed motion, or the user's."""
    of_encoder = encoder.cutoff
    if of_encoder.alone_hz is not None or not encoder.moving.any():
        return of_encoder
    highest = max(of_encoder.hz, min(bandwidth.HIGHEST_HZ, encoder.rate_hz / 8))
    candidates = np.geomspace(of_encoder.hz, highest, 60)
    score = _score(smoothed, encoder, candidates)

    highest_allowed = bandwidth.highest_of(score.bandwidth_hz)
    n_allowed = np.searchsorted(candidates, highest_allowed, side="right")
    allowed = score.values[: max(1, n_allowed)]
    best = bandwidth.lowest_as_good(allowed, score.joints)
    return replace(of_encoder, hz=float(candidates[best]), alone_hz=of_encoder.hz)


def needed(motion: Motion, encoder: Motion, *, min_gain: float = 3.0) -> bool:
    """Return whether acceleration is `min_gain` times better known than by encoders."""
    # What the drive and its encoder do wrong shows between encoder and torque, and a
    # smoother that believes the IMUs hides it. Who looks for such effects takes IMUs
    # only where the encoders are too coarse to show anything.
    return _gain(motion, encoder) > min_gain


def promising(
    recording: Recording,
    robot: Robot,
    stage: ImuStage | None,
    encoder: Motion,
    *,
    piece_s: float = 3.0,
    min_gain: float = 2.0,
) -> bool:
    """Return whether IMUs may be `needed`, by a piece about the fastest moment.

    Smoothing a whole log costs as much as all else that is done with its motion.

    Parameters
    ----------
    recording : Recording
    robot : Robot
    stage : ImuStage, optional
    encoder : Motion
        By the encoders alone.
    piece_s : float
        Length of the piece [s].
    min_gain : float
        Times that the piece's acceleration must be better known than by encoders.
    """
    duration_s = float(recording.t[-1])
    if not mounted_imus(recording, robot, stage) or duration_s < 2.0 * piece_s:
        return True
    speed = np.where(encoder.usable, np.abs(encoder.dq).max(axis=1), 0.0)
    middle = float(recording.t[np.argmax(speed)])
    first = min(max(middle - 0.5 * piece_s, 0.0), duration_s - piece_s)
    (piece,) = cut(recording, [(first, first + piece_s)])
    try:
        options = MotionOptions(cutoff_hz=encoder.cutoff.hz)
        alone = estimate_motion(piece, robot, options)
        return _gain(fused_motion(piece, robot, stage, alone), alone) > min_gain
    except InputError:  # nothing of the piece can be filtered
        return True


def _gain(motion: Motion, encoder: Motion) -> float:
    """Return how many times better acceleration is known than by the encoders.

    It is the median of the joints that move; 0 if none does.
    """
    moving = motion.moving.any(axis=0)
    if not moving.any():
        return 0.0
    error = np.maximum(motion.acceleration_error[moving], 1e-300)
    return float(np.median(encoder.acceleration_error[moving] / error))


def disagreement(
    encoder: Motion,
    ddq: Array,
    *,
    max_noise_ratio: float = 5.0,
    max_share: float = 0.05,
) -> Mask:
    """Return the joints whose encoder contradicts accelerations by IMUs.

    A wrong calibration, clocks apart, or a link that does not follow its encoder:
    elastic, loose, or behind an encoder that is mounted off its axis. The smoother
    knows nothing of any of them.

    Parameters
    ----------
    encoder : Motion
    ddq : Array
        (N, n) rad/s^2, low-passed at the encoders' cut-off.
    max_noise_ratio : float
        Times the encoder's noise, whose quantisation is not white in slow moves.
    max_share : float
        Share of the acceleration: what shakes faster than IMUs sample shows up below.

    Returns
    -------
    Mask
        (n,).
    """
    moving = encoder.moving.any(axis=0)
    usable = encoder.usable
    difference = np.sqrt(np.mean((ddq - encoder.ddq)[usable] ** 2, axis=0))
    size = np.sqrt(np.mean(encoder.ddq[usable] ** 2, axis=0))
    limit = max_noise_ratio * encoder.cutoff.acceleration_noise + max_share * size
    # A difference that is no number agrees with nothing.
    return np.asarray(moving & ~(difference <= limit))


_CACHE: OrderedDict[bytes, Smoothed] = OrderedDict()


def _smoothed(
    recording: Recording,
    robot: Robot,
    stage: ImuStage | None,
    *,
    most_values: int = 16_000_000,
) -> Smoothed:
    """Smooth a log; the last motions are kept, up to `most_values` in all."""
    from seqid_cli.imu.smoother.smooth import smoothed_motion

    digest = _digest(recording, robot, stage)
    smoothed = _CACHE.pop(digest, None) or smoothed_motion(recording, robot, stage)
    _CACHE[digest] = smoothed
    while sum(3 * motion.q.size for motion in _CACHE.values()) > most_values:
        _CACHE.popitem(last=False)
    return smoothed


def _digest(recording: Recording, robot: Robot, stage: ImuStage | None) -> bytes:
    """Return a digest of what a smoothed motion follows from: all but the torque."""
    arm = f"{robot.sha256} {robot.joints!r} {robot.imus!r} {recording.rate_hz!r}"
    digest = hashlib.sha256(arm.encode())
    digest.update(b"" if stage is None else msgspec.json.encode(stage))
    arrays: dict[str, Array | Mask] = {
        "q": recording.q,
        "valid": recording.valid,
        **recording.accelerometers,
        **{f"{name} w": rates for name, rates in recording.gyros.items()},
    }
    for name, values in arrays.items():
        digest.update(f"{name} {values.shape}".encode())
        digest.update(np.ascontiguousarray(values).tobytes())
    return digest.digest()


def absent_imus(
    recording: Recording, robot: Robot, stage: ImuStage | None
) -> Iterator[str]:
    """Say which calibrated IMUs are not recorded, and which recorded not calibrated."""
    if stage is None:
        return
    for imu in robot.imus:
        is_recorded = imu.name in recording.accelerometers
        is_calibrated = imu.name in stage.imus
        if is_calibrated and not is_recorded:
            yield f"{imu.name} is not recorded"
        if is_recorded and not is_calibrated:
            yield f"{imu.name} is not calibrated"


def _filtered(
    recording: Recording, encoder: Motion, smoothed: Smoothed, judged: LeftOut
) -> Motion:
    """Filter a smoothed motion.

    Joints that no IMU sees are differentiated as without IMUs.
    """
    cutoff = _cutoff(smoothed, encoder)
    valid = recording.valid
    variance = smoothed.typical(valid)
    lowpass = Lowpass(cutoff.hz, recording.rate_hz)

    # What noise makes of locked joints must not pass for excitation.
    moves = np.any(encoder.moving, axis=0)
    q = lowpass(np.where(moves, smoothed.q, recording.q), valid)
    dq = lowpass(np.where(moves, smoothed.dq, 0.0), valid)
    ddq = lowpass(np.where(moves, smoothed.ddq, 0.0), valid)

    unseen = moves & np.isinf(variance[:, 0])
    if unseen.any():
        by_encoder = lowpass(recording.q[:, unseen], valid)
        first, second = differentiate(by_encoder, recording.rate_hz, valid)
        q[:, unseen] = by_encoder
        dq[:, unseen] = first
        ddq[:, unseen] = second

    tau, usable = filtered_torque(recording, lowpass)
    noise = bandwidth.smoothed_error(variance, cutoff.noise_density, cutoff.hz)
    # Nothing says of a joint beyond all IMUs that it bends, or contradicts its encoder.
    beyond = np.where(unseen, 0.0, judged.beyond_noise)
    bent = np.where(unseen, 0.0, judged.compliance.power(ddq, lowpass, usable))
    return replace(
        encoder,
        q=q,
        dq=dq,
        ddq=ddq,
        tau=tau,
        usable=usable,
        source="fused",
        lowpass=lowpass,
        cutoff=cutoff,
        imus=tuple(smoothed.mounted),
        error=np.sqrt(noise + beyond + bent),
        encoder_error=judged.encoder_error,
        fused_error=judged.fused_error,
        disagreement=np.sqrt(judged.bent),
    )


@dataclass(frozen=True, kw_only=True)
class LeftOut:
    """What encoders and IMUs say of each other below the encoders' own cut-off.

    Attributes
    ----------
    beyond_noise : Array
        (n,) (rad/s^2)^2, of fused motion against the encoders.
    compliance : Compliance
    bent : Array
        (n,) (rad/s^2)^2, of links against their drives.
    fused_error, encoder_error : Array
        (n,) rad/s^2.
    """

    beyond_noise: Array
    compliance: Compliance
    bent: Array
    fused_error: Array
    encoder_error: Array


def _left_out(recording: Recording, encoder: Motion, smoothed: Smoothed) -> LeftOut:
    """Judge both sources where they compare: below the encoders' own cut-off."""
    hz = encoder.cutoff.alone_hz or encoder.cutoff.hz
    cutoff = replace(encoder.cutoff, hz=hz, alone_hz=None)
    valid = recording.valid
    alone = filtered_motion(
        recording.t, recording.q, valid, encoder.rate_hz, cutoff, encoder.moving
    )
    ddq = alone.lowpass(smoothed.ddq, valid)
    difference = ddq - alone.ddq
    beyond = beyond_noise(difference, alone)

    # Links against drives: what the IMUs show beyond the fused motion, and that beyond
    # encoders.
    links = alone.lowpass(smoothed.beyond, valid) + difference
    compliance = compliance_of(links, ddq, alone)
    bent = compliance.power(ddq, alone.lowpass, alone.usable)

    density = cutoff.noise_density
    fused = bandwidth.smoothed_error(smoothed.typical(valid), density, hz)
    differentiated = bandwidth.differentiated_error(density, hz)
    return LeftOut(
        beyond_noise=beyond,
        compliance=compliance,
        bent=bent,
        fused_error=np.sqrt(fused + beyond + bent),
        encoder_error=np.sqrt(differentiated + bent),
    )
