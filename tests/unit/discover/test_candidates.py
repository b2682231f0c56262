"""Where an effect is looked for, and the command that settles its name."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from seqid_cli.discover.candidates import (
    Candidate,
    CandidateColumns,
    candidates_of,
)
from seqid_cli.discover.diagnosis import separate_by
from seqid_cli.discover.survey.rows import rows_of
from seqid_cli.effects.effect import FROM_LOG, Columns, Effect
from seqid_cli.effects.registry import CATALOGUE, catalogue_of
from seqid_cli.effects.scene import Scene
from seqid_cli.robot.formula import parse_formula
from seqid_cli.robot.types import OwnEffect
from tests.plants.robots.sample import sample_robot
from tests.unit.discover.arms import arm_scenes


@pytest.mark.parametrize(
    ("effect", "others", "joint", "command"),
    [
        (
            "stribeck",
            ("quadratic_drag",),
            1,
            "--between stribeck,quadratic_drag --joint joint_2",
        ),
        (
            "torque_bias",
            ("drift", "spring"),
            0,
            "--between torque_bias,spring --joint joint_1",
        ),
        ("payload", ("base_tilt",), None, "--between payload,base_tilt"),
        ("payload", ("spring",), None, ""),
        ("drift", ("torque_bias",), 0, ""),
        ("stribeck", (), 0, ""),
    ],
)
def test_the_command_names_a_rival_that_motion_can_settle(
    effect: str, others: tuple[str, ...], joint: int | None, command: str
) -> None:
    text = separate_by(CATALOGUE[effect], others, sample_robot("two_joint"), joint)
    ending = f"; seqid plan discriminate {command}, with these logs as --have, plans it"
    assert text.removeprefix(CATALOGUE[effect].separate_by) == (
        ending if command else ""
    )


def test_an_own_effect_of_one_joint_is_looked_for_there_alone() -> None:
    (scene,) = arm_scenes(logs=1, seconds=8.0)
    own = OwnEffect("cube", 0, parse_formula("c1 * ddq ** 3", 2))
    scene = replace(scene, robot=replace(scene.robot, effects=(own,)))
    effect = catalogue_of(scene.robot)["cube"]
    found = candidates_of([scene], [effect], [np.zeros_like(scene.motion.q)])
    assert {candidate.joint for candidate in found} == {0}


def test_a_change_since_a_log_is_worked_out_with_the_change_itself(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Its columns are the same, zero before that log; forgotten ones come back."""
    stage = CandidateColumns(rows_of(arm_scenes(logs=2, seconds=8.0)))
    effect = CATALOGUE["friction_change"]
    calls = []
    columns = type(effect).columns

    def counted(self: Effect, scene: Scene, *others: Any) -> Columns:
        calls.append(scene.log)
        return columns(self, scene, *others)

    monkeypatch.setattr(type(effect), "columns", counted)
    change = Candidate(effect, 0, {})
    since = Candidate(effect, 0, {FROM_LOG: 1.0})
    of_change, of_since = stage.columns([change, since])
    assert calls == [0, 1]

    log = stage.rows.of(
        0, [np.full(scene.samples, scene.log) for scene in stage.scenes]
    )
    np.testing.assert_array_equal(of_since[0][log == 0], 0.0)
    np.testing.assert_allclose(of_since[0][log == 1], of_change[0][log == 1])

    for scene in stage.scenes:
        scene.memo["slopes", 0] = (np.zeros(1),)
    stage.forget()
    assert not any(scene.memo for scene in stage.scenes)
    (again,) = stage.columns([since])
    stage.forget(but_at={0})
    n_calls = len(calls)
    stage.columns([since])
    assert len(calls) == n_calls
    np.testing.assert_array_equal(again[0], of_since[0])
