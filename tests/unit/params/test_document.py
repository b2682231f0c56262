import re

from seqid_cli import __version__
from seqid_cli.params.document import present, refined, stale_stages, with_stage
from seqid_cli.params.schema import EffectOfJoint, Stages
from tests.unit.params.documents import (
    closed_loop,
    friction_file,
    friction_stage,
    full_file,
    inertia_file,
    log,
    rigid_stage,
    robot,
)


def test_a_stage_is_added_to_what_was_there() -> None:
    before = friction_file()
    after = with_stage(before, robot(), [log("b", "gravity")], gravity=rigid_stage())
    assert after.stages.friction == before.stages.friction
    assert after.stages.gravity == rigid_stage()
    assert [(item.path, item.stage) for item in after.inputs] == [
        ("a", "friction"),
        ("b", "gravity"),
    ]
    assert before.stages.gravity is None
    assert after.tool.version == __version__
    assert re.fullmatch(r"\d{4}-\d\d-\d\dT\d\d:\d\d:\d\dZ", after.created)


def test_what_rested_on_a_stage_goes_when_it_is_done_again() -> None:
    file = full_file()
    assert stale_stages(file, ["friction"]) == ("gravity", "inertia", "effects")
    assert stale_stages(file, ["imu"]) == ("inertia", "effects")
    assert stale_stages(file, ["friction", "inertia"]) == ("gravity", "effects")
    assert stale_stages(None, ["friction"]) == ()
    assert stale_stages(friction_file(), ["gravity"]) == ()
    again = with_stage(file, robot(), [], friction=friction_stage(good=False))
    assert list(present(again.stages)) == ["friction", "imu"]
    assert [item.stage for item in again.inputs] == ["imu"]
    assert again.closed_loop is None


def test_a_refined_file_keeps_every_input_and_replaces_the_stages() -> None:
    before = inertia_file()
    new = Stages(
        friction=friction_stage(good=False),
        inertia=rigid_stage("N m"),
        effects=[EffectOfJoint(effect="stribeck", joint="elbow")],
    )
    after = refined(before, robot(), [log("e", "effects")], new, closed_loop())
    assert after.stages.friction == new.friction
    assert after.stages.gravity == before.stages.gravity
    assert after.stages.imu == before.stages.imu
    assert after.stages.effects == new.effects
    assert after.inputs == [*before.inputs, log("e", "effects")]
    assert after.closed_loop == closed_loop()


def test_a_refinement_without_result_says_that_there_are_no_effects() -> None:
    before = inertia_file()
    after = refined(before, robot(), [], before.stages, closed_loop())
    assert after.stages.effects == []
    assert refined(full_file(), robot(), [], Stages(), closed_loop()).stages.effects == (
        full_file().stages.effects
    )
