"""Motion from encoders and IMUs together: what the smoother says, filtered like everything else.

The smoother's error is uncorrelated with its estimate, as that of every posterior mean
is: it adds to the noise of the torque, but does not shrink a least-squares inertia as
noise of a differentiated encoder does (Berkson's errors, not the classical ones). What
it leaves out of the acceleration above its own bandwidth the low-pass takes from torque
and motion alike.
"""

import hashlib
from collections import OrderedDict
from collections.abc import Iterator
from dataclasses import dataclass, replace

import msgspec
import numpy as np

from seqid_cli.errors import InputError
from seqid_cli.logs.pieces import cut
from seqid_cli.logs.recording import Recording
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
from seqid_cli.motion.smoother.imus import mounted_imus
from seqid_cli.motion.smoother.left_out import Compliance, beyond_noise, compliance_of
from seqid_cli.motion.smoother.smooth import Smoothed, smoothed_motion
from seqid_cli.params.schema import ImuStage
from seqid_cli.robot.types import Robot
from seqid_cli.typing import Array, Mask


def fused_motion(
    log: Recording,
    robot: Robot,
    stage: ImuStage | None,
    encoder: Motion,
    *,
    insist: bool = False,
) -> Motion:
    """Smooth a log with all its IMUs that can be believed, and filter it once.

    `encoder`: motion by the encoders alone, at the log's own rate; its cut-off is kept
    where a user gave it. `insist`: keep fused motion whatever its left-out error (see
    `left_out`) and what it contradicts (see `disagreement`). Returns: of source "fused"
    at that rate; the encoder's own, with both errors and warnings, where its left-out
    error is smaller, or no IMU is calibrated, recorded and believed. Raises InputError:
    no stretch of the log is long enough to filter.
    """
    missing = tuple(absent_imus(log, robot, stage))
    if not mounted_imus(log, robot, stage):
        return replace(encoder, warnings=(*encoder.warnings, *missing))
    smoothed = _smoothed(log, robot, stage)
    judged = _left_out(log, encoder, smoothed)
    bending = tuple(_bending(robot, judged.bent))
    warnings = (*encoder.warnings, *missing, *smoothed.notes, *bending)
    alone = replace(_with_left_out_errors(encoder, smoothed, judged), warnings=warnings)
    if not smoothed.mounted:
        return alone

    apart = disagreement(encoder, encoder.lowpass(smoothed.ddq, log.valid))
    if apart.any():
        names = ", ".join(robot.joint_names[j] for j in np.flatnonzero(apart))
        doubt = f"{', '.join(smoothed.mounted)} and the encoder of {names} disagree"
        if not insist:
            return replace(
                alone, warnings=(*warnings, f"{doubt}: encoders alone are used")
            )
        warnings = (*warnings, doubt)
    if not insist and not _smaller_error(judged, smoothed, encoder):
        return alone
    return replace(_filtered(log, encoder, smoothed, judged), warnings=warnings)


def _smaller_error(judged: "LeftOut", smoothed: Smoothed, encoder: Motion) -> bool:
    """Whether fused motion errs less than the encoders, on the geometric mean of what moves.

    What is left out was compared below the encoders' own cut-off. Where a model asks
    for a higher one, the noise up to there counts, of which differentiated encoders
    have more by hz^5.
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
    encoder: Motion, smoothed: Smoothed, judged: "LeftOut"
) -> Motion:
    """The encoders' motion with what the IMUs say of its error."""
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
    """Score cut-offs [Hz] by the motion that the smoother makes of a log."""
    return _score(_smoothed(recording, robot, stage), encoder, cutoffs)


def _score(smoothed: Smoothed, encoder: Motion, cutoffs: Array) -> bandwidth.Score:
    variance, density = smoothed.typical(encoder.valid), encoder.cutoff.noise_density
    moves = np.any(encoder.moving, axis=0)
    error = np.array(
        [bandwidth.smoothed_error(variance, density, hz)[moves] for hz in cutoffs]
    )
    motion = smoothed.dq[:, moves], smoothed.ddq[:, moves]
    score = bandwidth.smoothed_score(*motion, error, encoder.rate_hz, cutoffs)
    assert score.shares is not None
    return replace(score, shares=score.shares.of_joints(moves))


