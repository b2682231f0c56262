"""What wear adds to friction, against the friction that the file has."""

from __future__ import annotations

import numpy as np
import pytest

from seqid_cli.model.effects.friction_change import FrictionChange
from seqid_cli.model.torque import TorqueModel
from tests.plants.robots.two_joint import COULOMB, VISCOUS, torque_model
from tests.unit.model.effects.fitting import Array, direction, trial
from tests.unit.model.effects.scenes import scene_of, wander

WORN = np.array([0.8, -0.3])  # Coulomb N m, viscous N m s/rad, both joints


def law(t: Array, q: Array, dq: Array) -> Array:
    """Today's friction, whole."""
    coulomb, viscous = np.array(COULOMB) + WORN[0], np.array(VISCOUS) + WORN[1]
    torque: Array = coulomb * direction(dq) + viscous * dq
    return torque


@pytest.mark.parametrize("joint", [0, 1])
def test_the_change_comes_back(joint: int) -> None:
    """Measured less the file's friction; nothing else is free."""
    effect = FrictionChange()
    today = trial(law, noise=0.2)
    scene, rows = today.scene, today.scene.motion.usable
    change = today.torque - scene.motion.filtered(scene.friction, 2)
    X = scene.motion.filtered(effect.columns(scene, joint, {})[joint], effect.passes)
    c = np.linalg.lstsq(X[rows], change[rows, joint])[0]
    assert effect.change
    assert c == pytest.approx(WORN, rel=0.1)
    assert effect.plausible([scene], joint, {}, c)


def test_friction_that_nobody_knew_has_not_changed() -> None:
    scene = scene_of(wander(10.0))
    known = torque_model(scene.robot)
    first = TorqueModel(scene.robot, [known.surfaces[0], None], known.phi, known.rotor, "diagonal")
    half = scene_of(wander(10.0), model=first)
    assert FrictionChange().available([scene, half], 0)
    assert not FrictionChange().available([scene, half], 1)
