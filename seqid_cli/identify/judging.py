"""Checks on results: what no arm can be, and whether stages agree.

A stage's own verdicts judge its fit. Here its result is held against physics and
against the stages before: friction takes energy away, the inertia that a drive feels is
positive, gravity is the same wherever it shows, and its size is of the order of the
URDF's. The logs' own errors (`seqid inspect`) join in, and a stage is good as a whole
only if all of it is.
"""

from collections.abc import Iterator, Sequence

import numpy as np
from msgspec.structs import replace

from seqid_cli.identify.regression.noise_level import postures
from seqid_cli.identify.settings import JudgingSettings
from seqid_cli.model.friction import FrictionSurface
from seqid_cli.model.torque import standard_parameters
from seqid_cli.params import schema
from seqid_cli.params.document import worst_level
from seqid_cli.robot.base_parameters import free_basis, standard_regressor
from seqid_cli.robot.kinematics import gravity_columns
from seqid_cli.robot.regressor import inverse_dynamics
from seqid_cli.robot.types import Robot
from seqid_cli.robust import rms
from seqid_cli.shares import percent
from seqid_cli.typing import Array

# How many positions and speeds of a friction surface, and postures of the arm, are
# looked at.
POSITIONS, SPEEDS, POSTURES = 33, 9, 60
Stage = schema.FrictionStage | schema.RigidStage | schema.ImuStage


def judged(
    new: schema.Stages,
    before: schema.Stages,
    robot: Robot,
    of_logs: Sequence[schema.Verdict] = (),
    *,
    limits: JudgingSettings = JudgingSettings(),
) -> schema.Stages:
    """Add to new stages the verdicts by physics, by `of_logs`, and of the whole."""
    known = schema.Stages(
        friction=new.friction or before.friction,
        gravity=new.gravity or before.gravity,
    )
    stages = {}
    for name in ("friction", "gravity", "imu", "inertia"):
        stage = getattr(new, name)
        if stage is not None:
            verdicts = [
                *stage.verdicts,
                *_physics(stage, known, robot, limits),
                *of_logs,
                *_inherited(name, known),
            ]
            stages[name] = replace(stage, verdicts=as_a_whole(verdicts))
    return replace(new, **stages)


RESTS_ON = {"gravity": ("friction",), "inertia": ("friction", "gravity")}


def _inherited(name: str, known: schema.Stages) -> Iterator[schema.Verdict]:
    """Yield that a stage is at most usable where one that it rests on is not good."""
    for earlier in RESTS_ON.get(name, ()):
        stage = getattr(known, earlier)
        level = worst_level(stage.verdicts) if stage is not None else None
        if level is None or level == "good":
            continue
        reason = f"rests on the {earlier} stage, which is {level}"
        yield schema.Verdict(good=False, level="usable", reason=reason)


def physics_verdicts(
    stages: schema.Stages, robot: Robot, limits: JudgingSettings = JudgingSettings()
) -> list[schema.Verdict]:
    """Judge stages that a command builds on, as `judged` does, whatever the logs."""
    # By the robot as it is now: its gear ratios or gravity may not be those of the
    # identification. Each reason comes once per joint.
    there = (stages.friction, stages.gravity, stages.inertia)
    found = [
        verdict
        for stage in there
        if stage is not None
        for verdict in _physics(stage, stages, robot, limits)
    ]
    return list({(v.joint, v.reason): v for v in found}.values())


def as_a_whole(verdicts: Sequence[schema.Verdict]) -> list[schema.Verdict]:
    """Return verdicts with one of the whole, no better than any joint's.

    The verdict of the whole has an empty joint.
    """
    of_joints = [verdict for verdict in verdicts if verdict.joint]
    of_whole = [verdict for verdict in verdicts if not verdict.joint]
    level = worst_level(verdicts)
    if level is None or level == "good" or level == worst_level(of_whole):
        return list(verdicts)

    names = list(
        dict.fromkeys(verdict.joint for verdict in of_joints if not verdict.good)
    )
    reason = "; ".join([*(v.reason for v in of_whole), f"not good: {', '.join(names)}"])
    return [*of_joints, schema.Verdict(good=False, level=level, reason=reason)]


