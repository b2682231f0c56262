"""The stages in their order on one experiment,
and what they predict of logs not seen.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from msgspec.structs import replace

from seqid_cli.identify.friction_surface.stage import identify_friction
from seqid_cli.identify.imu_calibration import calibrate_imus
from seqid_cli.identify.options import FrictionOptions, InertiaOptions
from seqid_cli.identify.prediction.predict import predict
from seqid_cli.identify.rigid.gravity import identify_gravity
from seqid_cli.identify.rigid.inertia import identify_inertia
from seqid_cli.identify.rigid.simultaneous import identify_simultaneous
from seqid_cli.logs.recording import Recording
from seqid_cli.motion.filters.butterworth import Lowpass
from seqid_cli.motion.options import MotionOptions
from seqid_cli.params.schema import ImuStage, Stages
from seqid_cli.robot.types import Robot
from tests import Array
from tests.plants.robots.lab import Experiment

Logs = Mapping[str, Sequence[Recording]]  # of each stage


def sequential(logs: Logs, robot: Robot) -> Stages:
    """Friction, gravity, IMUs if there are logs for them, inertia."""
    return with_inertia(logs, robot, before_inertia(logs, robot), InertiaOptions())


def before_inertia(logs: Logs, robot: Robot) -> Stages:
    surface = identify_friction(logs["friction"], robot, options=FrictionOptions())
    slow = [*logs["friction"], *logs.get("gravity", ())]
    result = identify_gravity(slow, robot, Stages(friction=surface))
    return Stages(
        friction=result.friction,
        gravity=result.gravity,
        imu=(
            calibrate_imus(logs["imu"], robot, options=MotionOptions())
            if "imu" in logs
            else None
        ),
    )


def with_inertia(
    logs: Logs, robot: Robot, stages: Stages, options: InertiaOptions
) -> Stages:
    result = identify_inertia(logs["inertia"], robot, stages, options=options)
    return replace(stages, inertia=result.inertia, friction=result.friction)


def simultaneous(
    recordings: Sequence[Recording],
    robot: Robot,
    imu: ImuStage | None = None,
    **own: Any,
) -> Stages:
    """Everything in one least squares, with Coulomb and viscous friction alone (Eq.
    5-6).
    """
    options = MotionOptions(**own)
    friction, inertia = identify_simultaneous(
        recordings, robot, options=options, offset=False
    )
    return Stages(friction=friction, imu=imu, inertia=inertia)


@dataclass(frozen=True)
class HeldOut:
    """Torque RMSE (n,) N m of held-out logs, by all samples and by sliding ones."""

    every: Array
    sliding: Array
    sliding_share: Array
    cutoff_hz: tuple[float, ...]


def held_out(
    recordings: Sequence[Recording],
    robot: Robot,
    stages: Stages,
    options: InertiaOptions,
) -> HeldOut:
    """RMSE over the samples of all logs; at rest of the distance to friction's
    interval.
    """
    predictions = list(predict(recordings, robot, stages, options=options))
    used = sum(int(p.used.sum()) for p in predictions)
    slid = np.sum([p.sliding.sum(axis=0) for p in predictions], axis=0)
    every = np.sum([(p.beyond[p.used] ** 2).sum(axis=0) for p in predictions], axis=0)
    moving = [np.where(p.sliding, p.residual**2, 0.0).sum(axis=0) for p in predictions]
    return HeldOut(
        every=np.sqrt(every / used),
        sliding=np.sqrt(np.sum(moving, axis=0) / np.maximum(slid, 1)),
        sliding_share=slid / used,
        cutoff_hz=tuple(p.cutoff_hz for p in predictions),
    )


def noise_floor(
    experiment: Experiment, stage: str, cutoff_hz: Sequence[float]
) -> Array:
    """RMS (n,) N m that the current's noise leaves after the two low-passes of the
    residual.
    """
    squares, samples = np.zeros(experiment.plant.arm.n), 0
    drive = experiment.plant.torque_per_ampere
    for log, hz in zip(experiment.logs[stage], cutoff_hz, strict=True):
        lowpass = Lowpass(hz, 1.0 / float(log.t[1] - log.t[0]))
        left = lowpass(lowpass(log.current * drive - log.truth.tau))
        inner = left[2 * lowpass.settling : len(left) - 2 * lowpass.settling]
        squares += np.sum(inner**2, axis=0)
        samples += len(inner)
    return np.asarray(np.sqrt(squares / samples))
