"""Rivals: the right quantity is named first, though another moves along with it."""

from __future__ import annotations

import numpy as np
import pytest

from seqid_cli.discover.dependence import dependence, simplest
from seqid_cli.discover.rivals import Filtered, Line, Rival, Shape, best_rivals, rivals
from seqid_cli.discover.rows import rows_of
from seqid_cli.discover.smoothest import knots_of, smoothest
from seqid_cli.discover.system import Trial
from seqid_cli.model.effects.scene import Scene
from seqid_cli.model.effects.smooth import Axis, greville, splines
from tests.discover.residuals import related_scenes, residual_system

OTHER = "other_joint:joint_1"


def bump(scene: Scene) -> np.ndarray:
    return 0.9 * np.exp(-(((scene.motion.q[:, 1] - 0.3) / 0.2) ** 2))


def wave_of_other(scene: Scene) -> np.ndarray:
    return 0.3 * np.sin(4 * scene.motion.dq[:, 0] + 0.6)


def friction_of_place(scene: Scene) -> np.ndarray:
    return 0.3 * scene.sign[:, 1] * np.cos(3 * scene.motion.q[:, 1])


def rail(scene: Scene) -> np.ndarray:
    """Rubs more where the other joint stands further out."""
    return 0.3 * scene.sign[:, 1] * np.sin(2 * scene.motion.q[:, 0])


def cubic(scene: Scene) -> np.ndarray:
    return 0.5 * (scene.motion.ddq[:, 1] / 8) ** 3


def both_places(scene: Scene) -> np.ndarray:
    return 0.4 * np.sin(2 * scene.motion.q[:, 1]) * np.cos(3 * scene.motion.q[:, 0])


def ripple(scene: Scene) -> np.ndarray:
    return 0.3 * scene.sign[:, 1] * np.sin(2 * scene.gear[1] * scene.motion.q[:, 1])


def hum(scene: Scene) -> np.ndarray:
    return 0.3 * np.sin(2 * np.pi * 3.3 * scene.motion.t + scene.log)


@pytest.mark.parametrize("seed", [0, 1])
@pytest.mark.parametrize(
    ("extra", "quantities"),
    [
        (bump, ("position",)),
        (wave_of_other, (OTHER,)),
        (friction_of_place, ("position", "direction")),
        (rail, (OTHER, "direction")),
        (cubic, ("acceleration",)),
        (both_places, ("position", OTHER)),
    ],
)
def test_the_right_quantity_is_named_first(extra, quantities, seed: int) -> None:
    found = dependence(residual_system(seed, 1, extra, logs=3), 1)
    assert found.quantities[: len(quantities)] == quantities
    assert found.rivals[0].joint == 1


@pytest.mark.parametrize(
    ("extra", "label", "elsewhere"),
    [(ripple, "motor angle, order 2 x direction", True), (hum, "time at 3.3 Hz", False)],
)
def test_waves_are_found_by_order_and_frequency(extra, label: str, elsewhere: bool) -> None:
    rival, trial = best_rivals(residual_system(2, 1, extra, logs=3), [1])[1][0]
    assert rival.label == label
    assert trial.relative > 0.5
    assert (rival.term(trial.coefficients) is not None) == elsewhere
    assert rival.curve(trial.coefficients) is None


@pytest.mark.parametrize("seed", range(2))
def test_noise_depends_on_nothing(seed: int) -> None:
    found = dependence(residual_system(seed, 1, None, logs=3), 1)
    assert found.quantities == ()
    assert found.relative == 0.0


def test_two_causes_are_both_named_and_explain_more_than_one() -> None:
    def both(scene: Scene) -> np.ndarray:
        return wave_of_other(scene) + 0.6 * bump(scene)

    system = residual_system(3, 1, both, logs=3)
    found = dependence(system, 1)
    assert set(found.quantities) == {OTHER, "position"}
    assert found.relative > found.trials[0].relative + 0.05


