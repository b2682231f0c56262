"""Whether rotors react on the links that carry them is told from the data."""

from dataclasses import replace

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
    """Two joints whose axes stand at the angle `alpha`; light links, heavy rotors, no
    friction.
    """
    links = [
        standard_parameters(2.0, (0.03, 0.01, -0.05), (0.08, 0.07, 0.09), np.eye(3)),
        standard_parameters(1.5, (0.15, 0.02, 0.03), (0.05, 0.1, 0.1), np.eye(3)),
    ]
    arm = Arm(
        names=("base", "swing"),
        dh=np.array([[0.0, 0.0, 0.2, 0.0], [alpha, 0.1, 0.1, 0.0]]),
        phi=np.array(links),
        gravity=np.array([0.0, 0.0, -9.81]),
        gear=np.full(2, 50.0),
        rotor_inertia=np.array([1e-4, 4e-4]),
        rotor_coupling=coupled,
    )
    return Plant(
        arm=arm,
        nominal=arm,
        friction=Frictionless(),
        gains=gains_for(np.array([0.5, 1.2]), bandwidth=20.0, observer=150.0),
        torque_constant=np.full(2, 0.1),
        encoder_step=np.full(2, 2 * np.pi / 2**18),
        current_noise=np.full(2, 0.02),
        coulomb_guess=np.zeros(2),
        position_limits=np.tile([-2.5, 2.5], (2, 1)),
        velocity_limits=np.full(2, 4.0),
        acceleration_limits=np.full(2, 20.0),
    )


def identified(
    plant: Plant, robot: Robot, seed: int = 0, logs: int | None = None
) -> RigidStage:
    trials = inertia_trials(
        plant, [np.array([0.2, 0.4])], np.random.default_rng(seed), seconds=6.0
    )
    seen = [
        (trial.name, simulate(plant, trial.reference, seed, every=4))
        for trial in trials[:logs]
    ]
    recordings = [recording_of(plant, *each) for each in seen]
    none = friction_joint(
        [[0.0]], speed_range=[0.05, 5.0], sign_width=0.005, covariance=[[1e-12]]
    )
    friction = FrictionStage(joints=dict.fromkeys(robot.joint_names, none))
    options = InertiaOptions()
    stages = Stages(friction=friction)
    return identify_inertia(recordings, robot, stages, options=options).inertia


def off(plant: Plant, stage: RigidStage) -> float:
    standard = true_standard(plant)
    return max(
        abs(p.value - true_value(p.terms, standard)) / p.std_error
        for p in stage.parameters
    )


@pytest.mark.slow
@pytest.mark.parametrize(
    ("axes", "coupled", "seen"),
    [
        *(
            (axes, real, real)
            for axes in ("skew", "parallel")
            for real in (False, True)
        ),
        # The second rotor's spin has no part along the first axis: both models are the
        # same.
        ("perpendicular", True, False),
    ],
)
def test_the_coupling_is_chosen_rightly(axes: str, coupled: bool, seen: bool) -> None:
    plant = plant_of(AXES[axes], coupled=coupled)
    stage = identified(plant, robot_of("two_axes", plant))
    assert stage.rotor_coupling == ("gyroscopic" if seen else "diagonal")
    assert any("rotors coupled" in note for note in stage.notes) == seen
    if axes != "parallel":
        assert stage.rank == stage.structural_rank
        assert off(plant, stage) < 4


def test_unknown_rotors_are_identified_with_the_links() -> None:
    plant = plant_of(AXES["perpendicular"], coupled=False)
    robot = robot_of("two_axes", plant)
    joints = tuple(replace(joint, rotor_inertia=None) for joint in robot.joints)
    stage = identified(plant, replace(robot, joints=joints), 1, logs=1)
    assert stage.rank == stage.structural_rank
    assert any(name.startswith("Ia_") for p in stage.parameters for name in p.terms)
    assert off(plant, stage) < 4