def _cutoff(smoothed: Smoothed, encoder: Motion) -> bandwidth.Cutoff:
    """The cut-off that suits a smoothed motion, where the user gave none."""
    own = encoder.cutoff
    if own.alone_hz is not None or not encoder.moving.any():
        return own
    highest = max(own.hz, min(bandwidth.HIGHEST_HZ, encoder.rate_hz / 8))
    candidates = np.geomspace(own.hz, highest, 60)
    found = _score(smoothed, encoder, candidates)
    allowed = np.searchsorted(
        candidates, bandwidth.highest_of(found.bandwidth_hz), side="right"
    )
    best = bandwidth.lowest_as_good(found.values[: max(1, allowed)], found.joints)
    return replace(own, hz=float(candidates[best]), alone_hz=own.hz)


def needed(motion: Motion, encoder: Motion, *, min_gain: float = 3.0) -> bool:
    """Whether acceleration is `min_gain` times better known than by encoders: that pays."""
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
    """Whether IMUs may be `needed`: what `piece_s` seconds about the fastest moment say of it."""
    # Smoothing a whole log costs as much as all else that is done with its motion.
    if not mounted_imus(recording, robot, stage) or recording.t[-1] < 2.0 * piece_s:
        return True
    speed = np.where(encoder.usable, np.abs(encoder.dq).max(axis=1), 0.0)
    middle = float(recording.t[np.argmax(speed)])
    first = min(max(middle - 0.5 * piece_s, 0.0), float(recording.t[-1]) - piece_s)
    piece = cut(recording, [(first, first + piece_s)])[0]
    try:
        alone = estimate_motion(
            piece, robot, MotionOptions(cutoff_hz=encoder.cutoff.hz)
        )
        return _gain(fused_motion(piece, robot, stage, alone), alone) > min_gain
    except InputError:  # nothing of the piece can be filtered
        return True


def _gain(motion: Motion, encoder: Motion) -> float:
    """How many times better acceleration is known than by the encoders, median of what moves."""
    moving = motion.moving.any(axis=0)
    if not moving.any():
        return 0.0
    known = np.maximum(motion.acceleration_error[moving], 1e-300)
    return float(np.median(encoder.acceleration_error[moving] / known))


def disagreement(
    encoder: Motion,
    ddq: Array,
    *,
    max_noise_ratio: float = 5.0,
    max_share: float = 0.05,
) -> Mask:
    """Joints (n,) whose encoder contradicts accelerations that were filtered like its own.

    A wrong calibration, clocks apart, or a link that does not follow its encoder:
    elastic, loose, or behind an encoder that is mounted off its axis. The smoother
    knows nothing of any of them. `ddq` (N, n): accelerations [rad/s^2], low-passed at
    the encoders' cut-off. `max_noise_ratio`: times the encoder's noise, whose
    quantisation is not white in slow moves. `max_share`: share of the acceleration:
    what shakes faster than IMUs sample shows up below.
    """
    seen, used = encoder.moving.any(axis=0), encoder.usable
    apart = np.sqrt(np.mean((ddq - encoder.ddq)[used] ** 2, axis=0))
    size = np.sqrt(np.mean(encoder.ddq[used] ** 2, axis=0))
    limit = max_noise_ratio * encoder.cutoff.acceleration_noise + max_share * size
    return np.asarray(seen & ~(apart <= limit))


_KEPT = OrderedDict[bytes, Smoothed]()


def _smoothed(
    recording: Recording,
    robot: Robot,
    stage: ImuStage | None,
    *,
    most_values: int = 16_000_000,
) -> Smoothed:
    """Smooth a log; the last motions are kept, up to so many values in all."""
    # By a digest of what a smoothed motion follows from: all but the torque.
    arm = f"{robot.sha256} {robot.joints!r} {robot.imus!r} {recording.rate_hz!r}"
    follows = hashlib.sha256(arm.encode())
    follows.update(b"" if stage is None else msgspec.json.encode(stage))
    readings = {
        **recording.accelerometers,
        **{f"{k} w": v for k, v in recording.gyros.items()},
    }
    for name, values in (
        ("q", recording.q),
        ("valid", recording.valid),
        *readings.items(),
    ):
        follows.update(f"{name} {values.shape}".encode())
        follows.update(np.ascontiguousarray(values).tobytes())
    digest = follows.digest()
    found = _KEPT.pop(digest, None) or smoothed_motion(recording, robot, stage)
    _KEPT[digest] = found
    while sum(3 * one.q.size for one in _KEPT.values()) > most_values:
        _KEPT.popitem(last=False)
    return found


