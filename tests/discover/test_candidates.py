"""Candidates: their columns on the rows, and the search of their settings."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray

from seqid_cli.discover.candidates import Candidate, Stage, Tried, candidates_of, refined, shapes
from seqid_cli.discover.rows import rows_of
from seqid_cli.discover.search import Search
from seqid_cli.model.effects.registry import CATALOGUE
from seqid_cli.model.effects.scene import Scene
from seqid_cli.model.effects.time_skew import delayed
from tests.discover.arms import Extra, arm_scenes, at_joint, candidate, search_in
from tests.model.effects.two_mass import LOG_HZ, Gear, run, scene

Array = NDArray[np.float64]

HUMP, SPEED = 1.2, 0.37  # N m, rad/s
DELAY = 0.012  # s


def stribeck(scene: Scene) -> Array:
    ratio = scene.motion.dq[:, 1] / SPEED
    return np.asarray(HUMP * np.exp(-(ratio**2)) * scene.sign[:, 1])


def late(scene: Scene) -> Array:
    return delayed(scene.modelled, DELAY, scene.motion.rate_hz) - scene.modelled


def best(search: Search, name: str, joint: int | None) -> Tried:
    """The best point of the grid."""
    left = search.residual(search.system())
    effect = CATALOGUE[name]
    found = search.stage.try_all(
        search.system(),
        [c for c in candidates_of(search.stage.scenes, [effect], left) if c.joint == joint],
    )
    return max(found, key=lambda tried: tried.trial.total)


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


def test_columns_are_made_once() -> None:
    stage = Stage(rows_of(arm_scenes(logs=2, seconds=8.0)))
    one = candidate("stribeck", 0, stribeck_speed=0.1, exponent=2.0)
    same = Candidate(one.effect, 0, {"exponent": 2.0, "stribeck_speed": 0.1})
    other = candidate("stribeck", 1, stribeck_speed=0.1, exponent=2.0)
    (first,) = stage.columns([one])
    again, different = stage.columns([same, other])
    assert first is again
    assert set(different) == {1}


def test_a_stribeck_speed_between_the_grids_is_found() -> None:
    search = search_in(arm_scenes(at_joint(1, stribeck)))
    tried = best(search, "stribeck", 1)
    grid = CATALOGUE["stribeck"].axes(search.stage.scenes, 1)["stribeck_speed"]
    assert min(abs(x / SPEED - 1) for x in grid) > 0.05
    found = search.ranked([CATALOGUE["stribeck"]], search.system(), near=[1])[0]
    assert found.candidate.settings["stribeck_speed"] == pytest.approx(SPEED, rel=0.1)
    assert found.candidate.settings["exponent"] == 2.0
    assert found.trial.coefficients[0] == pytest.approx(HUMP, rel=0.1)
    assert found.trial.total > tried.trial.total


def test_settings_move_to_where_the_coefficients_say() -> None:
    search = search_in(arm_scenes(late))
    system = search.system()
    tried = best(search, "time_skew", None)
    assert tried.candidate.settings == {"around": 0.0}
    found = refined(search.stage, system, tried)
    around, (delay,) = found.candidate.settings["around"], found.trial.coefficients
    assert found.trial.total > tried.trial.total
    assert delay == pytest.approx(around, rel=0.5)
    assert abs(delay - DELAY) < abs(tried.trial.coefficients[0] - DELAY) + 1e-4


def lag(scene: Scene) -> Array:
    """What the command is ahead of the torque."""
    return np.asarray(0.02 * np.gradient(scene.modelled, 1.0 / scene.motion.rate_hz, axis=0))


def test_a_lag_does_not_pass_for_a_delay() -> None:
    """They agree to first order; the columns of a delay that large do not."""
    search = search_in(arm_scenes(at_joint(0, lambda scene: lag(scene)[:, 0])))
    search.timed = (False, False)
    system = search.system()
    both = [best(search, name, 0) for name in ("actuator_lag", "time_skew")]
    assert both[1].trial.total == pytest.approx(both[0].trial.total, rel=0.05)
    as_lag, as_delay = (refined(search.stage, system, tried) for tried in both)
    loss = float(system.loss[:, 0].sum())
    assert loss - as_delay.trial.total > 1.1 * (loss - as_lag.trial.total)


def test_shapes_that_come_close_are_searched_as_well() -> None:
    """At the grid's speeds the wrong exponent can lead."""
    search = search_in(arm_scenes(at_joint(1, stribeck)))
    points = [
        search.stage.try_all(
            search.system(), [candidate("stribeck", 1, stribeck_speed=speed, exponent=exponent)]
        )[0]
        for speed, exponent in ((0.8 * SPEED, 1.0), (0.6 * SPEED, 2.0), (0.7 * SPEED, 2.0))
    ]
    for leader in points:
        chosen = shapes(leader, points)
        assert [t.candidate.settings["exponent"] for t in chosen].count(2.0) == 1
        assert points[1] not in chosen
    ends = [refined(search.stage, search.system(), t) for t in shapes(points[0], points)]
    best_end = max(ends, key=lambda t: t.trial.total)
    assert best_end.candidate.settings["exponent"] == 2.0
    weak = replace(points[2], trial=replace(points[2].trial, gain=0.5 * points[0].trial.gain))
    assert shapes(points[0], [points[0], weak]) == [points[0]]
    other = tried_at(search, "torque_bias")
    assert shapes(other, [other, *points]) == [other]


