"""Candidates: their columns, where they are looked for, and the command that settles a name."""

import numpy as np
import pytest

from seqid_cli.discover.candidates import Stage, candidates_of
from seqid_cli.discover.diagnosis import separate_by
from seqid_cli.discover.survey.rows import rows_of
from seqid_cli.model.effects.registry import CATALOGUE
from tests.plants.robots.sample import sample_robot
from tests.unit.discover.arms import arm_scenes, candidate


def test_columns_are_filtered_as_the_effect_asks() -> None:
    scenes = arm_scenes(logs=2, seconds=8.0)
    stage = Stage(rows_of(scenes))
    some = [
        candidate("torque_bias", 0),
        candidate("stribeck", 1, stribeck_speed=0.1, exponent=2.0),
        candidate("rotor_inertia", 1, coupling=0.0),
        candidate("payload", None, from_log=1.0),
    ]
    assert {c.effect.passes for c in some} == {1, 2}
    for c, columns in zip(some, stage.columns(some), strict=True):
        raw = [c.effect.columns(scene, c.joint, c.settings) for scene in scenes]
        assert set(columns) == set(raw[0])
        for j, X in columns.items():
            low = [
                s.motion.filtered(r[j], times=c.effect.passes)
                for s, r in zip(scenes, raw, strict=True)
            ]
            expected = stage.rows.torque(j, low)
            np.testing.assert_allclose(X, expected, atol=1e-4 * max(1.0, np.abs(expected).max()))


def test_joints_at_which_effects_are_looked_for() -> None:
    scenes = arm_scenes(logs=2, seconds=8.0)
    left = [np.zeros_like(scene.motion.q) for scene in scenes]
    effects = [CATALOGUE[name] for name in ("payload", "time_skew", "torque_bias", "stribeck")]

    def places(near: list[int | None] | None) -> dict[str, set[int | None]]:
        found: dict[str, set[int | None]] = {}
        for c in candidates_of(scenes, effects, left, near):
            found.setdefault(c.effect.name, set()).add(c.joint)
        return found

    every = {0, 1}
    assert places(None) == {
        "payload": {None},
        "time_skew": {*every, None},
        "torque_bias": every,
        "stribeck": every,
    }
    assert places([1, None])["stribeck"] == {1}
    assert places([1, None])["payload"] == {None}
    assert "payload" not in places([1])


@pytest.mark.parametrize(
    ("effect", "others", "joint", "command"),
    [
        ("stribeck", ("quadratic_drag",), 1, "--between stribeck,quadratic_drag --joint joint_2"),
        ("torque_bias", ("drift", "spring"), 0, "--between torque_bias,spring --joint joint_1"),
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
    assert text.startswith(CATALOGUE[effect].separate_by)
    ending = f"; seqid plan discriminate {command}, with these logs as --have, plans it"
    assert text.endswith(ending if command else "")
    assert ("seqid plan" in text) == bool(command)
