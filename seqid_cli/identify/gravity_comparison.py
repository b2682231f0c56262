"""Gravity held against gravity: of stages, of friction's trials, and of the URDF.

Gravity is the same wherever it shows, so what one stage reads must be what another says
in the same postures, and its size must be of the order of the URDF's. The checks of
friction, gravity and inertia each hold what they have against what was there before.
"""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass

import numpy as np

from seqid_cli.identify.regression.noise_level import postures
from seqid_cli.identify.settings import JudgingSettings
from seqid_cli.model.torque import standard_parameters
from seqid_cli.params.schema import FrictionStage, RigidStage, Verdict
from seqid_cli.robot.kinematics import gravity_columns
from seqid_cli.robot.regressor import inverse_dynamics
from seqid_cli.robot.types import Robot
from seqid_cli.robust import rms
from seqid_cli.shares import percent
from seqid_cli.typing import Array

# How many postures of the arm, and positions of a joint in its trials, are looked at.
POSTURES = 60
POSITIONS = 33

NOT_NOMINAL = (
    "gravity is not that of the URDF's inertials: {} are left, it is {:.2g} times that."
    " Check unit and sign of the torque, torque_constant and gear_ratio, the direction"
    " of gravity in the robot file, and axes, zeros and order of the joints"
)


@dataclass(frozen=True, kw_only=True)
class GravityTorque:
    """Gravity's torque (N,) N m at one joint, in postures (N, n) of the arm."""

    postures: Array
    torque: Array


def gravity_of_trials(stage: FrictionStage, robot: Robot) -> dict[int, GravityTorque]:
    """Return the gravity by Eq. 12-14 in friction's trials, by the joint's number."""
    of_joints: dict[int, GravityTorque] = {}
    for j, name in enumerate(robot.joint_names):
        joint = stage.joints.get(name)
        groups = [group for group in joint.gravity if group.p_xi] if joint else []
        if joint is None or not groups:
            continue
        first, last = joint.position_range
        q = np.linspace(first, last, POSITIONS)
        configurations = [np.array(group.configuration) for group in groups]
        torques = [
            gravity_columns(robot, j, configuration, q) @ np.array(group.p_xi)
            for configuration, group in zip(configurations, groups, strict=True)
        ]
        trial_postures = np.repeat(configurations, len(q), axis=0)
        trial_postures[:, j] = np.tile(q, len(groups))
        of_joints[j] = GravityTorque(
            postures=trial_postures, torque=np.concatenate(torques)
        )
    return of_joints


def gravity_of_stage(stage: RigidStage, robot: Robot) -> dict[int, GravityTorque]:
    """Return the gravity of a stage in some postures, by the joint's number."""
    q = postures(robot, count=POSTURES)
    torque = _gravity(robot, stage, q)
    return {j: GravityTorque(postures=q, torque=torque[:, j]) for j in range(robot.n)}


def verdicts_by_nominal(
    of_joints: Mapping[int, GravityTorque], robot: Robot, settings: JudgingSettings
) -> Iterator[Verdict]:
    """Judge gravity by that of the URDF's inertials, where the URDF has any.

    Inertials of a URDF are rough: only another size or another shape is a fault.
    """
    if robot.nominal is None:
        return
    for j, comparison in _comparisons(of_joints, robot, None, settings):
        largest = settings.max_gravity_factor
        is_of_other_size = not 1.0 / largest < comparison.size < largest
        # The ratio is the size times the correlation of both.
        least_ratio = settings.min_gravity_correlation * comparison.size
        if is_of_other_size or comparison.ratio < least_ratio:
            yield comparison.verdict(robot.joint_names[j], NOT_NOMINAL)


def verdicts_by_stage(
    of_joints: Mapping[int, GravityTorque],
    robot: Robot,
    stage: RigidStage,
    text: str,
    settings: JudgingSettings,
) -> Iterator[Verdict]:
    """Judge gravity by that of a stage.

    Parameters
    ----------
    of_joints : mapping of int to GravityTorque
        What is judged.
    robot : Robot
    stage : RigidStage
        What it is held against.
    text : str
        What to say of a joint, with places for the share that is left and for how many
        times as large gravity is.
    settings : JudgingSettings
    """
    for j, comparison in _comparisons(of_joints, robot, stage, settings):
        if comparison.error > settings.max_gravity_difference:
            yield comparison.verdict(robot.joint_names[j], text)


@dataclass(frozen=True, kw_only=True)
class _Comparison:
    """One joint's gravity beside what it should be.

    `error` is the RMS of the difference and `size` that of the torque, both over the
    RMS of what is expected; `ratio` is by how much the expected torque is to be
    multiplied to come nearest.
    """

    error: float
    size: float
    ratio: float

    def verdict(self, joint: str, text: str) -> Verdict:
        """Return that a joint is poor; `text` is as of `verdicts_by_stage`."""
        reason = text.format(percent(self.error, 0), self.ratio)
        return Verdict(joint=joint, good=False, reason=reason)


def _comparisons(
    of_joints: Mapping[int, GravityTorque],
    robot: Robot,
    stage: RigidStage | None,
    settings: JudgingSettings,
) -> Iterator[tuple[int, _Comparison]]:
    """Yield the joints that carry enough to be compared, each with its comparison."""
    if not of_joints:
        return
    everywhere = _gravity(robot, stage, postures(robot, count=POSTURES))
    largest = float(np.abs(everywhere).max())
    least = max(settings.min_gravity_torque, settings.light_share * largest)
    for j, gravity in of_joints.items():
        expected = _gravity(robot, stage, gravity.postures)[:, j]
        expected_rms = rms(expected)
        if expected_rms < least:
            continue
        yield (
            j,
            _Comparison(
                error=rms(gravity.torque - expected) / expected_rms,
                size=rms(gravity.torque) / expected_rms,
                ratio=float(gravity.torque @ expected) / float(expected @ expected),
            ),
        )


def _gravity(robot: Robot, stage: RigidStage | None, q: Array) -> Array:
    """Return gravity's torque (N, n) N m by a stage, or by URDF inertials for None."""
    phi = robot.nominal if stage is None else standard_parameters(stage, robot.n)[0]
    assert phi is not None
    still = np.zeros_like(q)
    return np.asarray(
        inverse_dynamics(robot.chain, robot.gravity, phi, q, still, still)
    )