def _physics(
    stage: Stage, known: schema.Stages, robot: Robot, limits: JudgingSettings
) -> Iterator[schema.Verdict]:
    if isinstance(stage, schema.FrictionStage):
        yield from friction_verdicts(stage, robot, limits)
    elif isinstance(stage, schema.RigidStage) and stage.parameters:
        q = postures(robot, count=POSTURES)
        gravity = _gravity(robot, stage, q)
        samples = {j: (q, gravity[:, j]) for j in range(robot.n)}
        if stage is not known.gravity:
            yield from inertia_verdicts(stage, robot, limits)
            if known.gravity is not None and known.gravity.parameters:
                yield from _gravity_verdicts(
                    samples, robot, known.gravity, IN_LOGS, limits
                )
        elif known.friction is not None:
            trials = _measured(known.friction, robot)
            yield from _gravity_verdicts(trials, robot, stage, IN_TRIALS, limits)
        yield from _gravity_verdicts(samples, robot, None, NOT_NOMINAL, limits)


def friction_verdicts(
    stage: schema.FrictionStage,
    robot: Robot,
    limits: JudgingSettings = JudgingSettings(),
) -> Iterator[schema.Verdict]:
    """Judge whether friction brakes, and whether gravity is of the URDF's size."""
    for name, joint in stage.joints.items():
        surface = FrictionSurface.from_stage(joint)
        low, high = joint.speed_range
        speeds = np.array(
            [level.speed for level in joint.speeds if level.speed > joint.sign_width]
            or [high]
        )
        if joint.parameters:  # a law over speed, of one level alone
            speeds = np.linspace(max(low, 3.0 * joint.sign_width), high, SPEEDS)
        first, last = joint.position_range
        positions = np.linspace(first, last, POSITIONS)
        grid_q, grid_v = np.meshgrid(positions, speeds)
        q = grid_q.ravel()
        v = grid_v.ravel()

        # The mean of both directions: what is the same in both is an offset and takes
        # no energy.
        value = 0.5 * (surface.torque(q, v) - surface.torque(q, -v))
        error = 0.5 * (surface.std_error(q, v) + surface.std_error(q, -v))
        is_clear = value < -limits.clear_sigma * error
        drives = is_clear & (value < -limits.driving_share * rms(value))
        if np.mean(drives) > limits.driving_cells:
            worst = int(np.argmin(np.where(drives, value, np.inf)))
            reason = (
                f"its friction is {value[worst]:.3g} +- {error[worst]:.2g} {joint.unit}"
                f" at {v[worst]:.3g} per second: it would drive the joint. The sign of"
                " torque or current is wrong, or it is another joint's"
            )
            yield schema.Verdict(joint=name, good=False, reason=reason)
    yield from _gravity_verdicts(
        _measured(stage, robot), robot, None, NOT_NOMINAL, limits
    )


# joint: postures (N, n), gravity torque of it (N,)
Samples = dict[int, tuple[Array, Array]]


def _measured(stage: schema.FrictionStage, robot: Robot) -> Samples:
    """Return the gravity torque by Eq. 12-14 in the postures of the friction trials."""
    samples: Samples = {}
    for j, name in enumerate(robot.joint_names):
        joint = stage.joints.get(name)
        groups = [group for group in joint.gravity if group.p_xi] if joint else []
        if joint is None or not groups:
            continue
        first, last = joint.position_range
        q = np.linspace(first, last, POSITIONS)
        places = [np.array(group.configuration) for group in groups]
        torques = [
            gravity_columns(robot, j, place, q) @ np.array(group.p_xi)
            for place, group in zip(places, groups, strict=True)
        ]
        postures = np.repeat(places, len(q), axis=0)
        postures[:, j] = np.tile(q, len(groups))
        samples[j] = (postures, np.concatenate(torques))
    return samples


def _gravity(robot: Robot, stage: schema.RigidStage | None, q: Array) -> Array:
    """Return gravity's torque (N, n) N m by a stage, or by URDF inertials for None."""
    phi = robot.nominal if stage is None else standard_parameters(stage, robot.n)[0]
    assert phi is not None
    still = np.zeros_like(q)
    return np.asarray(
        inverse_dynamics(robot.chain, robot.gravity, phi, q, still, still)
    )


