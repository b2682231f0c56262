"""What a refinement keeps of the file that came in: smooth terms, what came late, and
how its stages were identified.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from msgspec import structs

from seqid_cli.discover.candidates import Candidate
from seqid_cli.discover.options import DiscoverOptions
from seqid_cli.discover.refinement.held_out import held_out_error
from seqid_cli.discover.refinement.loop import with_effects
from seqid_cli.discover.refinement.reidentify import (
    RefinementData,
    Refitted,
    refitted,
)
from seqid_cli.discover.refinement.rounds import on_the_same_samples
from seqid_cli.effects.fitted import FittedEffect, as_stage, fitted_effects
from seqid_cli.effects.registry import CATALOGUE
from seqid_cli.effects.smooth import Axis, SmoothTerm
from seqid_cli.identify.friction_surface.stage import identify_friction
from seqid_cli.identify.options import FrictionOptions, InertiaOptions, RigidOptions
from seqid_cli.identify.recipe import (
    friction_options,
    friction_recipe,
    rigid_recipe,
    stage_settings,
)
from seqid_cli.identify.rigid.gravity import identify_gravity
from seqid_cli.identify.rigid.inertia import identify_inertia
from seqid_cli.identify.settings import FrictionSettings, SurfaceSettings
from seqid_cli.logs.recording import Recording
from seqid_cli.params.document import used_settings
from seqid_cli.params.schema import FrictionStage, Stages
from tests.plants.robots.sample import sample_rig

RIG = sample_rig("one_joint")
SPRING = Candidate(CATALOGUE["spring"], 0, {"cubic": 0.0})
OFFSET = 0.004  # N m, that a smooth term of an earlier refinement stands for
KNOTS = tuple(np.linspace(-3.2, 3.2, 4).tolist())
ORDERS = FrictionOptions(position_order=1, velocity_order=2, beta=0.2)
NARROW = FrictionSettings(surface=SurfaceSettings(sign_narrowness=10.0))


def smooth_offset() -> SmoothTerm:
    """Return a constant torque, as a smooth function of the position."""
    axis = Axis("position", 0, KNOTS)
    return SmoothTerm(
        joint=0,
        quantities=("position",),
        axes=(axis,),
        factor="one",
        coefficients=np.full(axis.size, OFFSET),
    )


def stages_of(logs: dict[str, list[Recording]]) -> Stages:
    """Return the stages with few orders, and what was asked of them."""
    robot = RIG.robot
    friction = identify_friction(
        logs["friction"], robot, options=ORDERS, settings=NARROW
    )
    friction.recipe = friction_recipe(ORDERS)
    friction.settings = used_settings(NARROW)
    result = identify_gravity(logs["gravity"], robot, Stages(friction=friction))
    stages = Stages(friction=result.friction, gravity=result.gravity)
    inertia = identify_inertia(logs["inertia"], robot, stages, options=InertiaOptions())
    stages.friction = inertia.friction
    stages.inertia = inertia.inertia
    stages.inertia.recipe = rigid_recipe(RigidOptions(consistent=True))
    return stages


@pytest.fixture(scope="module")
def earlier() -> dict[str, list[Recording]]:
    friction = RIG.logs("friction")
    gravity = [*RIG.logs("gravity")[:1], *friction]
    return {"friction": friction, "gravity": gravity, "inertia": RIG.logs("inertia")}


@pytest.fixture(scope="module")
def file_stages(earlier: dict[str, list[Recording]]) -> Stages:
    return stages_of(earlier)


def changed() -> list[Recording]:
    """Return the logs in which a hose pulls at the joint."""
    return [log for log in RIG.logs("changed") if log.path.stem != "held_out"]


def material(
    training: list[Recording],
    earlier: dict[str, list[Recording]],
    stages: Stages,
    **more: object,
) -> RefinementData:
    options = on_the_same_samples(DiscoverOptions(), stages, RIG.robot)
    return RefinementData(tuple(training), earlier, RIG.robot, options, **more)


@pytest.mark.slow
@pytest.mark.parametrize("kept", [True, False])
def test_smooth_terms_stay_beside_an_effect(
    file_stages: Stages, earlier: dict[str, list[Recording]], *, kept: bool
) -> None:
    """Whether stages stay or not, effects are fitted to what smooth terms leave."""
    logs = changed()
    alone = refitted(
        material(logs, earlier, file_stages),
        Refitted(file_stages, ()),
        [SPRING],
        kept=kept,
    )
    term = smooth_offset()
    with_offset = [replace(log, tau=log.tau + OFFSET) for log in logs]
    beside = refitted(
        material(with_offset, earlier, file_stages),
        Refitted(file_stages, (term,)),
        [SPRING],
        kept=kept,
    )
    (effect, stayed) = beside.effects
    assert stayed is term
    np.testing.assert_allclose(
        effect.coefficients, alone.effects[0].coefficients, rtol=1e-6
    )
    # Without an effect as well.
    assert refitted(
        material(with_offset, earlier, file_stages),
        Refitted(file_stages, (term,)),
        [],
        kept=kept,
    ).effects == (term,)


@pytest.mark.slow
def test_a_stage_is_identified_again_by_its_recipe(
    file_stages: Stages, earlier: dict[str, list[Recording]]
) -> None:
    """Of a spring that was there all along, in all logs."""
    with_spring = {
        stage: [replace(log, tau=log.tau + 0.005 * log.q) for log in logs]
        for stage, logs in earlier.items()
    }
    anew = refitted(
        material(with_spring["inertia"], with_spring, file_stages),
        Refitted(file_stages, ()),
        [SPRING],
        kept=False,
    ).stages
    old_joint = file_stages.friction.joints["joint_1"]
    joint = anew.friction.joints["joint_1"]
    assert joint != old_joint
    assert (joint.position_order, joint.velocity_order) == (1, 2)
    assert joint.beta == ORDERS.beta
    assert joint.sign_width == pytest.approx(old_joint.sign_width, rel=1e-3)
    assert any("physically consistent" in note for note in anew.inertia.notes)
    for name in ("friction", "gravity", "inertia"):
        old, new = getattr(file_stages, name), getattr(anew, name)
        assert (new.recipe, new.settings) == (old.recipe, old.settings)


@pytest.mark.slow
def test_of_a_part_of_its_trials_a_stage_is_not_identified(
    file_stages: Stages, earlier: dict[str, list[Recording]]
) -> None:
    """It moves as the logs to fit say: its orders and its ranges stay."""
    part = earlier | {"friction": earlier["friction"][:2]}
    given = material(changed(), part, file_stages, incomplete=frozenset({"friction"}))
    anew = refitted(given, Refitted(file_stages, ()), [SPRING], kept=False).stages
    old_joint = file_stages.friction.joints["joint_1"]
    joint = anew.friction.joints["joint_1"]
    assert joint != old_joint
    assert joint.speeds == old_joint.speeds
    assert joint.position_range == old_joint.position_range


def test_recipe_and_settings_come_back_from_a_file() -> None:
    friction = FrictionStage(
        joints={}, recipe=friction_recipe(ORDERS), settings=used_settings(NARROW)
    )
    assert friction_options(friction) == ORDERS
    assert stage_settings(friction, FrictionSettings()) == NARROW
    bare = structs.replace(friction, settings=None, recipe=None)
    assert friction_options(bare) == FrictionOptions()
    assert stage_settings(bare, FrictionSettings()) == FrictionSettings()


def test_each_of_two_ripples_says_when_it_came() -> None:
    ripple = CATALOGUE["torque_ripple"]
    robot = RIG.robot

    def fitted(order: float, *, late: bool) -> FittedEffect:
        settings = {"order": order, "law": 0.0, "lag": 0.0}
        size = len(ripple.coefficients(settings))
        return FittedEffect(
            effect=ripple,
            joint=0,
            settings=settings,
            coefficients=np.ones(size),
            covariance=np.eye(size),
            late=late,
        )

    first, second = fitted(6.0, late=False), fitted(9.0, late=True)
    file = Stages(effects=[as_stage(effect, robot) for effect in (first, second)])
    model = Refitted(Stages(), tuple(fitted_effects(file, robot)))
    assert [effect.late for effect in model.effects] == [False, True]
    assert [effect.settings for effect in model.lasting] == [first.settings]
    assert [candidate.late for candidate in model.candidates] == [False, True]


@pytest.mark.slow
def test_two_models_are_judged_on_the_same_samples(
    file_stages: Stages,
) -> None:
    """One whose friction was identified at fewer speeds counts no fewer samples."""
    joint = file_stages.friction.joints["joint_1"]
    slow, fast = joint.speed_range
    narrow = structs.replace(joint, speed_range=[slow, 0.5 * (slow + fast)])
    other = structs.replace(
        file_stages,
        friction=structs.replace(file_stages.friction, joints={"joint_1": narrow}),
    )
    options = on_the_same_samples(DiscoverOptions(), file_stages, RIG.robot)
    errors = [
        held_out_error(
            changed(),
            RIG.robot,
            with_effects(Refitted(stages, ()), RIG.robot),
            options=options.motion,
        )
        for stages in (file_stages, other)
    ]
    assert 0 < errors[0].outside_samples.sum() < errors[0].samples.sum()
    np.testing.assert_array_equal(errors[0].outside_samples, errors[1].outside_samples)
