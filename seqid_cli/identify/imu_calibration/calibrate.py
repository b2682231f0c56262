"""IMU calibration (Sec. 3, Eq. 29-38): how each IMU is mounted on its link, and what it is like.

Directions of joint axes give a first mounting in closed form (`imu_pairs`, Eq. 38). A joint least
squares on the raw readings then finds, with the joints' motion, everything at once: mounting and
lever, biases, gains and axes of the sensors, and the offset of their clock (`imu_fit`). Gravity,
centripetal and tangential accelerations show more than the axes alone: two parallel axes a known
distance apart, or a single one that is not vertical, settle the angle about them. What the logs
leave open is named and never written as a number.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, field, replace

import numpy as np

from seqid_cli.errors import QualityError, UsageError
from seqid_cli.identify.imu_calibration.axis_pairs import Pair, axis_trials, fit_rotation
from seqid_cli.identify.imu_calibration.initial_guess import starting_constants
from seqid_cli.identify.imu_calibration.result import calibration_of, verdict_of
from seqid_cli.identify.imu_calibration.segments import (
    Segment,
    calibration_cutoff,
    segments_of,
    thinned,
)
from seqid_cli.identify.imu_calibration.sensor_model import first_constants
from seqid_cli.identify.imu_calibration.solve import fit_constants
from seqid_cli.identify.log_set import reduced
from seqid_cli.logs.recording import Recording
from seqid_cli.motion.imu.array import layout
from seqid_cli.motion.motion import estimate_motion
from seqid_cli.motion.options import MotionOptions
from seqid_cli.params.schema import ImuCalibration, ImuStage, Verdict
from seqid_cli.robot.types import Imu, Robot


@dataclass
class Gathered:
    """What the logs read so far hold of one IMU."""

    segments: list[Segment] = field(default_factory=list)
    pairs: list[Pair] = field(default_factory=list)
    densities: list[float] = field(default_factory=list)

    def __add__(self, other: Gathered) -> Gathered:
        """Put what other logs hold behind."""
        return Gathered(
            self.segments + other.segments,
            self.pairs + other.pairs,
            self.densities + other.densities,
        )


def calibrate_imus(
    recordings: Iterable[Recording], robot: Robot, *, options: MotionOptions
) -> ImuStage:
    """Calibrate every IMU of the robot file.

    Parameters
    ----------
    recordings : iterable of Recording
        Logs in which joints before the IMUs move, best one at a time and fast, the others locked
        in several configurations.

    Returns
    -------
    ImuStage
        Rotation from IMU to link, lever, biases, gains, axes and clock offset with their standard
        errors, references of Eq. 29-31, and what these logs do not determine.

    Raises
    ------
    UsageError
        If the robot file has no IMU.
    QualityError
        If no log moves a joint before an IMU that it records.
    """
    if not robot.imus:
        raise UsageError(
            "the robot file has no [[imu]]", hint="describe the IMU in it", where=str(robot.source)
        )
    whole = reduced(recordings, GatheredOf(robot, options), GatheredLogs.__add__)
    found = whole.found if whole else {imu.name: Gathered() for imu in robot.imus}
    cutoffs = whole.cutoffs_hz if whole else []
    if not any(s.moving for gathered in found.values() for s in gathered.segments):
        raise QualityError(
            "no log moves a joint before an IMU with its readings recorded",
            hint="rotate the first joint back and forth with the others locked in several postures",
        )
    imus, verdicts, notes = {}, [], []
    for imu in robot.imus:
        gathered = found[imu.name]
        if not any(segment.moving for segment in gathered.segments):
            reason = "no log moves a joint before this IMU with its readings recorded"
            verdicts.append(Verdict(joint=imu.name, good=False, reason=reason))
            continue
        calibration, converged = _calibrated(robot, imu, gathered)
        imus[imu.name] = calibration
        notes += [f"{imu.name}: {text}" for text in calibration.not_determined]
        verdicts.append(verdict_of(robot, imu, calibration, converged=converged))
    cutoff = float(np.median(cutoffs))
    return ImuStage(imus=imus, cutoff_hz=cutoff, verdicts=verdicts, notes=notes)


@dataclass(frozen=True)
class GatheredLogs:
    """What some logs hold of every IMU, by its name, and the cut-off [Hz] of each log."""

    found: dict[str, Gathered]
    cutoffs_hz: list[float]

    def __add__(self, other: GatheredLogs) -> GatheredLogs:
        """Put two together."""
        found = {name: own + other.found[name] for name, own in self.found.items()}
        return GatheredLogs(found, self.cutoffs_hz + other.cutoffs_hz)


@dataclass(frozen=True)
class GatheredOf:
    """What one log holds of every IMU."""

    robot: Robot
    options: MotionOptions

    def __call__(self, recording: Recording, number: int) -> GatheredLogs:
        """Find it."""
        found = {imu.name: Gathered() for imu in self.robot.imus}
        cutoff_hz = _gather(recording, self.robot, found, number, self.options)
        return GatheredLogs(found, [cutoff_hz])


def _gather(
    recording: Recording,
    robot: Robot,
    found: dict[str, Gathered],
    number: int,
    options: MotionOptions,
) -> float:
    """Take from one log what it has of each IMU; returns the cut-off [Hz]."""
    motion = estimate_motion(recording, robot, options)
    cutoff_hz = calibration_cutoff(motion, options.cutoff_hz)
    for imu in robot.imus:
        if imu.name not in recording.accelerometers:
            continue
        own = found[imu.name]
        seen = recorded_imu(imu, recording)
        own.segments += segments_of(recording, robot, seen, motion, log=number, cutoff_hz=cutoff_hz)
        if layout(seen).acceleration or seen.gyro:
            trials = axis_trials(recording, robot, seen, motion)
            own.pairs += trials.pairs
            own.densities += [trials.density] if trials.pairs else []
    return cutoff_hz


def recorded_imu(imu: Imu, recording: Recording) -> Imu:
    """The IMU with what a log has of it: a gyro only where its rates were recorded."""
    return replace(imu, gyro=imu.gyro and imu.name in recording.gyros)


def _calibrated(robot: Robot, imu: Imu, gathered: Gathered) -> tuple[ImuCalibration, bool]:
    most = max(segment.channels for segment in gathered.segments)
    segments = thinned([s for s in gathered.segments if s.channels == most])
    imu = replace(imu, gyro=most > len(imu.axes))
    guess = fit_rotation(gathered.pairs) if gathered.pairs else first_constants(imu).R
    fit = fit_constants(segments, robot, imu, starting_constants(segments, robot, imu, guess))
    density = float(np.median(gathered.densities)) if gathered.densities else None
    calibration = calibration_of(robot, imu, fit, segments, gathered.pairs, density)
    return calibration, fit.converged