def tried_at(search: Search, name: str) -> Tried:
    return search.stage.try_all(search.system(), [candidate(name, 0)])[0]


@pytest.mark.parametrize(
    ("extra", "name", "joint"),
    [(None, "rotor_inertia", 0), (at_joint(1, stribeck), "stribeck", 1)],
)
def test_implausible_points_are_not_taken(extra: Extra | None, name: str, joint: int) -> None:
    search = search_in(arm_scenes(extra))
    tried = best(search, name, joint)
    again = refined(search.stage, search.system(), tried)
    assert search.stage.plausible(again) or again.candidate == tried.candidate


def test_freedom_counts_coefficients_and_searched_settings() -> None:
    assert candidate("stribeck", 0, stribeck_speed=0.1, exponent=1.0).freedom == 2
    assert candidate("torque_bias", 0).freedom == 1
    assert candidate("payload", None, from_log=0.0).freedom == 10
    assert candidate("payload", None, from_log=0.0).key == ("payload", None)


def test_joints_at_which_effects_are_looked_for() -> None:
    scenes = arm_scenes(logs=2, seconds=8.0)
    left = [np.zeros_like(scene.motion.q) for scene in scenes]
    effects = [CATALOGUE[name] for name in ("payload", "time_skew", "torque_bias", "stribeck")]

    def places(near: list[int] | None) -> dict[str, set[int | None]]:
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
    assert places([1])["stribeck"] == {1}
    assert places([1])["payload"] == {None}


def test_what_touches_no_row_is_left_out() -> None:
    search = search_in(arm_scenes(logs=2, seconds=8.0))
    assert search.stage.try_all(search.system(), [candidate("external_contact", None)]) == []


def sprung(gear: Gear, seed: int) -> Scene:
    """A log of motor and link with a spring between them, once the begin has died away."""
    log = run(gear, seed=seed, seconds=12.0)
    seen = scene(log, cutoff_hz=12.0)
    usable = seen.motion.usable & (seen.motion.t > 3.0)
    every = round(LOG_HZ / seen.motion.rate_hz)
    torque = log.torque[::every][: seen.samples, None]
    motion = replace(seen.motion, usable=usable)
    return replace(seen, motion=motion, measured=torque, period=1.0 / motion.rate_hz, log=seed)


def test_a_resonance_is_met_blunt_and_followed_to_its_damping() -> None:
    """The stiffness that the blunt shape fits best is off; the sharper one brings it back."""
    gear = Gear(2500.0, 2.7)  # 8.9 Hz, 3 % of critical
    search = search_in([sprung(gear, seed) for seed in range(2)])
    met = best(search, "joint_elasticity", 0)
    assert met.candidate.settings["damping_ratio"] == 0.15
    found = refined(search.stage, search.system(), met)
    assert found.candidate.settings["damping_ratio"] in {0.03, 0.06}
    assert abs(met.candidate.settings["trial_stiffness"] - 2500.0) > 500.0
    assert found.candidate.settings["trial_stiffness"] == pytest.approx(2500.0, rel=0.06)
    assert 1.0 / found.trial.coefficients[0] == pytest.approx(2500.0, rel=0.03)
    blunt = found.candidate.settings | {"damping_ratio": 0.15}
    again = replace(found.candidate, settings=blunt)
    (rival,) = search.stage.try_all(search.system(), [again])
    assert rival.trial.total < found.trial.total
