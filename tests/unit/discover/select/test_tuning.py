"""Settings between the grid's values: those of the largest evidence."""

from dataclasses import replace

import numpy as np
import pytest

from seqid_cli.discover.candidates import candidates_of
from seqid_cli.discover.select.model import Model
from seqid_cli.discover.select.terms import effects
from seqid_cli.discover.select.tuning import FittedTerm, Tuner
from seqid_cli.effects.registry import CATALOGUE
from seqid_cli.effects.scene import Scene
from tests.unit.discover.arms import HUMP, arm_scenes, candidate, model_of, stribeck
from tests.unit.effects.two_mass import LOG_HZ, Gear, run, scene

SPEED = 0.37  # rad/s


def tuner_in(model: Model) -> Tuner:
    return model.ground.tuner(model.linear)


def grid(model: Model, name: str, joint: int | None) -> list[FittedTerm]:
    scenes = model.ground.stage.scenes
    every = candidates_of(scenes, [CATALOGUE[name]], model.left())
    return list(tuner_in(model).tried([c for c in every if c.joint == joint]))


def best(model: Model, name: str, joint: int | None) -> FittedTerm:
    return max(grid(model, name, joint), key=lambda tried: tried.evidence)


@pytest.fixture(scope="module")
def humped() -> Model:
    return model_of(arm_scenes(stribeck(SPEED)))


def test_a_stribeck_speed_between_the_grids_is_found(humped: Model) -> None:
    tuner, tried = tuner_in(humped), best(humped, "stribeck", 1)
    other = candidate("stribeck", 1, **(tried.candidate.settings | {"exponent": 2.0}))
    ends = [tuner.tuned(one) for one in (tried, *tuner.tried([other]))]
    found = max(ends, key=lambda one: one.evidence)
    settings = found.candidate.settings
    assert settings == {
        "stribeck_speed": pytest.approx(SPEED, rel=0.1),
        "exponent": 2.0,
    }
    assert found.fit.coefficients[0] == pytest.approx(HUMP, rel=0.1)
    assert found.evidence > tried.evidence


@pytest.mark.parametrize(("name", "joint"), [("rotor_inertia", 0), ("stribeck", 1)])
def test_implausible_points_are_not_taken(humped: Model, name: str, joint: int) -> None:
    for tried in grid(humped, name, joint):
        end = tuner_in(humped).tuned(tried)
        c, scenes = end.candidate, humped.ground.stage.scenes
        assert c.effect.plausible(scenes, joint, c.settings, end.fit.coefficients)


def sprung(gear: Gear, seed: int) -> Scene:
    """A log of motor and link with a spring between, once the begin has died away."""
    log = run(gear, seed=seed, seconds=12.0)
    seen = scene(log, cutoff_hz=12.0)
    motion = replace(seen.motion, usable=seen.motion.usable & (seen.motion.t > 3.0))
    torque = log.torque[:: round(LOG_HZ / motion.rate_hz)][: seen.samples, None]
    return replace(
        seen, motion=motion, measured=torque, period=1.0 / motion.rate_hz, log=seed
    )


@pytest.mark.slow
def test_a_resonance_is_met_and_followed_to_its_damping() -> None:
    """The stiffness that the blunt shape fits best is off; the sharper one brings it
    back.
    """
    gear = Gear(2500.0, 2.7)  # 8.9 Hz, 3 % of critical
    model = model_of([sprung(gear, seed) for seed in range(5)])
    met = best(model, "joint_elasticity", 0)
    found = tuner_in(model).tuned(met)
    settings = found.candidate.settings
    assert settings["damping_ratio"] <= met.candidate.settings["damping_ratio"]
    assert settings["damping_ratio"] in {0.03, 0.06}
    assert settings["trial_stiffness"] == pytest.approx(2500.0, rel=0.06)
    assert 1.0 / found.fit.coefficients[0] == pytest.approx(2500.0, rel=0.03)
    blunt = replace(found.candidate, settings=settings | {"damping_ratio": 0.15})
    (rival,) = tuner_in(model).tried([blunt])
    assert rival.evidence < found.evidence


@pytest.mark.slow
@pytest.mark.parametrize(("times", "damping_ratio"), [(0.75, 0.03), (1.4, 0.15)])
def test_what_size_and_shape_disagree_by_is_an_error(
    times: float, damping_ratio: float
) -> None:
    """The resonance is taken for another: the stiffness is off, and says so."""
    stiffness = 2500.0
    model = model_of([sprung(Gear(stiffness, 2.7), seed) for seed in range(2)])
    off = candidate(
        "joint_elasticity",
        0,
        trial_stiffness=times * stiffness,
        encoder_side=0.0,
        damping_ratio=damping_ratio,
    )
    model.terms = effects(model.ground.stage, [off], model.ground.size)
    model.settle()
    (term,) = model.terms
    distance = abs(float(model.coefficients(term)[0]) - 1.0 / stiffness)
    assert distance > 4.0 * float(np.sqrt(model.variances(term)[0]))
    assert distance < 2.0 * float(np.sqrt(model.covariance(term)[0, 0]))
