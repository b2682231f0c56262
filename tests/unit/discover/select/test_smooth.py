"""Smooth functions: the right quantity is named first, though another moves along with
it.
"""

import numpy as np
import pytest

from seqid_cli.discover.select import smooth
from seqid_cli.discover.select.selection import Selection, select
from seqid_cli.discover.select.smooth import SmoothFunction, smooth_functions
from seqid_cli.discover.survey.rows import Rows, rows_of
from seqid_cli.effects.scene import Scene
from seqid_cli.effects.smooth import Axis, SmoothTerm
from tests import Array
from tests.unit.discover.arms import (
    Extra,
    at_joint,
    coloured,
    ground_of,
    measuring,
    related_scenes,
)

OTHER = "other_joint:joint_1"


def bump(scene: Scene) -> Array:
    return 0.9 * np.exp(-(((scene.motion.q[:, 1] - 0.3) / 0.2) ** 2))


def stirred(scene: Scene, seconds: float) -> Array:
    """Recent speed (N,) of the second joint: one step of Euler's after the other."""
    speed = np.abs(scene.motion.dq[:, 1])
    recent = np.empty_like(speed)
    recent[0] = speed[0]
    for k in range(1, len(speed)):
        step = 1.0 / (seconds * scene.motion.rate_hz)
        recent[k] = recent[k - 1] + step * (speed[k] - recent[k - 1])
    return recent


LAWS = [
    (bump, {"position"}),
    (lambda s: 0.3 * np.sin(4 * s.motion.dq[:, 0] + 0.6), {OTHER}),
    (
        lambda s: 0.3 * s.sign[:, 1] * np.cos(3 * s.motion.q[:, 1]),
        {"position", "direction"},
    ),
    # It rubs more where the other joint stands further out.
    (lambda s: 0.3 * s.sign[:, 1] * np.sin(2 * s.motion.q[:, 0]), {OTHER, "direction"}),
    # It rubs more the faster the other joint turns, and the more that one carries.
    (
        lambda s: 0.2 * s.sign[:, 1] * np.abs(s.motion.dq[:, 0]),
        {OTHER, "direction"},
    ),
    (
        lambda s: 0.02 * s.sign[:, 1] * np.abs(s.load[:, 0]),
        {OTHER, "direction"},
    ),
    # Grease that the last seconds have stirred.
    (
        lambda s: 0.8 * s.sign[:, 1] * stirred(s, 3.0),
        {"velocity", "time", "direction"},
    ),
    (lambda s: 0.5 * (s.motion.ddq[:, 1] / 8) ** 3, {"acceleration"}),
    (
        lambda s: 0.4 * np.sin(2 * s.motion.q[:, 1]) * np.cos(3 * s.motion.q[:, 0]),
        {"position", OTHER},
    ),
]


def selection(seed: int, extra: Extra | None) -> Selection:
    """What is selected without any effect to choose from, beside coloured noise."""
    rng, scenes = np.random.default_rng(seed), []
    for scene in related_scenes(seed, logs=3):
        whole = measuring(
            scene, scene.modelled + (0.0 if extra is None else extra(scene))
        )
        whole.motion.tau[:] += coloured(scene, rng)
        scenes.append(whole)
    return select(ground_of(scenes), [])


def test_an_axis_of_two_quantities_is_made_once(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    rows = rows_of(related_scenes(0, logs=2))
    made: list[tuple[str, int]] = []
    axis = smooth._axis

    def counted(
        rows: Rows, joint: int, without_knots: Axis, size: int
    ) -> tuple[Axis | None, Array]:
        made.append((without_knots.measure, without_knots.joint))
        return axis(rows, joint, without_knots, size)

    monkeypatch.setattr(smooth, "_axis", counted)
    functions = smooth.smooth_products(rows, 1)
    assert len(functions) == 2
    assert sorted(made) == [
        ("position", 0),
        ("position", 1),
        ("velocity", 0),
        ("velocity", 1),
    ]


@pytest.mark.slow
@pytest.mark.parametrize("seed", [0, 1])
@pytest.mark.parametrize(("extra", "quantities"), LAWS)
def test_the_right_quantity_is_named_first(
    extra, quantities: set[str], seed: int
) -> None:
    first = selection(seed, at_joint(1, extra)).model.terms[0].what
    assert isinstance(first, SmoothFunction)
    assert (first.joint, set(first.quantities)) == (1, quantities)


@pytest.mark.parametrize("seed", range(2))
def test_noise_depends_on_nothing(seed: int) -> None:
    assert selection(seed, None).told().terms == ()


def test_the_term_is_the_torque_that_was_put_in() -> None:
    """Up to a constant and a slope, which friction and gravity hold."""
    found = selection(1, at_joint(1, bump)).told()
    what, c = found.terms[0].term.what, found.terms[0].scored.fit.coefficients
    scene = found.model.ground.stage.scenes[0]
    term = SmoothTerm(
        joint=what.joint,
        quantities=what.quantities,
        axes=what.axes,
        factor=what.factor,
        coefficients=what.mixing @ c,
    )
    torque, inside = term.torques(scene)[1], np.abs(scene.motion.q[:, 1]) < 0.9
    assert np.corrcoef(torque[inside], bump(scene)[inside])[0, 1] > 0.95
    expected = scene.motion.filtered(torque, times=2)
    np.testing.assert_allclose(what.torques(scene, c)[1], expected, atol=1e-9)


def test_of_a_joint_at_rest_the_load_alone_is_a_quantity() -> None:
    scenes = related_scenes(0, logs=2, seconds=8.0)
    for scene in scenes:
        scene.motion.q[:, 0] = 0.3
        scene.motion.dq[:, 0] = scene.motion.ddq[:, 0] = 0.0
    labels = {one.label for one in smooth_functions(rows_of(scenes), 1)}
    assert "position" in labels
    of_other = [label for label in labels if "joint_1" in label]
    assert of_other == ["load of joint_1 x direction"]