IN_TRIALS = (
    "gravity in the friction trials (Eq. 12-15) is not that of the parameters: {} are"
    " left, it is {:.2g} times that. Check unit and sign of the torque, the direction"
    " of gravity and the order of the joints"
)
IN_LOGS = (
    "gravity in these logs differs from the gravity stage's by {} of it, it is {:.2g}"
    " times that. Check that the logs are of one robot, in one unit and with the joints"
    " in order"
)
NOT_NOMINAL = (
    "gravity is not that of the URDF's inertials: {} are left, it is {:.2g} times that."
    " Check unit and sign of the torque, torque_constant and gear_ratio, the direction"
    " of gravity in the robot file, and axes, zeros and order of the joints"
)


def _gravity_verdicts(
    samples: Samples,
    robot: Robot,
    stage: schema.RigidStage | None,
    text: str,
    limits: JudgingSettings,
) -> Iterator[schema.Verdict]:
    """Judge gravity by another stage's or by the URDF's; `text` says how it differs."""
    if not samples or (stage is None and robot.nominal is None):
        return
    largest = float(
        np.abs(_gravity(robot, stage, postures(robot, count=POSTURES))).max()
    )
    for j, (q, torque) in samples.items():
        expected = _gravity(robot, stage, q)[:, j]
        expected_rms = rms(expected)
        if expected_rms < max(limits.min_gravity_torque, limits.light_share * largest):
            continue
        off = rms(torque - expected) / expected_rms
        size = rms(torque) / expected_rms
        ratio = float(torque @ expected) / float(expected @ expected)
        differs = off > limits.max_gravity_difference
        if stage is None:
            largest_factor = limits.max_gravity_factor
            differs = not 1.0 / largest_factor < size < largest_factor
            differs |= ratio < limits.min_gravity_correlation * size
        if differs:
            reason = text.format(percent(off, 0), ratio)
            yield schema.Verdict(joint=robot.joint_names[j], good=False, reason=reason)


def inertia_verdicts(
    stage: schema.RigidStage, robot: Robot, limits: JudgingSettings = JudgingSettings()
) -> Iterator[schema.Verdict]:
    """Judge whether rotors and the inertia that each drive feels are positive."""
    for p in stage.parameters:
        is_rotor = p.terms and all(
            factor > 0.0 and name.startswith("Ia_") for name, factor in p.terms.items()
        )
        if is_rotor and p.value < -limits.clear_sigma * p.std_error:
            reason = (
                f"{p.name} is {p.value:.3g} +- {p.std_error:.2g}: a rotor cannot have"
                " negative inertia"
            )
            yield schema.Verdict(joint=p.joint, good=False, reason=reason)

    # The inertia M_jj that joint j's drive feels, by the stage's parameters and their
    # errors.
    basis = free_basis(robot)
    places = [
        basis.names.index(p.name) for p in stage.parameters if p.name in basis.names
    ]
    count = len(stage.parameters)
    if len(places) != count or np.shape(stage.covariance) != (count, count):
        return
    links, rotors = standard_parameters(stage, robot.n)
    standard = np.concatenate([links.ravel(), rotors])
    q = postures(robot, count=POSTURES)
    still = np.zeros_like(q)
    at_rest = standard_regressor(robot, q, still, still, coupling="diagonal")
    for j, name in enumerate(robot.joint_names):
        if stage.rmse and name not in stage.rmse:
            continue
        ddq = np.zeros_like(q)
        ddq[:, j] = 1.0
        pushed = standard_regressor(robot, q, still, ddq, coupling="diagonal")
        H = pushed[:, j] - at_rest[:, j]
        inertia = H @ standard
        columns = H @ basis.representative[:, places]
        variance = np.sum((columns @ np.array(stage.covariance)) * columns, axis=1)
        error = limits.clear_sigma * np.sqrt(np.maximum(variance, 0.0))
        worst = int(np.argmax(inertia + error))
        if inertia[worst] < -error[worst]:  # in every posture
            reason = (
                f"the inertia that its drive feels is at most {inertia[worst]:.3g} +-"
                f" {error[worst] / limits.clear_sigma:.2g}: it cannot be negative."
                " Check sign and unit of the torque, torque_constant, gear_ratio and"
                " rotor_inertia"
            )
            yield schema.Verdict(joint=name, good=False, reason=reason)
