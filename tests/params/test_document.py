from __future__ import annotations

import re

from seqid_cli import __version__
from seqid_cli.params.document import present, stale_stages, with_stage
from tests.params.documents import (
    friction_file,
    friction_stage,
    full_file,
    gravity_file,
    imu_stage,
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


def test_a_stage_done_again_replaces_itself_and_its_inputs() -> None:
    again = with_stage(gravity_file(), robot(), [log("x", "gravity")], gravity=rigid_stage("N m"))
    assert again.stages.gravity == rigid_stage("N m")
    assert [item.path for item in again.inputs] == ["a", "x"]


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


def test_an_independent_stage_is_kept() -> None:
    file = with_stage(gravity_file(), robot(), [], imu=imu_stage())
    assert list(present(file.stages)) == ["friction", "gravity", "imu"]
