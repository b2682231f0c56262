"""Candidates: their columns on the rows, and where they are looked for."""

from __future__ import annotations

import numpy as np

from seqid_cli.discover.candidates import Stage, candidates_of
from seqid_cli.discover.survey.rows import rows_of
from seqid_cli.model.effects.registry import CATALOGUE
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
