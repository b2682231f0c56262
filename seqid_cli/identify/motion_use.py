"""Source of the motion of each log and its errors, as the files have it."""

import contextlib
from collections.abc import Iterable
from pathlib import Path

import numpy as np

from seqid_cli.errors import InputError
from seqid_cli.identify.options import InertiaOptions
from seqid_cli.logs.recording import Recording
from seqid_cli.motion.imu.link_acceleration import log_motion
from seqid_cli.motion.motion import Motion
from seqid_cli.params.schema import ImuStage, MotionUse
from seqid_cli.robot.types import Robot
from seqid_cli.typing import Array


def motion_use(path: Path, robot: Robot, motion: Motion) -> MotionUse:
    """Describe the motion of one log."""
    own = motion.acceleration_error
    before = own if motion.encoder_error is None else motion.encoder_error
    moving = np.flatnonzero(motion.moving.any(axis=0))

    def of_joints(values: Array) -> dict[str, float]:
        return {robot.joint_names[j]: float(values[j]) for j in moving}

    return MotionUse(
        log=str(path),
        source=motion.source,
        imus=list(motion.imus),
        cutoff_hz=float(motion.cutoff.hz),
        acceleration_error=of_joints(own),
        encoder_error=of_joints(before),
        warnings=list(motion.warnings),
    )


def source_text(use: MotionUse) -> str:
    """The source with the IMUs that took part: "encoder", "fused: imu_a, imu_b"."""
    return f"{use.source}: {', '.join(use.imus)}" if use.imus else use.source


def motion_uses(
    recordings: Iterable[Recording], robot: Robot, imu: ImuStage | None, *, options: InertiaOptions
) -> list[MotionUse]:
    """Describe the motion that commands with these options take from logs.

    Logs from which they can take none are left out; that is for those commands to complain about.
    """
    uses = []
    for recording in recordings:
        with contextlib.suppress(InputError):
            motion = log_motion(recording, robot, options.motion, imu=imu, source=options.source)
            uses.append(motion_use(recording.path, robot, motion))
    return uses
