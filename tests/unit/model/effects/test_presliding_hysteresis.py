"""The closed form is Dahl's differential equation, and its distance comes back."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from seqid_cli.model.effects.presliding_hysteresis import PreslidingHysteresis, deflection
from tests.unit.model.effects.fitting import Array, fit, trial
from tests.unit.model.effects.scenes import scene_of, wander

TORQUE, DISTANCE = 5.0, 0.01  # N m, rad
POINT = {"presliding_distance": DISTANCE}


def dahl(q: Array, distance: float, substeps: int = 20) -> Array:
    """Integrate z' = v - |v| z / z_max by the midpoint rule, the speed constant in each sample."""
    z, out = 0.0, np.zeros(len(q))
    for k, way in enumerate(np.diff(q) / substeps):
        for _ in range(substeps):
            half = z + 0.5 * (way - abs(way) * z / distance)
            z += way - abs(way) * half / distance
        out[k + 1] = z / distance
    return out


def law(t: Array, q: Array, dq: Array) -> Array:
    """Dahl friction and viscous friction on both joints."""
    bristles = [TORQUE * dahl(q[:, j], DISTANCE, substeps=2) for j in range(q.shape[1])]
    return np.stack(bristles, axis=1) + 0.5 * dq


@pytest.mark.parametrize("distance", [0.003, 0.03, 0.3])
def test_the_closed_form_solves_the_differential_equation(distance: float) -> None:
    q = wander(15.0, seed=4)[:, 0]
    np.testing.assert_allclose(deflection(q, distance), dahl(q, distance), atol=1e-3)


def test_deflection_depends_on_the_way_alone() -> None:
    """Ten times as many samples, or ten times as slow, is the same loop."""
    turns = np.array([0.0, 0.3, 0.1, 0.15, -0.2, -0.19, 0.4])
    coarse = deflection(turns, 0.05)
    knots = np.arange(len(turns))
    fine = np.interp(np.linspace(0, 6, 601), knots, turns)
    np.testing.assert_allclose(deflection(fine, 0.05)[::100], coarse, atol=1e-12)


def test_deflection_by_hand() -> None:
    """Out, back, rest."""
    x = deflection(np.array([0.0, 2.0, 1.0, 1.0, 1.0]), 1.0)
    out = 1.0 - np.exp(-2.0)
    back = -1.0 + (out + 1.0) * np.exp(-1.0)
    np.testing.assert_allclose(x, [0.0, out, back, back, back], atol=1e-15)


@pytest.mark.parametrize("scale", [0.0, 1e-12, 1e-3, 1.0, 1e6])
def test_deflection_stays_within_its_bounds(scale: float) -> None:
    """Encoder noise at rest, tiny and huge ways, one sample."""
    rng = np.random.default_rng(2)
    x = deflection(scale * np.cumsum(rng.normal(size=5000)), 0.01)
    assert np.all(np.abs(x) <= 1.0)
    assert deflection(np.array([1.0]), 0.01) == 0.0


def test_long_rests_keep_what_was_left() -> None:
    """Three thousand samples at rest inside stiction."""
    q = np.concatenate([np.linspace(0.0, 0.004, 50), np.full(3000, 0.004), [0.1]])
    x = deflection(q, 0.01)
    np.testing.assert_allclose(x[49:-1], 1.0 - np.exp(-0.4), atol=1e-12)
    assert x[-1] > 0.999


def test_parameters_come_back() -> None:
    found = fit(PreslidingHysteresis(), [trial(law, seed=k, noise=0.2) for k in range(3)], joint=1)
    assert found.settings["presliding_distance"] == pytest.approx(DISTANCE, rel=0.03)
    assert found.c[0] == pytest.approx(TORQUE, rel=0.03)
    assert found.left < 0.05


def test_small_motion_inside_stiction() -> None:
    """Triangles within a distance and a half: the joint hardly slides."""
    trials = [trial(law, seed=k, amplitude=0.015, noise=0.1) for k in range(3)]
    found = fit(PreslidingHysteresis(), trials, joint=0)
    assert found.settings["presliding_distance"] == pytest.approx(DISTANCE, rel=0.15)
    assert found.c[0] == pytest.approx(TORQUE, rel=0.15)


def test_the_column_is_what_the_step_is_not() -> None:
    """Far from reversals nothing is left; at rest the bristles hold on."""
    ramp = 1.0 - np.cos(np.linspace(0.0, np.pi, 2000))
    q = np.concatenate([ramp, np.full(1000, 2.0), ramp[::-1]])
    scene = scene_of(np.stack([q, q], axis=1))
    column = PreslidingHysteresis().columns(scene, 0, POINT)[0][:, 0]
    assert np.abs(column[500:1500]).max() < 1e-6
    assert column[2500] == pytest.approx(1.0, abs=0.05)
    assert np.abs(column[3600:4500]).max() < 1e-6


def test_a_distance_that_the_motion_does_not_cover_is_not_believed() -> None:
    effect, scene = PreslidingHysteresis(), scene_of(wander(10.0, amplitude=0.1))
    assert effect.plausible([scene], 0, POINT, np.ones(1))
    assert not effect.plausible([scene], 0, POINT, -np.ones(1))
    assert not effect.plausible([scene], 0, {"presliding_distance": 0.3}, np.ones(1))


def test_gaps_do_not_break_it() -> None:
    """A jump over a gap is taken as one way."""
    scene = scene_of(wander(10.0))
    q = scene.motion.q.copy()
    q[1200:] += 1.0
    jumped = replace(scene, motion=replace(scene.motion, q=q))
    effect = PreslidingHysteresis()
    column, whole = (effect.columns(each, 0, POINT)[0] for each in (jumped, scene))
    np.testing.assert_array_equal(column[:1200], whole[:1200])
    assert np.abs(column).max() <= 2.0
