"""A model under selection: how far its base moves, its time offsets, and what it
leaves.
"""

import numpy as np
import pytest

from seqid_cli.discover.select.model import FIRM, FREE, HELD, Model
from seqid_cli.effects.scene import Scene, positions
from tests import Array
from tests.unit.discover.arms import (
    DRAG,
    MASS,
    OUT,
    Extra,
    arm_scenes,
    at_joint,
    candidate,
    drag,
    file_of,
    ground_of,
    model_of,
    payload,
)


def test_a_held_base_moves_within_the_files_errors_only() -> None:
    scenes = arm_scenes(payload)
    stages = file_of(scenes[0])
    models = [model_of(scenes, hold, stages) for hold in (FREE, HELD, FIRM)]
    at = list(models[0].ground.base.basis.names).index("mx_1")
    free, held, firm = (abs(float(m.linear.theta[at])) for m in models)
    # m l of what hangs on the first link
    assert free == pytest.approx(OUT * MASS, rel=0.2)
    assert firm < held < 0.2 * free
    assert models[1].rms().max() > 2.0 * models[0].rms().max()


@pytest.mark.parametrize(("extra", "loose"), [(None, False), (payload, True)])
def test_the_evidence_says_how_loosely_the_base_is_held(
    extra: Extra | None, loose: bool
) -> None:
    scenes = arm_scenes(extra)
    model = model_of(scenes, HELD, file_of(scenes[0]))
    said = (model.rescale(), model.hold.rigid > 1.0, model.hold.doubt(2) > 0.0)
    assert said == (loose, loose, loose)


def late(share: float) -> Extra:
    """Torque that is late by a share of a sample."""

    def extra(scene: Scene) -> Array:
        slope = np.gradient(scene.modelled, 1.0 / scene.motion.rate_hz, axis=0)
        return np.asarray(-share / scene.motion.rate_hz * slope)

    return extra


def test_an_ordinary_time_offset_belongs_to_the_base() -> None:
    """Half a sample is every drive's; five samples are an effect and not absorbed."""
    model = model_of(arm_scenes(late(0.5)))
    assert model.free == (True, True)
    assert all(model.delays[joint] > 0.0 for joint in (0, 1))
    assert model_of(arm_scenes(late(5.0))).delays == {}


def test_a_lines_frequency_is_sharpened_beside_all_else() -> None:
    scenes = arm_scenes(
        at_joint(0, lambda s: 3.0 * np.sin(2 * np.pi * 3.7 * s.time) + drag(s))
    )
    model, span = model_of(scenes), float(scenes[-1].time[-1])
    # a part of a turn over the session; another line
    for off in (3.7 + 0.3 / span, 3.9):
        model.terms.clear()
        line = candidate(
            "periodic_disturbance", 0, frequency=off, clocks=0.0, span=span
        )
        model.add([line, candidate("quadratic_drag", 0)])
        found = model.candidates[0].settings["frequency"]
        assert found == (off if off == 3.9 else pytest.approx(3.7, abs=0.02 / span))


def test_values_of_the_grid_are_tried_again_beside_all_else() -> None:
    """Two waves were enough beside the noise of before."""

    def waves(scene: Scene) -> Array:
        turn = scene.motion.q[:, 0]
        of_file = np.cos(turn) + 0.8 * np.sin(2.0 * turn)
        return scene.sign[:, 0] * (of_file + 0.15 * np.sin(5.0 * turn))

    scenes = arm_scenes(at_joint(0, waves), logs=2, noise=(0.02, 0.02))
    low, high = positions(scenes, 0)
    taken = candidate(
        "position_dependent_friction",
        0,
        period=2.0 * np.pi,
        waves=2.0,
        lowest=low,
        highest=high,
    )
    model = Model(ground_of(scenes), FREE, [taken, candidate("quadratic_drag", 1)])
    polished, _ = model.candidates
    assert polished.settings == {**taken.settings, "waves": 5.0}


def test_errors_are_no_narrower_than_the_scatter_over_blocks() -> None:
    def lasting(scene: Scene) -> Array:
        rng = np.random.default_rng(scene.log)
        slow = np.convolve(
            rng.normal(size=scene.samples + 239), np.ones(240) / 12.0, "valid"
        )
        return np.asarray(drag(scene) + 0.1 * slow)

    errors = []
    for law in (drag, lasting):
        model = model_of(arm_scenes(at_joint(0, law)))
        model.add([candidate("quadratic_drag", 0)])
        errors.append(float(np.sqrt(model.covariance(model.terms[0])[0, 0])))
        assert model.coefficients(model.terms[0])[0] == pytest.approx(
            DRAG, abs=4.0 * errors[-1]
        )
    assert errors[1] > 1.3 * errors[0]
