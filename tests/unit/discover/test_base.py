"""The base's columns: what they give is the torque of a model with other parameters."""

from dataclasses import replace

import numpy as np
import pytest
from msgspec import structs

from seqid_cli.discover.base import LIKELY, base_of
from seqid_cli.discover.nuisances import THERMAL, nuisances_of
from seqid_cli.discover.survey.rows import rows_of
from seqid_cli.effects.scene import Scene
from seqid_cli.identify.nuisances import PRIORS, with_term
from seqid_cli.model.friction import FrictionSurface
from seqid_cli.params.schema import FrictionJoint, FrictionStage, Nuisance, Stages
from seqid_cli.robot.base_parameters import free_basis
from tests import Array
from tests.plants.robots.made import friction_joint
from tests.plants.robots.two_joint import COULOMB, SIGN_WIDTH, VISCOUS
from tests.unit.discover.arms import arm_scenes, file_of, selected

TOP = 4.0  # rad/s, of the friction stage
HALF = 0.5 * VISCOUS[0] * TOP


@pytest.fixture(scope="module")
def scenes() -> list[Scene]:
    return arm_scenes(logs=2, seconds=8.0)


def heavier(scene: Scene) -> tuple[Array, Array]:
    """Torque (N, n) of links changed at random, and what parameters changed by (b,)."""
    delta = np.random.default_rng(2).normal(size=scene.model.phi.shape)
    motion, model = scene.motion, replace(scene.model, phi=scene.model.phi + delta)
    more = model.rigid(motion.q, motion.dq, motion.ddq) - scene.rigid
    known = np.append(delta, np.zeros(scene.robot.n))  # rotors
    return more, free_basis(scene.robot).expression @ known


def test_columns_give_the_torque_of_other_parameters(scenes: list[Scene]) -> None:
    rows = rows_of(scenes)
    base = base_of(rows, Stages())
    changes = [heavier(scene) for scene in scenes]
    expected = [s.motion.filtered(c[0]) for s, c in zip(scenes, changes, strict=True)]
    theta = changes[0][1]
    for j in range(rows.n):
        np.testing.assert_allclose(
            base.rigid[j] @ theta, rows.torque(j, expected)[:, j], atol=1e-9
        )
    found = base.deviation(theta, [np.zeros(2), np.zeros(2)])
    for whole, other in zip(found, expected, strict=True):
        np.testing.assert_allclose(whole, other, atol=1e-5 * np.abs(other).max())


def test_friction_of_a_surface_has_its_terms_and_a_drag_beyond(
    scenes: list[Scene],
) -> None:
    joint = friction_joint(
        [[COULOMB[0] + HALF, HALF]],
        speed_range=[0.0, TOP],
        sign_width=SIGN_WIDTH,
        covariance=[[0.04, 0.0], [0.0, 0.25]],
    )
    stages = Stages(friction=FrictionStage(joints={"joint_1": joint, "joint_2": joint}))
    base = base_of(rows_of(scenes), stages)
    P = base.prior[1].T @ base.prior[1]
    np.testing.assert_allclose(P, np.diag([25.0, 4.0, 0.0]), atol=1e-9)
    # Coulomb and viscous friction in the surface's own terms, and viscous friction
    # beyond them.
    motion, sign = scenes[0].motion, scenes[0].sign[:, 0]
    held = np.minimum(np.abs(motion.dq[:, 0]), TOP)
    beyond = (np.abs(motion.dq[:, 0]) - held) * np.sign(motion.dq[:, 0])
    law = (COULOMB[0] + VISCOUS[0] * held) * sign + (VISCOUS[0] + 0.7) * beyond
    own = motion.filtered(law, times=2)
    coefficients = np.array([COULOMB[0] + HALF, HALF, 0.7])
    still = np.zeros(base.basis.size)
    found = base.deviation(still, [coefficients, coefficients])[0][:, 0]
    np.testing.assert_allclose(found, own, atol=1e-9)


def test_a_drag_beyond_the_trials_is_bounded_by_what_it_adds_there(
    scenes: list[Scene],
) -> None:
    """Its torque is no more than likely where it has any, though few rows show it."""
    top = scenes[0].model.surfaces[0].scaling.speed[1]
    fastest = max(np.abs(scene.motion.dq[:, 0]).max() for scene in scenes)
    assert fastest > top
    joint = friction_joint(
        [[COULOMB[0] + HALF, HALF]], speed_range=[0.0, TOP], sign_width=SIGN_WIDTH
    )
    stages = Stages(friction=FrictionStage(joints={"joint_1": joint, "joint_2": joint}))
    base = base_of(rows_of(scenes), stages)
    size = 1.0 / base.bounds[1][-1]
    torque = size * np.maximum(
        np.abs(np.concatenate([s.motion.dq[:, 0] for s in scenes])) - top, 0.0
    )
    usual = np.sqrt(np.mean(torque[torque > 0.0] ** 2))
    assert usual == pytest.approx(LIKELY * base.start[0], rel=0.01)


