"""What noise alone would leave of a torque: the measure of every fit's residual.

Noise of a drive's torque is a property of the drive, white and 1/f^a, and is looked for
in the spectra of the raw torque (`motion.torque_noise`): in rests, where nothing else
is, and above the cut-off while a joint slides. How much of it passes a log's low-pass
depends on the log. What the noise of the motion makes of the torque comes upon it, and
the share of a joint's torque that no model gets right. A fit that leaves no more than
the upper end of the interval leaves noise.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from seqid_cli.identify.regression.least_squares import Accumulator
from seqid_cli.logs.recording import Recording
from seqid_cli.model.torque import TorqueModel
from seqid_cli.motion.filters.bandwidth import encoder_step
from seqid_cli.motion.filters.differentiation import runs, shrink
from seqid_cli.motion.motion import Motion
from seqid_cli.motion.segmentation import unmoved
from seqid_cli.motion.torque_noise import DETAIL, Spectrum, level_of, stretches
from seqid_cli.params.schema import MotionUse, RigidStage, Stages
from seqid_cli.robot.types import Robot
from seqid_cli.typing import Array, Mask

STRETCH_PERIODS = (
    4.0  # of the cut-off: of a rest, at least, and of a spectrum while joints move
)
ABOVE, UP_TO = 1.5, 10.0  # times the cut-off, between which moving joints show noise
# Twice low-passed noise of the acceleration over that below the cut-off: 5 times the
# integral of x^4 / (1 + x^8)^4, which is an eighth of Euler's beta of 0.625 and 3.375.
BETA = math.gamma(0.625) * math.gamma(3.375) / math.gamma(4.0)
PASSED = math.sqrt(0.625 * BETA)
# One surface has one error, of a size between none and twice its standard error.
FRICTION_DOUBT = 2.0
ENCODER_DOUBT = 1.5  # the motion's noise is known to half of itself


@dataclass(frozen=True)
class LogNoise:
    """Spectra of the raw torque of one log, joint by joint, and for how long each slid.

    `resting` and `sliding` hold one spectrum per joint; `motion` is the log's last
    sample alone, with its low-pass and length; `seconds` (n,) s.
    """

    resting: tuple[Spectrum, ...]
    sliding: tuple[Spectrum, ...]
    motion: Motion
    seconds: Array


@dataclass(frozen=True)
class NoiseLevel:
    """RMS (n,) N m that noise leaves of each joint's torque, and its 95 % interval.

    All zero for a joint that nothing is known of.
    """

    rms: Array
    low: Array
    high: Array

    def times(self, residual: Array) -> Array:
        """Return a residual (n,) N m over the upper end of the noise's interval."""
        return np.asarray(residual / np.where(self.high > 0.0, self.high, np.inf))


def noise_of_log(recording: Recording, motion: Motion, slides: Mask) -> LogNoise:
    """Return what one log shows of its torques' noise.

    Parameters
    ----------
    recording : Recording
        With the raw torque.
    motion : Motion
        Of the same log, decimated or not.
    slides : (N, n) array of bool
        Samples of `motion` at which a joint slides.
    """
    assert recording.tau is not None
    rate = recording.rate_hz
    cutoff_hz = motion.lowpass.cutoff_hz
    samples, n = recording.tau.shape

    period = rate / cutoff_hz
    still = unmoved(recording.q, np.zeros(n), round(STRETCH_PERIODS * period))
    quiet = shrink(still & recording.valid, round(period))
    lengths = [
        b - a for a, b in runs(quiet, len(quiet)) if b - a >= STRETCH_PERIODS * period
    ]
    rest_length = int(np.median(lengths)) if lengths else 0
    rests = stretches(quiet, rest_length) if rest_length else []

    length = min(round(STRETCH_PERIODS * period), samples)
    nearest = np.linspace(0, len(slides) - 1, samples).round().astype(np.intp)
    resting, sliding = [], []
    for j in range(n):
        torque = recording.tau[:, j]
        rounding = float(encoder_step(torque[:, None])[0] ** 2 / 12.0 / rate)
        at_rest = Spectrum.of(torque, rests, max(rest_length, 1), rate, robust=False)
        resting.append(at_rest.at_least(rounding))
        starts = stretches(slides[nearest, j] & recording.valid, length)
        spectrum = Spectrum.of(torque, starts, length, rate, robust=True)
        between = spectrum.within(ABOVE * cutoff_hz, UP_TO * cutoff_hz)
        sliding.append(between.at_least(rounding))
    return LogNoise(
        resting=tuple(resting),
        sliding=tuple(sliding),
        motion=motion.part(slice(-1, None)),
        seconds=slides.sum(axis=0) / motion.rate_hz,
    )


