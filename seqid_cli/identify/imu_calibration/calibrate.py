"""IMU calibration (Sec. 3, Eq. 29-38): how each IMU is mounted on its link, and what it is like.

Directions of joint axes give a first mounting in closed form (`axis_pairs`, Eq. 38). A joint least
squares on the raw readings then finds, with the joints' motion, everything at once: mounting and
lever, biases, gains and axes of the sensors, and the offset of their clock (`solve`). Gravity,
centripetal and tangential accelerations show more than the axes alone: two parallel axes a known
distance apart, or a single one that is not vertical, settle the angle about them. What the logs
leave open is named and never written as a number.
"""

import operator
from collections.abc import Iterable
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np

from seqid_cli.errors import QualityError, UsageError
from seqid_cli.identify.imu_calibration.initial_guess import (
    Pair,
    axis_pairs,
    fit_rotation,
    starting_constants,
)
from seqid_cli.identify.imu_calibration.result import calibration_of, verdict_of
from seqid_cli.identify.imu_calibration.segments import (
    Segment,
    calibration_cutoff,
    segments_of,
    thinned,
)
from seqid_cli.identify.imu_calibration.solve import fit_constants
from seqid_cli.identify.log_set import reduced
from seqid_cli.logs.recording import Recording
from seqid_cli.motion.imu.array import layout
from seqid_cli.motion.motion import estimate_motion
from seqid_cli.motion.options import MotionOptions
from seqid_cli.params.schema import ImuStage, Verdict
from seqid_cli.robot.types import Robot

Gathered = tuple[list[Segment], list[Pair], list[float]]  # of one IMU; [rad/s^2/sqrt(Hz)]
Found = tuple[dict[str, Gathered], list[float]]  # of every IMU; cut-off [Hz] of each log


def calibrate_imus(
    recordings: Iterable[Recording], robot: Robot, *, options: MotionOptions
) -> ImuStage:
    """Calibrate every IMU of the robot file; name what these logs do not determine.

    `recordings`: best joints before the IMUs move one at a time and fast, the others locked in
    several configurations. Raises UsageError if the robot file has no IMU, QualityError if no log
    moves a joint before an IMU that it records.
    """
    if not robot.imus:
        raise UsageError(
            "the robot file has no [[imu]]", hint="describe the IMU in it", where=str(robot.source)
        )
    found, cutoffs = reduced(recordings, partial(_gathered, robot, options), _both) or ({}, [])
    moved = [name for name, own in found.items() if any(s.moving for s in own[0])]
    if not moved:
        message = "no log moves a joint before an IMU with its readings recorded"
        hint = "rotate the first joint back and forth with the others locked in several postures"
        raise QualityError(message, hint=hint)
    imus, verdicts, notes = {}, [], []
    for imu in robot.imus:
        if imu.name not in moved:
            reason = "no log moves a joint before this IMU with its readings recorded"
            verdicts.append(Verdict(joint=imu.name, good=False, reason=reason))
            continue
        every, pairs, densities = found[imu.name]
        most = max(segment.channels for segment in every)
        segments = thinned([s for s in every if s.channels == most])
        seen = replace(imu, gyro=most > len(imu.axes))
        guess = fit_rotation(pairs) if pairs else np.eye(3)
        fit = fit_constants(segments, robot, seen, starting_constants(segments, robot, seen, guess))
        density = float(np.median(densities)) if densities else None
        calibration = calibration_of(robot, seen, fit, segments, pairs, density)
        imus[imu.name] = calibration
        notes += [f"{imu.name}: {text}" for text in calibration.not_determined]
        verdicts.append(verdict_of(robot, imu, calibration, converged=fit.converged))
    cutoff = float(np.median(cutoffs))
    return ImuStage(imus=imus, cutoff_hz=cutoff, verdicts=verdicts, notes=notes)


def _both(first: Found, second: Found) -> Found:
    """What two parts of the logs hold."""
    own: dict[str, Any] = {
        name: tuple(map(operator.add, mine, second[0][name])) for name, mine in first[0].items()
    }
    return own, first[1] + second[1]


def _gathered(robot: Robot, options: MotionOptions, recording: Recording, number: int) -> Found:
    """What one log holds of every IMU."""
    found: dict[str, Gathered] = {imu.name: ([], [], []) for imu in robot.imus}
    motion = estimate_motion(recording, robot, options)
    cutoff_hz = calibration_cutoff(motion, options.cutoff_hz)
    for imu in robot.imus:
        if imu.name not in recording.accelerometers:
            continue
        seen = replace(imu, gyro=imu.gyro and imu.name in recording.gyros)
        own = segments_of(recording, robot, seen, motion, log=number, cutoff_hz=cutoff_hz)
        pairs: list[Pair] = []
        density = 0.0
        if layout(seen).acceleration or seen.gyro:
            pairs, density = axis_pairs(recording, robot, seen, motion)
        found[imu.name] = own, pairs, [density] if pairs else []
    return found, [cutoff_hz]
