"""Whether rotors react on the links that carry them is told from the data."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from seqid_cli.identify.options import InertiaOptions
from seqid_cli.identify.rigid.inertia import identify_inertia
from seqid_cli.params.schema import FrictionStage, RigidStage, Stages
from seqid_cli.robot.types import Robot
from tests.plants.arms.rigs import standard_parameters
from tests.plants.controller import gains_for
from tests.plants.friction.surface import Frictionless
from tests.plants.mechanics.rigid import Arm
from tests.plants.motions.experiments import inertia_trials
from tests.plants.robots.lab import recording_of, robot_of, true_standard, true_value
from tests.plants.robots.made import friction_joint
from tests.plants.simulate import Plant, simulate

AXES = {"perpendicular": np.pi / 2, "parallel": 0.0, "skew": 0.7}


def plant_of(alpha: float, *, coupled: bool) -> Plant:
    """Two joints whose axes stand at the angle `alpha`; light links, heavy rotors, no friction."""
    arm = Arm(
        names=("base", "swing"),
        dh=np.array([[0.0, 0.0, 0.2, 0.0], [alpha, 0.1, 0.1, 0.0]]),
        phi=np.array(
            [
                standard_parameters(2.0, (0.03, 0.01, -0.05), (0.08, 0.07, 0.09), np.eye(3)),
                standard_parameters(1.5, (0.15, 0.02, 0.03), (0.05, 0.1, 0.1), np.eye(3)),
            ]
        ),
        gravity=np.array([0.0, 0.0, -9.81]),
        gear=np.full(2, 50.0),
        rotor_inertia=np.array([1e-4, 4e-4]),
        rotor_coupling=coupled,
    )
    zero = np.zeros(2)
    return Plant(
        arm=arm,
        nominal=arm,
        friction=Frictionless(),
        gains=gains_for(np.array([0.5, 1.2]), bandwidth=20.0, observer=150.0),
        torque_constant=np.full(2, 0.1),
        encoder_step=np.full(2, 2 * np.pi / 2**18),
        current_noise=np.full(2, 0.02),
        coulomb_guess=zero,
        position_limits=np.array([[-2.5, 2.5], [-2.5, 2.5]]),
        velocity_limits=np.full(2, 4.0),
        acceleration_limits=np.full(2, 20.0),
    )


def no_friction(robot: Robot) -> FrictionStage:
    joint = friction_joint([[0.0]], speed_range=[0.05, 5.0], sign_width=0.005, covariance=[[1e-12]])
    return FrictionStage(joints=dict.fromkeys(robot.joint_names, joint))


@cache
def identified(alpha: float, *, coupled: bool, seed: int = 0) -> tuple[Plant, RigidStage]:
    plant = plant_of(alpha, coupled=coupled)
    robot = robot_of("two_axes", plant)
    postures = [np.array([0.2, 0.4])]
    trials = inertia_trials(plant, postures, np.random.default_rng(seed), seconds=6.0)
    logs = [
        recording_of(plant, trial.name, simulate(plant, trial.reference, seed, every=4))
        for trial in trials
    ]
    stages = Stages(friction=no_friction(robot))
    return plant, identify_inertia(logs, robot, stages, options=InertiaOptions())


@pytest.mark.slow
@pytest.mark.parametrize("axes", ["skew", "parallel"])
@pytest.mark.parametrize("coupled", [False, True])
def test_the_coupling_is_chosen_rightly(axes: str, coupled: bool) -> None:
    _, stage = identified(AXES[axes], coupled=coupled)
    assert stage.rotor_coupling == ("gyroscopic" if coupled else "diagonal")
    assert any("rotors coupled" in note for note in stage.notes) == coupled


@pytest.mark.slow
def test_axes_at_right_angles_cannot_show_it_and_stay_diagonal() -> None:
    """The second rotor's spin has no part along the first axis: both models are the same."""
    plant, stage = identified(AXES["perpendicular"], coupled=True)
    assert stage.rotor_coupling == "diagonal"
    standard = true_standard(plant)
    off = [(p.value - true_value(p.terms, standard)) / p.std_error for p in stage.parameters]
    assert np.abs(off).max() < 4


@pytest.mark.slow
@pytest.mark.parametrize("coupled", [False, True])
def test_with_the_right_coupling_the_parameters_are_true(coupled: bool) -> None:
    plant, stage = identified(AXES["skew"], coupled=coupled)
    standard = true_standard(plant)
    assert stage.rank == stage.structural_rank
    off = [(p.value - true_value(p.terms, standard)) / p.std_error for p in stage.parameters]
    assert np.abs(off).max() < 4


def test_unknown_rotors_are_identified_with_the_links() -> None:
    """Without rotor inertias in the robot file they are parameters, and full rank is reached."""
    plant = plant_of(AXES["perpendicular"], coupled=False)
    robot = robot_of("two_axes", plant)
    joints = tuple(replace(joint, rotor_inertia=None) for joint in robot.joints)
    robot = replace(robot, joints=joints)
    trial = inertia_trials(plant, [np.array([0.2, 0.4])], np.random.default_rng(1), seconds=6.0)[0]
    log = recording_of(plant, trial.name, simulate(plant, trial.reference, 1, every=4))
    stages = Stages(friction=no_friction(robot))
    stage = identify_inertia([log], robot, stages, options=InertiaOptions())
    assert stage.rank == stage.structural_rank
    standard = true_standard(plant)
    rotors = [p for p in stage.parameters if any(name.startswith("Ia_") for name in p.terms)]
    assert rotors
    for p in stage.parameters:
        assert abs(p.value - true_value(p.terms, standard)) < 4 * p.std_error, p.name
