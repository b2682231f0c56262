"""The stage commands around fake identification: what they pass on, write, print and return."""

import json
from collections.abc import Callable

import jsonschema
import pytest

from seqid_cli.identify.options import FrictionOptions, InertiaOptions
from seqid_cli.inspect.findings import found
from seqid_cli.motion.options import MotionOptions
from seqid_cli.params.io import read_parameters
from seqid_cli.params.schema import SCHEMA, RigidStage
from seqid_cli.robot.types import Robot
from tests.commands.conftest import SAMPLES, Reader, Rig
from tests.unit.params.documents import (
    friction_file,
    friction_stage,
    full_file,
    gravity_file,
    imu_stage,
    rigid_stage,
)
from tests.unit.params.generate import json_schema

Replace = Callable[[str, str, object], list[object]]
COMMON = ["a.parquet", "b.parquet", "-r", "robot.toml", "-o", "out.json"]


def test_friction(rig: Rig, reader: Reader, identified: Replace) -> None:
    calls = identified("friction_surface.stage", "identify_friction", friction_stage())
    options = ["--position-order", "4", "--velocity-order", "5", "--beta", "0.1", "--cutoff", "20"]
    done = rig.run("friction", *COMMON, *options, "--time", "log")
    assert done.code == 0
    count, robot, given = calls
    assert count == 2
    assert isinstance(robot, Robot)
    assert given == FrictionOptions(
        cutoff_hz=20.0, time_source="log", position_order=4, velocity_order=5, beta=0.1
    )
    assert reader.time_source == "log"
    file = read_parameters(rig.folder / "out.json")
    assert [(log.path, log.samples, log.stage) for log in file.inputs] == [
        ("a.parquet", SAMPLES, "friction"),
        ("b.parquet", SAMPLES, "friction"),
    ]
    assert file.robot.sha256 == robot.sha256
    assert done.out.splitlines()[0].split()[:2] == ["joint", "orders"]
    assert done.out.splitlines()[1].endswith("good")
    assert "next: seqid gravity LOG... -r robot.toml -p out.json -o gravity.json" in done.err


def test_the_other_stages_build_on_what_was_there(
    rig: Rig, reader: Reader, identified: Replace
) -> None:
    before = rig.params("p.json", gravity_file())
    identified("imu_calibration.calibrate", "calibrate_imus", imu_stage())
    assert rig.run("imu-calib", *COMMON, "-p", before).code == 0
    assert read_parameters(rig.folder / "out.json").stages.gravity is not None

    calls = identified("rigid.inertia", "identify_inertia", rigid_stage("kg m^2"))
    arguments = ["a.parquet", "-r", "robot.toml", "-p", "out.json", "-o", "final.json"]
    assert rig.run("inertia", *arguments, "--motion", "imu").code == 0
    assert calls[3] == InertiaOptions(MotionOptions(), "imu")
    file = read_parameters(rig.folder / "final.json")
    stages = file.stages
    assert None not in (stages.friction, stages.gravity, stages.imu, stages.inertia)
    assert [log.stage for log in file.inputs] == ["friction", "gravity", "imu", "imu", "inertia"]


@pytest.mark.parametrize("offset", [False, True])
def test_simultaneous(rig: Rig, reader: Reader, identified: Replace, offset: bool) -> None:
    found = (friction_stage(), rigid_stage())
    calls = identified("rigid.simultaneous", "identify_simultaneous", found)
    assert rig.run("simultaneous", *COMMON, *([] if offset else ["--no-offset"])).code == 0
    assert calls[-1] is offset
    stages = read_parameters(rig.folder / "out.json").stages
    assert stages.friction is not None
    assert stages.inertia is not None
    assert stages.gravity is None


def test_a_stage_with_nothing_to_identify(rig: Rig, reader: Reader, identified: Replace) -> None:
    before = rig.params("p.json", friction_file())
    empty = RigidStage(parameters=[], condition=0.0, rank=0, notes=["the arm is planar"])
    identified("rigid.gravity", "identify_gravity", empty)
    done = rig.run("gravity", *COMMON, "-p", before)
    assert done.code == 0
    assert "gravity: nothing to identify on this robot" in done.out
    assert "note: the arm is planar" in done.err
    assert read_parameters(rig.folder / "out.json").stages.gravity == empty


