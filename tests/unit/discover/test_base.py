"""The base's columns: what they give is the torque of a model with other parameters."""

from dataclasses import replace

import numpy as np
import pytest

from seqid_cli.discover.base import base_of
from seqid_cli.discover.survey.rows import rows_of
from seqid_cli.model.effects.scene import Scene
from seqid_cli.params.schema import FrictionJoint, FrictionStage, Parameter, RigidStage, Stages
from seqid_cli.robot.base_parameters import free_basis, standard_names
from tests import Array
from tests.plants.robots.made import friction_joint
from tests.plants.robots.two_joint import COULOMB, SIGN_WIDTH, VISCOUS
from tests.unit.discover.arms import arm_scenes

SHIFT = 0.003  # s
TOP = 4.0  # rad/s, of the friction stage


@pytest.fixture(scope="module")
def scenes() -> list[Scene]:
    return arm_scenes(logs=2, seconds=8.0)


def heavier(scene: Scene) -> tuple[Array, Array]:
    """Torque (N, n) of links changed at random, and the change of base parameters (b,)."""
    basis = free_basis(scene.robot)
    delta = np.random.default_rng(2).normal(size=len(standard_names(scene.robot.n)))
    delta[-scene.robot.n :] = 0.0  # rotors are known
    phi = scene.model.phi + delta[: -scene.robot.n].reshape(scene.model.phi.shape)
    motion = scene.motion
    torque = replace(scene.model, phi=phi).rigid(motion.q, motion.dq, motion.ddq)
    return torque - scene.rigid, basis.expression @ delta


def test_columns_give_the_torque_of_other_parameters(scenes: list[Scene]) -> None:
    rows = rows_of(scenes)
    base = base_of(rows, Stages())
    changes = [heavier(scene) for scene in scenes]
    expected = [s.motion.filtered(c[0]) for s, c in zip(scenes, changes, strict=True)]
    theta = changes[0][1]
    for j in range(rows.n):
        np.testing.assert_allclose(base.rigid[j] @ theta, rows.torque(j, expected)[:, j], atol=1e-9)
    found = base.deviation(theta, [np.zeros(2), np.zeros(2)])
    for whole, other in zip(found, expected, strict=True):
        np.testing.assert_allclose(whole, other, atol=1e-5 * np.abs(other).max())


def test_more_friction_and_late_torque(scenes: list[Scene]) -> None:
    rows = rows_of(scenes)
    base = base_of(rows, Stages())
    rub = np.array([0.4, 0.3])
    late = []
    for scene in scenes:
        more = 0.4 * scene.sign + 0.3 * scene.motion.dq
        late.append(scene.motion.filtered(more, times=2))
        slope = np.gradient(scene.modelled_filtered, 1.0 / scene.motion.rate_hz, axis=0)
        late[-1] = late[-1] - SHIFT * slope
    for j in range(rows.n):
        found = base.friction[j] @ rub - SHIFT * base.timing[j][:, 0]
        np.testing.assert_allclose(found, rows.torque(j, late)[:, j], atol=0.02)


def rigid_stage(names: list[str], covariance: Array) -> RigidStage:
    parameters = [Parameter(name=n, value=1.0, std_error=0.1, unit="kg m") for n in names]
    size = len(names)
    return RigidStage(
        parameters=parameters, condition=1.0, rank=size, covariance=covariance.tolist()
    )


def test_priors_are_the_files_covariances(scenes: list[Scene]) -> None:
    names = free_basis(scenes[0].robot).names
    known = [names[3], names[0]]
    covariance = np.array([[0.04, 0.01], [0.01, 0.09]])
    stages = Stages(inertia=rigid_stage(known, covariance))
    base = base_of(rows_of(scenes), stages)
    P = base.prior_rigid.T @ base.prior_rigid
    at = [3, 0]
    np.testing.assert_allclose(P[np.ix_(at, at)], np.linalg.inv(covariance), rtol=1e-9)
    rest = [k for k in range(len(names)) if k not in at]
    assert not P[rest].any()


def joint_friction(*, covariance: Array, parameters: tuple[Parameter, ...] = ()) -> FrictionJoint:
    half = 0.5 * VISCOUS[0] * TOP
    return friction_joint(
        [[COULOMB[0] + half, half]],
        speed_range=[0.0, TOP],
        sign_width=SIGN_WIDTH,
        covariance=covariance.tolist(),
        parameters=list(parameters),
    )


def test_friction_of_a_surface_has_its_terms_and_a_drag_beyond(scenes: list[Scene]) -> None:
    joint = joint_friction(covariance=np.diag([0.04, 0.25]))
    stages = Stages(friction=FrictionStage(joints={"joint_1": joint, "joint_2": joint}))
    base = base_of(rows_of(scenes), stages)
    P = base.prior_friction[0].T @ base.prior_friction[0]
    np.testing.assert_allclose(P, np.diag([25.0, 4.0, 0.0]), atol=1e-9)
    # Coulomb and viscous friction in the surface's own terms, and viscous friction beyond them.
    motion, sign = scenes[0].motion, scenes[0].sign[:, 0]
    half = 0.5 * VISCOUS[0] * TOP
    held = np.minimum(np.abs(motion.dq[:, 0]), TOP)
    beyond = (np.abs(motion.dq[:, 0]) - held) * np.sign(motion.dq[:, 0])
    law = (COULOMB[0] + VISCOUS[0] * held) * sign + (VISCOUS[0] + 0.7) * beyond
    own = motion.filtered(law, times=2)
    coefficients = np.array([COULOMB[0] + half, half, 0.7])
    found = base.whole[0].friction([coefficients, coefficients])[:, 0]
    np.testing.assert_allclose(found, own, atol=1e-9)


def test_friction_of_a_simultaneous_fit_has_as_many_terms_as_that(scenes: list[Scene]) -> None:
    for count in (2, 3):
        names = ("coulomb", "viscous", "offset")[:count]
        parameters = tuple(
            Parameter(name=name, value=1.0, std_error=0.5, unit="N m") for name in names
        )
        joint = joint_friction(covariance=np.eye(2), parameters=parameters)
        stages = Stages(friction=FrictionStage(joints={"joint_1": joint, "joint_2": joint}))
        base = base_of(rows_of(scenes), stages)
        assert base.friction[1].shape[1] == count
        np.testing.assert_allclose(base.prior_friction[1], 2.0 * np.eye(count))
