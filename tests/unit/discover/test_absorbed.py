"""What friction trials absorb of an effect is what friction identified with it has more."""

from dataclasses import replace

import numpy as np
import pytest

from seqid_cli.discover.absorbed import absorbed, has_trials, surface_columns
from seqid_cli.discover.candidates import Stage
from seqid_cli.discover.scenes import scenes_of
from seqid_cli.discover.select.model import Ground
from seqid_cli.discover.survey.rows import rows_of
from seqid_cli.identify.friction_surface.stage import identify_friction
from seqid_cli.identify.options import FrictionOptions, InertiaOptions
from seqid_cli.identify.rigid.gravity import identify_gravity
from seqid_cli.logs.read import read_recording
from seqid_cli.model.effects.registry import CATALOGUE
from seqid_cli.model.effects.scene import Scene
from seqid_cli.params.schema import Stages
from seqid_cli.robot.file import load_robot
from tests import ROOT, Array
from tests.unit.discover.arms import arm_scenes, candidate

SAMPLES = ROOT / "sample_logs"
ORDERS = FrictionOptions(position_order=4, velocity_order=3)
SLOWEST, FASTEST = 0.4, 3.0  # rad/s, between the trials' slowest and fastest
ONE, LIFT = ("one_joint", "joint_1"), ("six_joint", "shoulder_lift")
EFFECTS = {  # sample robot and joint; settings; coefficient; how well it is known
    "stribeck": (ONE, {"stribeck_speed": 0.6, "exponent": 2.0}, 0.01, 0.05),
    "nonlinear_viscous": (ONE, {"exponent": 0.5}, 0.01, 0.05),
    "load_dependent_friction": (ONE, {}, 0.1, 0.05),
    "actuator_lag": (LIFT, {}, 0.005, 0.15),
    "time_skew": (LIFT, {"around": 0.005}, 0.005, 0.15),
}


@pytest.mark.parametrize("name", EFFECTS)
def test_friction_identified_with_an_effect_has_more_by_what_is_absorbed(name: str) -> None:
    (sample, own), settings, size, known = EFFECTS[name]
    robot, effect = load_robot(SAMPLES / sample / "robot.toml"), CATALOGUE[name]
    j = robot.joint_names.index(own)
    log, other = (
        read_recording(SAMPLES / sample / f"{x}/{own}.parquet", robot)
        for x in ("friction", "gravity")
    )
    without = Stages(friction=identify_friction([log], robot, options=ORDERS))
    without.gravity = identify_gravity([other, log], robot, without)
    (scene,) = scenes_of([log], robot, without, options=InertiaOptions())
    full = scene.full or scene
    tau = log.tau.copy()
    tau[:, j] += size * effect.columns(full, j, settings)[j][:, 0]
    with_it = identify_friction([replace(log, tau=tau)], robot, options=ORDERS)
    taken = absorbed(scene, effect, j, settings)[j][:, 0]
    old, new = (np.ravel(x.joints[own].positive) for x in (without.friction, with_it))
    F = surface_columns(scene, j)[_between(scene, j)]
    said, found = F @ (size * taken), F @ (new - old)
    assert np.std(found) > 0.0
    assert np.linalg.norm(said - found) < known * np.linalg.norm(found)


def _between(scene: Scene, joint: int) -> Array:
    speed = np.abs(scene.motion.dq[:, joint])
    return np.flatnonzero((speed > SLOWEST) & (speed < FASTEST))


def test_rows_of_what_is_absorbed_are_those_of_its_columns() -> None:
    robot = load_robot(SAMPLES / "one_joint" / "robot.toml")
    log = read_recording(SAMPLES / "one_joint" / "friction/joint_1.parquet", robot)
    stages = Stages(friction=identify_friction([log], robot, options=ORDERS))
    ground = Ground.of(rows_of(scenes_of([log], robot, stages, options=InertiaOptions())), stages)
    whole = candidate("stribeck", 0, stribeck_speed=0.6, exponent=2.0)
    scene, some = ground.stage.scenes[0], replace(whole, absorbed=True)
    for first in (some, whole):  # whichever is asked for first
        columns = Stage(ground.stage.rows, ground.base.friction).columns([first, some])[1]
        low = scene.motion.filtered(some.columns(scene)[0], times=2)
        expected = ground.stage.rows.torque(0, [low])
        np.testing.assert_allclose(columns[0], expected, atol=1e-5 * np.abs(expected).max())
        assert np.abs(columns[0]).max() < 0.9 * np.abs(whole.columns(scene)[0]).max()


def test_files_without_trials_have_absorbed_nothing_that_is_known() -> None:
    (scene,) = arm_scenes(logs=1, seconds=8.0)
    assert not has_trials(scene, 0)
    assert not has_trials(scene, None)
    assert not candidate("stribeck", 0, stribeck_speed=0.1, exponent=2.0).absorbed