def test_stale_stages_are_left_out_and_named(rig: Rig, reader: Reader, identified: Replace) -> None:
    before = rig.params("p.json", full_file())
    identified("rigid.gravity", "identify_gravity", rigid_stage())
    done = rig.run("gravity", *COMMON, "-p", before)
    assert "warning: the inertia stage rested on the old result" in done.err
    stages = read_parameters(rig.folder / "out.json").stages
    assert stages.inertia is None
    assert stages.imu is not None


def test_json_is_the_file(rig: Rig, reader: Reader, identified: Replace) -> None:
    identified("friction_surface.stage", "identify_friction", friction_stage())
    reader.warnings = ("jitter is 20 %",)
    done = rig.run("friction", *COMMON, "--json")
    assert done.out == (rig.folder / "out.json").read_text()
    jsonschema.validate(json.loads(done.out), json_schema(SCHEMA))
    assert "warning: a.parquet: jitter is 20 %" in done.err


def test_without_output_nothing_is_written(rig: Rig, reader: Reader, identified: Replace) -> None:
    identified("friction_surface.stage", "identify_friction", friction_stage())
    before = set(rig.folder.iterdir())
    done = rig.run("friction", "a.parquet", "-r", "robot.toml")
    assert done.code == 0
    assert "good" in done.out
    assert "Nothing was written" in done.err
    assert set(rig.folder.iterdir()) == before


@pytest.mark.parametrize(("strict", "code"), [([], 0), (["--strict"], 1)])
def test_a_poor_verdict(
    rig: Rig, reader: Reader, identified: Replace, strict: list[str], code: int
) -> None:
    identified("friction_surface.stage", "identify_friction", friction_stage(good=False))
    done = rig.run("friction", *COMMON, *strict)
    assert done.code == code
    assert done.out.splitlines()[2].endswith("poor: only 1 speed, 3 are needed")
    assert (rig.folder / "out.json").exists()
    assert "next:" not in done.err
    assert "do: look at the reasons above" in done.err


@pytest.mark.parametrize(("strict", "code"), [([], 0), (["--strict"], 1)])
def test_an_error_in_a_log_makes_its_joint_poor(
    rig: Rig, reader: Reader, identified: Replace, strict: list[str], code: int
) -> None:
    identified("friction_surface.stage", "identify_friction", friction_stage())
    reader.findings = (found("sign_mismatch", "it would gain", joint="elbow", channel="torque"),)
    done = rig.run("friction", *COMMON, *strict)
    assert done.code == code
    assert "a.parquet: [sign_mismatch] elbow torque: it would gain" in done.err
    assert "next:" not in done.err
    assert f"do: {reader.findings[0].remedy}" in done.err
    stage = read_parameters(rig.folder / "out.json").stages.friction
    poor = {v.joint: v.reason for v in stage.verdicts if not v.good}
    assert poor.keys() == {"elbow", ""}
    assert "a.parquet and 1 more log: torque it would gain" in poor["elbow"]
    assert poor[""].endswith("not good: elbow")


def test_a_partly_read_log(rig: Rig, reader: Reader, identified: Replace) -> None:
    identified("friction_surface.stage", "identify_friction", friction_stage())
    reader.partial = "the last 12 of 40 chunks are damaged"
    done = rig.run("friction", *COMMON)
    assert done.code == 3
    assert "a.parquet: only partly read: the last 12 of 40 chunks are damaged" in done.err
    assert (rig.folder / "out.json").exists()
    identified("friction_surface.stage", "identify_friction", friction_stage(good=False))
    assert rig.run("friction", *COMMON, "--strict").code == 1


def test_quiet_and_verbose(rig: Rig, reader: Reader, identified: Replace) -> None:
    identified("friction_surface.stage", "identify_friction", friction_stage())
    quiet = rig.run("friction", *COMMON, "-q")
    assert quiet.err == ""
    assert "good" in quiet.out
    assert "b.parquet: 5 samples at 100 Hz" in rig.run("friction", *COMMON, "-v").err


def test_a_changed_robot_file_is_a_warning(rig: Rig, reader: Reader, identified: Replace) -> None:
    before = rig.params("p.json", friction_file())
    with (rig.folder / "robot.toml").open("a") as file:
        file.write("# changed\n")
    identified("rigid.gravity", "identify_gravity", rigid_stage())
    done = rig.run("gravity", *COMMON, "-p", before)
    assert done.code == 0
    assert "p.json: the robot file robot.toml has changed" in done.err