def test_the_term_is_the_torque_that_was_put_in() -> None:
    system = residual_system(1, 1, bump, logs=3)
    rival, trial = best_rivals(system, [1])[1][0]
    curve = rival.curve(trial.coefficients)
    assert curve is not None
    x, torque = curve
    inside = np.abs(x) < 0.9
    truth = 0.9 * np.exp(-(((x - 0.3) / 0.2) ** 2))
    # Up to a constant and a slope, which friction and gravity hold.
    assert np.corrcoef(torque[inside], truth[inside])[0, 1] > 0.95
    scene = system.rows.scenes[0]
    term = rival.term(trial.coefficients)
    assert term is not None
    expected = rival.columns(scene)[1] @ trial.coefficients
    np.testing.assert_allclose(term.torque(scene), expected, atol=1e-9)


def test_columns_are_filtered_like_any_effect() -> None:
    rows = rows_of(related_scenes(0, logs=2, seconds=8.0))
    some = [r for r in rivals(rows, 0, np.zeros(rows.count(0))) if "position" in r.label][:3]
    direct = rows.columns([some[-1].columns(scene) for scene in rows.scenes], passes=2)
    np.testing.assert_allclose(Filtered.of(rows).columns(some[-1])[0], direct[0], atol=1e-5)


def test_a_line_at_two_joints_has_the_rows_of_each() -> None:
    rows = rows_of(related_scenes(0, logs=2, seconds=8.0))
    filtered, line = Filtered.of(rows), Line(3.3, 2)
    for joint in (0, 1):
        rival = Rival(joint, ("time",), "line", line, np.eye(4))
        direct = rows.columns([{joint: line.basis(scene)} for scene in rows.scenes], passes=2)
        np.testing.assert_allclose(filtered.columns(rival)[joint], direct[joint], atol=1e-5)


def test_a_joint_at_rest_is_no_quantity() -> None:
    scenes = related_scenes(0, logs=2, seconds=8.0)
    for scene in scenes:
        scene.motion.q[:, 0] = 0.3
        scene.motion.dq[:, 0] = scene.motion.ddq[:, 0] = 0.0
    rows = rows_of(scenes)
    labels = {r.label for r in rivals(rows, 1, np.zeros(rows.count(1)))}
    assert "position" in labels
    assert not [label for label in labels if "joint_1" in label]


def test_smoothest_combinations_start_with_constant_and_line() -> None:
    x = np.random.default_rng(0).normal(size=4000)
    knots = knots_of(x, np.arange(4000) // 500, 9)
    assert knots is not None
    basis = splines(x, knots)
    columns = basis @ smoothest(basis, greville(knots))
    np.testing.assert_allclose(columns.T @ columns / 4000, np.eye(11), atol=1e-4)
    np.testing.assert_allclose(columns[:, 0], columns[0, 0], rtol=1e-6)
    held = np.clip(x, knots[0], knots[-1])
    assert abs(np.corrcoef(columns[:, 1], held)[0, 1]) > 0.999


def test_knots_end_where_more_than_one_fold_has_been() -> None:
    fold = np.repeat(np.arange(4), 300)
    x = np.random.default_rng(1).uniform(-1, 1, 1200)
    x[fold == 2] *= 5.0
    knots = knots_of(x, fold, 9)
    assert knots is not None
    assert -1.0 <= knots[0] < -0.9
    assert 0.9 < knots[-1] <= 1.0
    assert knots_of(np.ones(1200), fold, 9) is None
    assert knots_of(x[:50], fold[:50], 9) is None


def test_a_single_quantity_goes_before_a_product_that_hardly_gains_more() -> None:
    def pair(quantities: tuple[str, ...], gain: float) -> tuple[Rival, Trial]:
        rival = Rival(0, quantities, "", Shape(0, (Axis("position", 0),)), np.eye(2))
        none = np.zeros(1)
        return rival, Trial(np.array([gain]), np.ones(1), 1.0, none, np.eye(1), gain)

    product, single = pair(("position", OTHER), 1.0), pair((OTHER,), 0.93)
    assert simplest([product, single]) is single
    assert simplest([product, pair((OTHER,), 0.8)]) is product


def test_gain_is_what_leaving_out_gives() -> None:
    system = residual_system(0, 1, bump, logs=2)
    ranked = best_rivals(system, [1])[1]
    totals = [trial.total for _, trial in ranked]
    assert totals == sorted(totals, reverse=True)
    assert len({rival.label for rival, _ in ranked}) == len(ranked)