def absent_imus(
    recording: Recording, robot: Robot, stage: ImuStage | None
) -> Iterator[str]:
    """Say which calibrated IMUs are not in the log, and which in the log are not calibrated."""
    if stage is None:
        return
    for imu in robot.imus:
        recorded = imu.name in recording.accelerometers
        if imu.name in stage.imus and not recorded:
            yield f"{imu.name} is not recorded"
        if imu.name not in stage.imus and recorded:
            yield f"{imu.name} is not calibrated"


def _filtered(
    recording: Recording, encoder: Motion, smoothed: Smoothed, judged: "LeftOut"
) -> Motion:
    """Filter a smoothed motion; joints that no IMU sees are differentiated as without them."""
    cutoff, valid = _cutoff(smoothed, encoder), recording.valid
    variance, moves = smoothed.typical(valid), np.any(encoder.moving, axis=0)
    lowpass = Lowpass(cutoff.hz, recording.rate_hz)
    # What noise makes of locked joints must not pass for excitation.
    pairs = (smoothed.q, recording.q), (smoothed.dq, 0.0), (smoothed.ddq, 0.0)
    motion = [lowpass(np.where(moves, values, still), valid) for values, still in pairs]
    hidden = moves & np.isinf(variance[:, 0])
    if hidden.any():
        q = lowpass(recording.q[:, hidden], valid)
        alone = (q, *differentiate(q, recording.rate_hz, valid))
        for values, own in zip(motion, alone, strict=True):
            values[:, hidden] = own
    q, dq, ddq = motion
    tau, usable = filtered_torque(recording, lowpass)
    error = bandwidth.smoothed_error(variance, cutoff.noise_density, cutoff.hz)
    # Nothing says of a joint beyond all IMUs that it bends, or contradicts its encoder.
    beyond = np.where(hidden, 0.0, judged.beyond_noise)
    bent = np.where(hidden, 0.0, judged.compliance.power(ddq, lowpass, usable))
    made = replace(encoder, q=q, dq=dq, ddq=ddq, tau=tau, usable=usable, source="fused")
    made = replace(made, lowpass=lowpass, cutoff=cutoff, imus=tuple(smoothed.mounted))
    return replace(
        made,
        error=np.sqrt(error + beyond + bent),
        encoder_error=judged.encoder_error,
        fused_error=judged.fused_error,
        disagreement=np.sqrt(judged.bent),
    )


@dataclass(frozen=True, kw_only=True)
class LeftOut:
    """What encoders and IMUs say of each other below the encoders' own cut-off."""

    beyond_noise: Array  # (n,) (rad/s^2)^2, of fused motion against the encoders
    compliance: Compliance
    bent: Array  # (n,) (rad/s^2)^2, of links against their drives
    fused_error: Array  # (n,) rad/s^2
    encoder_error: Array  # (n,) rad/s^2


def _left_out(recording: Recording, encoder: Motion, smoothed: Smoothed) -> LeftOut:
    """Judge both sources where they can be compared: below the encoders' own cut-off."""
    hz = encoder.cutoff.alone_hz or encoder.cutoff.hz
    cutoff = replace(encoder.cutoff, hz=hz, alone_hz=None)
    valid = recording.valid
    alone = filtered_motion(
        recording.t, recording.q, valid, encoder.rate_hz, cutoff, encoder.moving
    )
    ddq = alone.lowpass(smoothed.ddq, valid)
    apart = ddq - alone.ddq
    beyond = beyond_noise(apart, alone)

    # Links against drives: what the IMUs show beyond the fused motion, and that beyond
    # encoders.
    links = alone.lowpass(smoothed.beyond, valid) + apart
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
