"""What a file absorbs of an effect is what stages identified with it have more."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import pytest

from seqid_cli.discover.absorbed import FileTrials
from seqid_cli.discover.base import has_trials, surface_columns
from seqid_cli.discover.scenes import scenes_of
from seqid_cli.discover.select.model import Ground
from seqid_cli.discover.survey.rows import rows_of
from seqid_cli.identify.friction_surface.stage import identify_friction
from seqid_cli.identify.options import FrictionOptions, InertiaOptions
from seqid_cli.identify.rigid.gravity import identify_gravity
from seqid_cli.logs.read import read_recording
from seqid_cli.logs.recording import Recording
from seqid_cli.model.effects.registry import CATALOGUE
from seqid_cli.model.effects.scene import Scene
from seqid_cli.params.schema import Stages
from seqid_cli.robot.base_parameters import base_regressor, free_basis
from seqid_cli.robot.file import load_robot
from seqid_cli.robot.types import Robot
from tests import ROOT, Array
from tests.unit.discover.arms import arm_scenes, candidate

SAMPLES = ROOT / "sample_logs"
ORDERS = FrictionOptions(position_order=4, velocity_order=3)
SLOWEST, FASTEST = 0.4, 3.0  # rad/s, between the trials' slowest and fastest
ONE, LIFT = ("one_joint", "joint_1"), ("six_joint", "shoulder_lift")
EFFECTS = {  # sample robot and joint; settings; coefficients; how well it is known
    "stribeck": (ONE, {"stribeck_speed": 0.6, "exponent": 2.0}, (0.01,), 0.05),
    "nonlinear_viscous": (ONE, {"exponent": 0.5}, (0.01,), 0.05),
    "load_dependent_friction": (ONE, {}, (0.1,), 0.05),
    "actuator_lag": (LIFT, {}, (0.005,), 0.15),
    "time_skew": (LIFT, {"around": 0.005}, (0.005,), 0.15),
}
BOTH_WAYS = {"gear_efficiency": (LIFT, {}, (0.02, 0.06), 0.15)}


@pytest.mark.parametrize("name", EFFECTS)
def test_friction_identified_with_an_effect_has_more_by_what_is_absorbed(name: str) -> None:
    (sample, own), settings, size, known = EFFECTS[name]
    arm = _Arm.of(sample, own)
    (scene,) = arm.scenes()
    with_it = identify_friction(
        [arm.with_effect(name, settings, size)[0]], arm.robot, options=ORDERS
    )
    taken = arm.absorbed(name, settings)[1 + arm.joint] @ size
    old, new = (np.ravel(x.joints[own].positive) for x in (arm.stages.friction, with_it))
    F = surface_columns(scene, arm.joint)[_between(scene, arm.joint)]
    _agree(F @ taken, F @ (new - old), known)


@pytest.mark.parametrize("name", BOTH_WAYS)
def test_gravity_identified_with_an_effect_has_more_by_what_is_absorbed(name: str) -> None:
    (sample, own), settings, size, known = BOTH_WAYS[name]
    arm = _Arm.of(sample, own)
    log, other = arm.with_effect(name, settings, size)
    stages = Stages(friction=identify_friction([log], arm.robot, options=ORDERS))
    with_it = identify_gravity([other, log], arm.robot, stages)
    taken = arm.absorbed(name, settings)[0] @ size
    basis = free_basis(arm.robot)
    more = np.zeros(basis.size)
    for one, sign in ((with_it, 1.0), (arm.stages.gravity, -1.0)):
        for parameter in one.parameters:
            more[basis.names.index(parameter.name)] += sign * parameter.value
    q, rest = log.q, np.zeros_like(log.q)
    G = base_regressor(arm.robot, basis, q, rest, rest)[:, arm.joint]
    _agree(G @ taken, G @ more, known)


def _agree(said: Array, found: Array, known: float) -> None:
    assert np.std(found) > 0.0
    assert np.linalg.norm(said - found) < known * np.linalg.norm(found)


@dataclass(frozen=True)
class _Arm:
    """A sample robot with trials of one joint, and the stages identified from them."""

    robot: Robot
    joint: int
    logs: tuple[Recording, Recording]
    stages: Stages

    @classmethod
    def of(cls, sample: str, own: str) -> _Arm:
        robot = load_robot(SAMPLES / sample / "robot.toml")
        log, other = (
            read_recording(SAMPLES / sample / f"{x}/{own}.parquet", robot)
            for x in ("friction", "gravity")
        )
        stages = Stages(friction=identify_friction([log], robot, options=ORDERS))
        stages.gravity = identify_gravity([other, log], robot, stages)
        return cls(robot, robot.joint_names.index(own), (log, other), stages)

    def scenes(self, *logs: Recording) -> list[Scene]:
        some = logs or self.logs[:1]
        return scenes_of(some, self.robot, self.stages, options=InertiaOptions())

    def with_effect(
        self, name: str, settings: dict[str, float], size: Sequence[float]
    ) -> list[Recording]:
        changed, j = [], self.joint
        for log, scene in zip(self.logs, self.scenes(*self.logs), strict=True):
            tau = log.tau.copy()
            tau[:, j] += CATALOGUE[name].columns(scene.full or scene, j, settings)[j] @ size
            changed.append(replace(log, tau=tau))
        return changed

    def absorbed(self, name: str, settings: dict[str, float]) -> dict[int, Array]:
        ground = Ground.of(rows_of(self.scenes()), self.stages)
        return FileTrials(ground.stage.scenes[0], ground.base, self.stages).absorbed(
            CATALOGUE[name], self.joint, settings
        )


def _between(scene: Scene, joint: int) -> Array:
    speed = np.abs(scene.motion.dq[:, joint])
    return np.flatnonzero((speed > SLOWEST) & (speed < FASTEST))


def test_files_absorb_nothing_of_what_was_not_there() -> None:
    arm = _Arm.of(*ONE)
    stage = Ground.of(rows_of(arm.scenes()), arm.stages).stage
    whole = candidate("stribeck", 0, stribeck_speed=0.6, exponent=2.0)
    some = replace(whole, absorbed="all")
    columns, same = stage.columns([whole, some])
    assert all(same[c] is X for c, X in columns.items())
    assert stage.beside_file(columns, stage.in_file(whole)) is columns
    left = stage.beside_file(columns, stage.in_file(some))[0]
    assert 0.0 < np.linalg.norm(left) < 0.9 * np.linalg.norm(columns[0])


def test_files_without_trials_have_absorbed_nothing_that_is_known() -> None:
    (scene,) = arm_scenes(logs=1, seconds=8.0)
    assert not has_trials(scene, 0)
    assert not has_trials(scene, None)
    assert not candidate("stribeck", 0, stribeck_speed=0.1, exponent=2.0).absorbed
