"""What a file absorbs of an effect is what stages identified with it have more."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cache

import numpy as np
import pytest

from seqid_cli.discover.absorbed import FileTrials, _steady
from seqid_cli.discover.base import surface_columns
from seqid_cli.discover.scenes import scenes_of
from seqid_cli.discover.select.model import SelectionProblem
from seqid_cli.discover.select.smooth import SmoothFunction
from seqid_cli.discover.select.terms import smooth_term
from seqid_cli.discover.survey.rows import rows_of
from seqid_cli.effects import measurement
from seqid_cli.effects.measurement import steady_change
from seqid_cli.effects.registry import CATALOGUE
from seqid_cli.identify.friction_surface.stage import identify_friction
from seqid_cli.identify.nuisances import term_of
from seqid_cli.identify.options import FrictionOptions, InertiaOptions
from seqid_cli.identify.rigid.gravity import identify_gravity
from seqid_cli.logs.read import read_recording
from seqid_cli.logs.recording import Recording
from seqid_cli.model.friction import FrictionLaw
from seqid_cli.model.torque import sampled_friction
from seqid_cli.motion.motion import Motion
from seqid_cli.params.schema import FrictionJoint, Stages
from seqid_cli.robot.base_parameters import base_regressor, free_basis
from seqid_cli.robot.file import load_robot
from seqid_cli.robot.types import Robot
from tests import ROOT, Array
from tests.unit.discover.arms import (
    arm_scenes,
    at_joint,
    drag,
    ground_of,
    selected,
)

SAMPLES = ROOT / "sample_logs"
ORDERS = FrictionOptions(position_order=4, velocity_order=3)
SLOWEST, FASTEST = 0.4, 3.0  # rad/s, between the trials' slowest and fastest
ONE, LIFT = ("one_joint", "joint_1"), ("six_joint", "shoulder_lift")
# Stage; sample robot and joint; settings; coefficients; how well friction is known.
# Gravity is known as well as its stage says.
EFFECTS = {
    "stribeck": (
        "friction",
        ONE,
        {"stribeck_speed": 0.6, "exponent": 2.0},
        (0.01,),
        0.05,
    ),
    "nonlinear_viscous": ("friction", ONE, {"exponent": 0.5}, (0.01,), 0.05),
    "load_dependent_friction": ("friction", ONE, {}, (0.1,), 0.05),
    "gear_efficiency": ("gravity", LIFT, {}, (0.02, 0.06), None),
}


@dataclass(frozen=True)
class SampleArm:
    """Logs of one joint of a sample robot, and the stages identified from them."""

    robot: Robot
    logs: list[Recording]
    stages: Stages


@cache
def sample_arm(sample: str, joint: str) -> SampleArm:
    robot = load_robot(SAMPLES / sample / "robot.toml")
    paths = (
        SAMPLES / sample / f"{folder}/{joint}.parquet"
        for folder in ("friction", "gravity")
    )
    logs = [read_recording(path, robot) for path in paths]
    return SampleArm(robot, logs, stages_of(*logs, robot))


@pytest.mark.slow
@pytest.mark.parametrize("name", EFFECTS)
def test_a_stage_identified_with_an_effect_has_more_by_what_is_absorbed(
    name: str,
) -> None:
    stage, (sample, own), settings, size, known = EFFECTS[name]
    arm = sample_arm(sample, own)
    robot, logs, without = arm.robot, arm.logs, arm.stages
    j = robot.joint_names.index(own)
    scenes, changed = scenes_of(logs, robot, without, options=InertiaOptions()), []
    for log, scene in zip(logs, scenes, strict=True):
        torque = CATALOGUE[name].columns(scene.full or scene, j, settings)[j] @ size
        changed.append(replace(log, tau=log.tau + np.outer(torque, np.eye(robot.n)[j])))
    with_it = stages_of(*changed, robot)

    (scene,) = scenes_of(logs[:1], robot, without, options=InertiaOptions())
    ground = SelectionProblem.of(rows_of([scene]), without)
    trials = FileTrials(ground.stage.scenes[0], ground.base, without)
    taken = trials.absorbed(
        j, lambda scene: CATALOGUE[name].steady_columns(scene, j, settings)
    )
    if stage == "friction":
        speed = np.abs(scene.motion.dq[:, j])
        columns = surface_columns(scene, j)[(speed > SLOWEST) & (speed < FASTEST)]
        old, new = (entries_of(x.friction.joints[own]) for x in (without, with_it))
        said, more = taken[1 + j] @ size, new - old
    else:
        basis, q = free_basis(robot), changed[0].q
        columns = base_regressor(robot, basis, q, 0.0 * q, 0.0 * q)[:, j]
        said, more = taken[0] @ size, np.zeros(basis.size)
        for one, sign in ((with_it, 1.0), (without, -1.0)):
            for parameter in one.gravity.parameters:
                more[basis.names.index(parameter.name)] += sign * parameter.value
    found = columns @ more
    assert np.std(found) > 0.0
    if known is None:
        # What offset and asymmetry take of it is decided by their priors, within stated
        # errors.
        of_gravity = [basis.names.index(p.name) for p in with_it.gravity.parameters]
        covariance = np.array(with_it.gravity.covariance)
        own_columns = columns[:, of_gravity]
        variance = np.einsum("ni,ij,nj->n", own_columns, covariance, own_columns)
        bound = float(np.sqrt(variance.sum()))
        assert bound < 0.3 * np.linalg.norm(found)
    else:
        bound = known * np.linalg.norm(found)
    assert np.linalg.norm(columns @ said - found) < bound


@pytest.mark.slow
def test_a_skew_is_in_the_delay_of_the_stage() -> None:
    """Torque that comes late is no friction: the drive's delay takes it."""
    seconds = 0.005
    sample, own = LIFT
    arm = sample_arm(sample, own)
    j = arm.robot.joint_names.index(own)
    late = []
    for log in arm.logs:
        torque = log.tau.copy()
        torque[:, j] = np.interp(log.t - seconds, log.t, log.tau[:, j])
        late.append(replace(log, tau=torque))
    before, after = (
        term_of(stages.friction.joints[own], "delay")
        for stages in (arm.stages, stages_of(*late, arm.robot))
    )
    found = after.value - before.value
    assert found > 0.4 * seconds
    assert abs(seconds - found) < 2.0 * after.std_error


