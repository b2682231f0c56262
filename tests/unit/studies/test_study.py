"""The tables' arithmetic, the bound against textbook cases."""

import numpy as np
import pytest

from tests import ROOT
from tests.plants.arms.rigs import LINK_INERTIA, MOMENT, one_joint
from tests.plants.mechanics.rigid import Rigid
from tests.plants.motions.trajectories import sweeps
from tests.plants.simulate import simulate
from tests.studies.__main__ import STUDIES
from tests.studies.rigs.bound import friction_columns, rigid_columns, whittle
from tests.studies.rigs.repetition import surface_of
from tests.studies.tables import placed


def test_content_is_placed_between_its_own_markers_and_again() -> None:
    page = (
        "top\n<!-- study:a -->\nold\n<!-- /study -->\nmid\n<!-- study:b --><!-- /study"
        " -->\n"
    )
    once = placed(page, "a", "| new \\1 |")
    assert once.count("| new \\1 |") == 1
    assert "old" not in once
    assert once.endswith("mid\n<!-- study:b --><!-- /study -->\n")
    assert placed(once, "a", "| new \\1 |") == once


def test_white_noise_information_is_that_of_least_squares() -> None:
    rng = np.random.default_rng(0)
    for count in (400, 401):
        H = rng.standard_normal((count, 3))
        density = np.full(count // 2 + 1, 0.7**2)
        np.testing.assert_allclose(whittle(H, density), H.T @ H / 0.7**2, rtol=1e-9)


def test_columns_reproduce_the_torque_of_the_plant() -> None:
    """Gravity, inertia and friction columns times the true parameters are the
    actuator's torque.
    """
    plant = one_joint()
    motion = sweeps(np.zeros(1), 0, (-1.5, 1.5), [2.0, 4.0], 60.0, rate_hz=1000.0)
    log = simulate(plant, motion, 3, imus=False)
    sliding = np.abs(log.truth.dq[:, 0]) > 0.05
    total = LINK_INERTIA + float(plant.arm.reflected[0])
    rigid = rigid_columns(plant, log) @ np.array([MOMENT, 0.0, total])
    surface = surface_of(plant)
    level, amplitude, phase = (
        float(surface.coulomb[0]),
        surface.amplitude[0],
        surface.phase[0],
    )
    waves = [*(level * amplitude * np.cos(phase)), *(level * amplitude * np.sin(phase))]
    values = [level, *waves, float(surface.stribeck[0]), float(surface.viscous[0])]
    torque = rigid + friction_columns(plant, log) @ np.array(values)
    np.testing.assert_allclose(torque[sliding], log.truth.tau[sliding, 0], atol=1e-4)
    state = [log.truth.q[700], log.truth.dq[700], log.truth.ddq[700]]
    assert rigid[700] == pytest.approx(Rigid(plant.arm).inverse(*state)[0], abs=1e-12)


@pytest.mark.parametrize("name", STUDIES)
def test_every_study_has_its_place_in_its_document(name: str) -> None:
    text = (ROOT / "docs" / STUDIES[name][0]).read_text(encoding="utf-8")
    assert "| new |" in placed(text, name, "| new |")