def test_a_delay_changes_the_torque_as_it_is_logged(scenes: list[Scene]) -> None:
    """Torque 23 ms early: a millisecond more is the slope of the torque where it is."""
    joint = 0
    early = np.zeros(scenes[0].robot.n)
    early[joint] = -0.023
    earlier = early.copy()
    earlier[joint] -= 0.001
    (scene, *_) = scenes
    delayed = replace(scene, model=replace(scene.model, delays_s=early))
    further = replace(scene.model, delays_s=earlier)

    (of_joint, *_) = nuisances_of([delayed], Stages())
    torque = scene.modelled_filtered
    change = further.late(torque, scene.motion) - delayed.model.late(
        torque, scene.motion
    )
    expected = change[100:-100, joint]
    (column,) = of_joint.columns[joint]
    error = -0.001 * column[100:-100] - expected
    assert np.std(error) < 0.05 * np.std(expected)


def warm_joint(std_error: float) -> FrictionJoint:
    """Friction at 25 degC that grows by 1 % per kelvin, and whose trials were warm."""
    return friction_joint(
        [[COULOMB[0] + HALF, HALF]],
        speed_range=[0.0, TOP],
        sign_width=SIGN_WIDTH,
        temperature=25.0,
        covariance=[[0.04, 0.0], [0.0, 0.25]],
        term_moves={"thermal": [-3.0, -1.0]},
        nuisances=[
            Nuisance(
                name="thermal",
                joint="joint_1",
                value=0.01,
                std_error=std_error,
                unit="1/K",
            )
        ],
    )


def at(scene: Scene, celsius: float, joint: FrictionJoint) -> Scene:
    """Return a scene at a temperature, with a file's friction at its first joint."""
    motion = replace(scene.motion, celsius=np.full_like(scene.motion.q, celsius))
    surfaces = [FrictionSurface.from_stage(joint), scene.model.surfaces[1]]
    model = replace(scene.model, surfaces=surfaces)
    return replace(scene, motion=motion, model=model)


def test_what_warmth_makes_of_friction_is_known_as_well_as_the_file_says(
    scenes: list[Scene],
) -> None:
    """Its column is the torque of a file with another estimate."""
    (scene, *_) = scenes
    joint = warm_joint(0.006)
    stages = Stages(friction=FrictionStage(joints={"joint_1": joint}))
    warm = at(scene, 31.0, joint)
    *_, term = nuisances_of([warm], stages)
    assert term.name == THERMAL
    assert term.std == 0.006

    other = at(scene, 31.0, with_term(joint, THERMAL, 0.015, 0.006))
    expected = (other.modelled_filtered - warm.modelled_filtered)[:, 0]
    slides = warm.slides[:, 0]
    (column,) = term.columns[0]
    error = (0.005 * column - expected)[slides]
    assert np.std(expected[slides]) > 0.01
    assert np.std(error) < 0.05 * np.std(expected[slides])


def test_what_no_log_of_a_file_has_shown_of_warmth_is_left_to_effects(
    scenes: list[Scene],
) -> None:
    joint = warm_joint(PRIORS.per_kelvin)
    stages = Stages(friction=FrictionStage(joints={"joint_1": joint}))
    terms = nuisances_of([at(scenes[0], 31.0, joint)], stages)
    assert THERMAL not in {term.name for term in terms}


SLOWEST = 2.0  # rad/s, of friction trials


def seen_by_fast_trials(scene: Scene) -> tuple[Scene, Stages]:
    """Return a scene with a file whose trials were no slower than `SLOWEST`.

    Its friction holds below that, and the arm's own goes on.
    """
    half = 0.5 * VISCOUS[0] * (TOP - SLOWEST)
    middle = COULOMB[0] + 0.5 * VISCOUS[0] * (TOP + SLOWEST)
    joint = friction_joint(
        [[middle, half]],
        speed_range=[SLOWEST, TOP],
        sign_width=SIGN_WIDTH,
        covariance=(1e-6 * np.eye(2)).tolist(),
    )
    surfaces = [FrictionSurface.from_stage(joint), scene.model.surfaces[1]]
    fast = replace(scene, model=replace(scene.model, surfaces=surfaces))
    file = file_of(scene)
    return fast, structs.replace(
        file, friction=FrictionStage(joints={"joint_1": joint})
    )


def test_friction_below_the_slowest_trial_is_no_effect(scenes: list[Scene]) -> None:
    files = [seen_by_fast_trials(scene) for scene in scenes]
    logs = [scene for scene, _ in files]
    _, stages = files[0]
    at_file = base_of(rows_of(logs), stages)
    found = selected(logs, ["nonlinear_viscous", "friction_change"], stages=stages)
    assert at_file.start[0] > 5.0 * found.model.rms()[0]
    assert found.terms == ()
