"""Settings between the grid's values: those of the largest evidence."""

from dataclasses import replace

import numpy as np
import pytest

from seqid_cli.discover.candidates import candidates_of
from seqid_cli.discover.select.model import Model
from seqid_cli.discover.select.tuning import Tried, Tuner
from seqid_cli.model.effects.registry import CATALOGUE
from seqid_cli.model.effects.scene import Scene
from tests import Array
from tests.unit.discover.arms import Extra, arm_scenes, at_joint, candidate, model_of
from tests.unit.model.effects.two_mass import LOG_HZ, Gear, run, scene

HUMP, SPEED = 1.2, 0.37  # N m, rad/s


def stribeck(scene: Scene) -> Array:
    ratio = scene.motion.dq[:, 1] / SPEED
    return np.asarray(HUMP * np.exp(-(ratio**2)) * scene.sign[:, 1])


def tuner_in(model: Model) -> Tuner:
    return Tuner(model.ground.stage, model.linear, model.ground.size)


def best(model: Model, name: str, joint: int | None) -> Tried:
    """The best point of the grid."""
    scenes = model.ground.stage.scenes
    every = [c for c in candidates_of(scenes, [CATALOGUE[name]], model.left()) if c.joint == joint]
    return max(tuner_in(model).tried(every), key=lambda tried: tried.evidence)


def test_a_stribeck_speed_between_the_grids_is_found() -> None:
    model = model_of(arm_scenes(at_joint(1, stribeck)))
    grid = CATALOGUE["stribeck"].axes(model.ground.stage.scenes, 1)["stribeck_speed"]
    assert min(abs(x / SPEED - 1) for x in grid) > 0.05
    tried = best(model, "stribeck", 1)
    other = candidate("stribeck", 1, **(tried.candidate.settings | {"exponent": 2.0}))
    ends = [tuner_in(model).tuned(one) for one in (tried, *tuner_in(model).tried([other]))]
    found = max(ends, key=lambda one: one.evidence)
    assert found.candidate.settings["stribeck_speed"] == pytest.approx(SPEED, rel=0.1)
    assert found.candidate.settings["exponent"] == 2.0
    assert found.gained.coefficients[0] == pytest.approx(HUMP, rel=0.1)
    assert found.evidence > tried.evidence


def test_a_search_ends_within_what_is_reached_from_the_grid() -> None:
    model = model_of(arm_scenes(at_joint(1, stribeck)))
    effect, tuner = CATALOGUE["stribeck"], tuner_in(model)
    tried = best(model, "stribeck", 1)
    reached = [one["stribeck_speed"] for one in effect.reached(tried.candidate.settings)]
    assert reached[0] == tried.candidate.settings["stribeck_speed"]
    assert max(reached) == pytest.approx(2.5 * reached[0])
    assert min(reached) == pytest.approx(reached[0] / 2.5)
    assert min(reached) < tuner.tuned(tried).candidate.settings["stribeck_speed"] < max(reached)
    exponents = CATALOGUE["nonlinear_viscous"].reached({"exponent": 3.0}, points=5)
    assert [one["exponent"] for one in exponents] == [3.0, 1.5, 2.125, 2.75, 3.375, 4.0]
    twist = {"trial_stiffness": 1e3, "encoder_side": 0.0, "damping_ratio": 0.15}
    ratios = {one["damping_ratio"] for one in CATALOGUE["joint_elasticity"].reached(twist)}
    assert ratios == {0.15, 0.06, 0.03, 0.015}


def lag(scene: Scene) -> Array:
    """What the command is ahead of the torque."""
    return np.asarray(0.02 * np.gradient(scene.modelled, 1.0 / scene.motion.rate_hz, axis=0))


def test_a_lag_does_not_pass_for_a_delay() -> None:
    """They agree to first order; the columns of a delay that large do not."""
    model = model_of(arm_scenes(lag, noise=(0.03, 0.01)))
    some = [best(model, name, None) for name in ("actuator_lag", "time_skew")]
    model.add([some[0].candidate])
    ground = model.ground
    beside = Tuner(ground.stage, model.beside(model.terms[0]), ground.size)
    as_lag, as_delay = (beside.tuned(beside.tried([one.candidate])[0]) for one in some)
    assert as_lag.evidence > as_delay.evidence + 10.0


@pytest.mark.parametrize(
    ("extra", "name", "joint"),
    [(None, "rotor_inertia", 0), (at_joint(1, stribeck), "stribeck", 1)],
)
def test_implausible_points_are_not_taken(extra: Extra | None, name: str, joint: int) -> None:
    model = model_of(arm_scenes(extra))
    scenes = model.ground.stage.scenes
    some = [c for c in candidates_of(scenes, [CATALOGUE[name]], model.left()) if c.joint == joint]
    for tried in tuner_in(model).tried(some):
        end = tuner_in(model).tuned(tried)
        c = end.candidate
        assert c.effect.plausible(scenes, joint, c.settings, end.gained.coefficients)


def sprung(gear: Gear, seed: int) -> Scene:
    """A log of motor and link with a spring between them, once the begin has died away."""
    log = run(gear, seed=seed, seconds=12.0)
    seen = scene(log, cutoff_hz=12.0)
    usable = seen.motion.usable & (seen.motion.t > 3.0)
    every = round(LOG_HZ / seen.motion.rate_hz)
    torque = log.torque[::every][: seen.samples, None]
    motion = replace(seen.motion, usable=usable)
    return replace(seen, motion=motion, measured=torque, period=1.0 / motion.rate_hz, log=seed)


@pytest.mark.slow
def test_a_resonance_is_met_blunt_and_followed_to_its_damping() -> None:
    """The stiffness that the blunt shape fits best is off; the sharper one brings it back."""
    gear = Gear(2500.0, 2.7)  # 8.9 Hz, 3 % of critical
    model = model_of([sprung(gear, seed) for seed in range(5)])
    met = best(model, "joint_elasticity", 0)
    assert met.candidate.settings["damping_ratio"] == 0.15
    found = tuner_in(model).tuned(met)
    assert found.candidate.settings["damping_ratio"] in {0.03, 0.06}
    assert found.candidate.settings["trial_stiffness"] == pytest.approx(2500.0, rel=0.06)
    assert 1.0 / found.gained.coefficients[0] == pytest.approx(2500.0, rel=0.03)
    blunt = replace(found.candidate, settings=found.candidate.settings | {"damping_ratio": 0.15})
    (rival,) = tuner_in(model).tried([blunt])
    assert rival.evidence < found.evidence
