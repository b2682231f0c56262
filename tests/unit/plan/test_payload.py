"""The plan of a payload: predicted errors hold on a plant, the load counts in the torque."""

from dataclasses import replace

import numpy as np
import pytest

from seqid_cli.params.schema import Stages
from seqid_cli.plan.belief import belief_of, typical
from seqid_cli.plan.limits import limits_of
from seqid_cli.plan.options import PlanOptions
from seqid_cli.plan.stages.payload import loaded, plan_payload
from tests.plants.robots.sample import sample_robot
from tests.plants.robots.stages import friction_stage, inertia_stage

OPTIONS = PlanOptions(duration_s=20.0, move_s=5.0, pool=40, sweeps=1)


@pytest.mark.slow
def test_all_ten_parameters_are_found_on_six_joints() -> None:
    robot = sample_robot("six_joint")
    assert robot.nominal is not None
    stages = Stages(friction=friction_stage(robot), inertia=inertia_stage(robot, robot.nominal))
    belief = belief_of(robot, stages, limits_of(robot, ramp_s=0.3))
    planned = plan_payload(belief, stages, OPTIONS)
    assert planned.stage.rank == planned.stage.structural_rank == 10
    errors = {p.name: p.std_error for p in planned.stage.parameters}
    assert len(errors) == 10
    longer = plan_payload(
        belief, stages, PlanOptions(duration_s=40.0, move_s=5.0, pool=40, sweeps=1)
    )
    after = {p.name: p.std_error for p in longer.stage.parameters}
    assert np.median([after[name] / errors[name] for name in errors]) < 0.95


def test_the_load_counts_in_the_torque() -> None:
    robot = sample_robot("six_joint")
    belief = belief_of(robot, Stages(), limits_of(robot, ramp_s=0.3))
    moves = typical(belief, seed=0)
    plain, heavy = (loaded(belief, mass).torque(moves, belief.regressor(moves)) for mass in (0, 5))
    assert np.all(heavy[:, :, 1:3].max(axis=(0, 1)) > plain[:, :, 1:3].max(axis=(0, 1)))


def test_a_planar_arm_names_what_stays_open() -> None:
    robot = sample_robot("two_joint")
    phi = np.tile([1.0, 0.1, 0.0, 0.0, 0.02, 0.0, 0.02, 0.0, 0.0, 0.02], (2, 1))
    stages = Stages(inertia=inertia_stage(robot, phi))
    stage = plan_payload(
        belief_of(robot, stages, limits_of(robot, ramp_s=0.3)), stages, OPTIONS
    ).stage
    assert stage.rank == stage.structural_rank == 4
    assert set(stage.not_excited) >= {"payload_mz", "payload_Ixx"}
    assert {p.name for p in stage.parameters} == {f"payload_{k}" for k in ("m", "mx", "my", "Izz")}


def test_predicted_errors_follow_the_noise() -> None:
    robot = sample_robot("two_joint")
    phi = np.tile([1.0, 0.1, 0.0, 0.0, 0.02, 0.0, 0.02, 0.0, 0.0, 0.02], (2, 1))
    stages = Stages(inertia=inertia_stage(robot, phi, error=1e-9))
    belief = belief_of(robot, stages, limits_of(robot, ramp_s=0.3))
    noisy = replace(belief, density=belief.density / 4.0)
    ratio = [
        b.std_error / a.std_error
        for a, b in zip(
            plan_payload(belief, stages, OPTIONS).stage.parameters,
            plan_payload(noisy, stages, OPTIONS).stage.parameters,
            strict=True,
        )
    ]
    assert ratio == pytest.approx([2.0] * 4, rel=0.02)