def noise_level(
    logs: Sequence[LogNoise],
    encoder: Array,
    torque: Array,
    friction: Array | None = None,
) -> NoiseLevel:
    """Return the noise that some logs together show of each joint.

    Parameters
    ----------
    logs : sequence of LogNoise
    encoder : (n,) array
        RMS torque that the noise of the motion makes [N m].
    torque : (n,) array
        RMS of the joints' torques [N m].
    friction : (n,) array, optional
        RMS error that friction, identified before, is known to have [N m]. It is there
        as noise is.
    """
    stated = np.zeros(len(torque)) if friction is None else friction
    n = len(torque)
    middle, low, high = np.zeros((3, n))
    for j in range(n):
        slid = [
            (log.motion, float(log.seconds[j])) for log in logs if log.seconds[j] > 0.0
        ]
        resting = [log.resting[j] for log in logs if len(log.resting[j].frequency)]
        spectra = resting + [
            log.sliding[j] for log in logs if len(log.sliding[j].frequency)
        ]
        if not spectra or not slid:
            continue
        level = level_of(spectra, slid[0][0].lowpass.cutoff_hz).rms(slid)
        middle[j] = np.linalg.norm([level[0], encoder[j], stated[j]])
        low[j] = level[1]
        detail = DETAIL * torque[j]
        of_motion = ENCODER_DOUBT * encoder[j]
        high[j] = np.linalg.norm(
            [level[2], of_motion, FRICTION_DOUBT * stated[j], detail]
        )
    return NoiseLevel(rms=middle, low=low, high=high)


def noise_of_rows(
    stage: RigidStage,
    robot: Robot,
    *,
    uses: Sequence[MotionUse],
    logs: Sequence[LogNoise],
    joints: Sequence[Accumulator],
    torque_squares: Array,
    friction: Array | None = None,
) -> NoiseLevel:
    """Return the residual that noise of torque and motion leaves in the used rows.

    Parameters
    ----------
    stage : RigidStage
        The rigid body, as identified.
    robot : Robot
    uses : sequence of MotionUse
        Of the logs, with the errors of their accelerations.
    logs : sequence of LogNoise
    joints : sequence of Accumulator
        The n joints' rows.
    torque_squares : (n,) array
        Sums of the squared torque in these rows [(N m)^2].
    friction : (n,) array, optional
        As of `noise_level`.
    """
    model = TorqueModel.from_stages(Stages(inertia=stage), robot)
    squares = [
        torque_of_noise(model, robot, use.acceleration_error) ** 2 for use in uses
    ]
    of_motion = np.sqrt(np.mean(squares, axis=0)) if squares else np.zeros(robot.n)
    counts = np.array([max(joint.samples, 1) for joint in joints])
    return noise_level(logs, of_motion, np.sqrt(torque_squares / counts), friction)


def torque_of_noise(
    model: TorqueModel, robot: Robot, acceleration_error: Mapping[str, float]
) -> Array:
    """Return the RMS torque (n,) N m that noise of the joints' accelerations makes.

    Parameters
    ----------
    model : TorqueModel
        With the rigid body.
    robot : Robot
    acceleration_error : mapping of str to float
        Standard deviation [rad/s^2] below the cut-off of the joints that move.
    """
    q = postures(robot)
    still = np.zeros_like(q)
    at_rest = model.rigid(q, still, still)
    square = np.zeros_like(q)
    for j, name in enumerate(robot.joint_names):
        shaken = still.copy()
        shaken[:, j] = acceleration_error.get(name, 0.0)
        square += (model.rigid(q, still, shaken) - at_rest) ** 2
    return np.asarray(PASSED * np.sqrt(square.mean(axis=0)))


def postures(robot: Robot, *, count: int = 20) -> Array:
    """Return postures (count, n) within the joints' limits, always the same."""
    default = [
        (-0.5, 0.5) if joint.prismatic else (-np.pi, np.pi) for joint in robot.joints
    ]
    ranges = [
        joint.position_limits or limits
        for joint, limits in zip(robot.joints, default, strict=True)
    ]
    low, high = np.array(ranges).T
    return np.random.default_rng(0).uniform(low, high, (count, robot.n))