def entries_of(joint: FrictionJoint) -> Array:
    """Entries of the surfaces of both directions, one after the other."""
    return np.concatenate([np.ravel(joint.positive), np.ravel(joint.negative)])


def stages_of(trial: Recording, other: Recording, robot: Robot) -> Stages:
    stages = Stages(friction=identify_friction([trial], robot, options=ORDERS))
    result = identify_gravity([other, trial], robot, stages)
    stages.gravity, stages.friction = result.gravity, result.friction
    return stages


def test_a_steady_change_asks_for_friction_of_its_own_joints_alone(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    (scene,) = arm_scenes(logs=1, seconds=8.0)
    whole = steady_change(scene, None)
    asked: list[list[int]] = []

    def counted(surfaces: Sequence[FrictionLaw | None], motion: Motion) -> Array:
        joints = [j for j, surface in enumerate(surfaces) if surface is not None]
        asked.append(joints)
        return sampled_friction(surfaces, motion)

    monkeypatch.setattr(measurement, "sampled_friction", counted)
    of_joint = steady_change(scene, 1)
    assert asked == [[1]]
    assert [*of_joint] == [1]
    np.testing.assert_array_equal(of_joint[1], whole[1])


def test_a_file_without_trials_has_absorbed_nothing() -> None:
    found = selected(arm_scenes(at_joint(0, drag)), ["quadratic_drag"])
    assert [one.term.what.absorbed for one in found.terms] == [""]


@pytest.mark.slow
def test_the_file_has_a_smooth_function_of_the_load_as_friction() -> None:
    sample, own = ONE
    arm = sample_arm(sample, own)
    j = arm.robot.joint_names.index(own)
    scenes = scenes_of(arm.logs, arm.robot, arm.stages, options=InertiaOptions())
    ground = SelectionProblem.of(rows_of(scenes), arm.stages)
    labels = {term.name: term.what for term in ground.smooth_terms(j)}
    function = labels["load x direction"]
    assert isinstance(function, SmoothFunction)

    # A constant is Coulomb friction: what bends is the load's.
    size = np.zeros(function.size)
    size[1:4] = (0.03, 0.01, -0.01)
    changed = []
    for log, scene in zip(arm.logs, scenes, strict=True):
        torque = function.steady_columns(scene.full or scene)[j] @ size
        changed.append(
            replace(log, tau=log.tau + np.outer(torque, np.eye(arm.robot.n)[j]))
        )
    with_it = stages_of(*changed, arm.robot)

    (term,) = ground.absorbed_terms([smooth_term(ground.stage, function, ground.size)])
    said = term.part.absorbed_by_file[1 + j] @ size
    before, after = (
        entries_of(stages.friction.joints[own]) for stages in (arm.stages, with_it)
    )
    speed = np.abs(scenes[0].motion.dq[:, j])
    is_steady = (speed > SLOWEST) & (speed < FASTEST)
    columns = surface_columns(scenes[0], j)[is_steady]
    found = columns @ (after - before)
    assert np.std(found) > 0.0
    assert np.linalg.norm(columns @ said - found) < 0.05 * np.linalg.norm(found)


def test_what_steady_motion_does_not_show_is_in_no_file() -> None:
    ground = ground_of(arm_scenes())
    accelerating = [
        term for term in ground.smooth_terms(0) if term.name == "acceleration"
    ]
    assert accelerating
    assert ground.absorbed_terms(accelerating) == []


def test_trials_know_no_temperature_of_the_logs() -> None:
    """Logs carry temperatures, on which friction depends: trials have their own."""
    sample, own = ONE
    arm = sample_arm(sample, own)
    (scene,) = scenes_of(arm.logs[:1], arm.robot, arm.stages, options=InertiaOptions())
    j = arm.robot.joint_names.index(own)
    surface = scene.model.surfaces[j]
    assert surface is not None
    surfaces = list(scene.model.surfaces)
    surfaces[j] = replace(surface, per_kelvin=-0.01, temperature=25.0)
    celsius = np.full(scene.motion.q.shape, 45.0)
    warm = replace(
        scene,
        model=replace(scene.model, surfaces=surfaces),
        motion=replace(scene.motion, celsius=celsius),
    )
    effect = CATALOGUE["torque_saturation"]
    (columns,) = effect.steady_columns(_steady(warm, j), j, {"around": 0.0}).values()
    (cold,) = effect.steady_columns(_steady(scene, j), j, {"around": 0.0}).values()
    np.testing.assert_array_equal(columns, cold)
