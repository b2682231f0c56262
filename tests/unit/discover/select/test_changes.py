"""Changes of the file's values: told by name and size though the base or waves contain
them.
"""

from collections.abc import Callable

import numpy as np
import pytest

from seqid_cli.discover.select.changes import causes_at
from seqid_cli.discover.select.model import HELD
from seqid_cli.effects.scene import Scene
from seqid_cli.params.schema import FrictionStage, Stages
from tests import Array
from tests.plants.robots.made import friction_joint
from tests.plants.robots.two_joint import COULOMB, SIGN_WIDTH, VISCOUS
from tests.unit.discover.arms import (
    Extra,
    arm_scenes,
    at_joint,
    file_of,
    model_of,
    selected,
)

TOP = 4.0  # rad/s, of the friction stage
MORE = 0.25  # share by which friction has grown
LAWS = ("friction_change", "position_dependent_friction", "nonlinear_viscous")


def known_friction(scene: Scene) -> Stages:
    """A parameter file whose Coulomb and viscous friction are known to a part in a
    hundred.
    """
    joints = {}
    for joint, name in enumerate(scene.robot.joint_names):
        half = 0.5 * VISCOUS[joint] * TOP
        values = [COULOMB[joint] + half, half]
        joints[name] = friction_joint(
            [values],
            speed_range=[0.0, TOP],
            sign_width=SIGN_WIDTH,
            covariance=np.diag(np.square(0.01 * np.array(values))).tolist(),
        )
    return Stages(friction=FrictionStage(joints=joints), inertia=file_of(scene).inertia)


def worn(scene: Scene) -> Array:
    """Torque (N,) of friction that has grown, and of its waves over the position."""
    q, v, sign = scene.motion.q[:, 0], scene.motion.dq[:, 0], scene.sign[:, 0]
    waves = 1.0 + 0.15 * np.sin(q + 0.4)
    return np.asarray(MORE * (COULOMB[0] * waves * sign + VISCOUS[0] * v))


@pytest.fixture(scope="module")
def scenes() -> list[Scene]:
    return arm_scenes(at_joint(0, worn), noise=(0.02, 0.02))


def test_friction_that_has_grown_is_told_by_its_name_and_size(
    scenes: list[Scene],
) -> None:
    found = selected(scenes, LAWS, stages=known_friction(scenes[0]))
    told = {taken.term.key: taken for taken in found.terms}
    assert ("friction_change", 0) in told
    change = told["friction_change", 0]
    coulomb, viscous = change.model.coefficients(change.term)
    assert coulomb == pytest.approx(MORE * COULOMB[0], rel=0.1)
    assert viscous == pytest.approx(MORE * VISCOUS[0], rel=0.1)


def test_nothing_has_changed_where_the_file_holds() -> None:
    scenes = arm_scenes(noise=(0.02, 0.02))
    assert selected(scenes, LAWS, stages=known_friction(scenes[0])).terms == ()


def from_the_second_log(torque: Extra) -> Extra:
    """Return a torque that is not there in the first log."""
    return lambda scene: torque(scene) * float(scene.log >= 1)


CHANGES = ("friction_change", "torque_constant", "torque_bias", "payload")


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "torque"),
    [
        ("friction_change", worn),
        ("torque_constant", lambda scene: 0.1 * scene.modelled[:, 0]),
    ],
)
def test_what_changes_between_two_logs_has_its_name_and_the_log(
    name: str, torque: Callable[[Scene], Array]
) -> None:
    scenes = arm_scenes(from_the_second_log(at_joint(0, torque)), noise=(0.05, 0.05))
    found = selected(scenes, CHANGES, stages=known_friction(scenes[0]))
    assert [taken.term.key for taken in found.terms] == [(name, 0)]
    assert found.terms[0].term.what.settings == {"from_log": 1.0}


def test_causes_compete_beside_the_file_as_it_is(scenes: list[Scene]) -> None:
    model = model_of(scenes, HELD, known_friction(scenes[0]))
    model.rescale()
    assert model.hold.of(0) > 3.0  # the base alone takes it up
    first, *others = causes_at(model, 0, [])
    assert (first.term.name, first.term.joint) == ("friction_change", 0)
    assert first.probability > 0.5
    assert sum(cause.probability for cause in (first, *others)) <= 1.0
    assert all(cause.log_gain <= first.log_gain for cause in others)
