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
from tests.commands.transcripts import check_transcript
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


def test_what_the_other_stages_show(rig: Rig, reader: Reader, identified: Replace) -> None:
    """Nothing to identify, IMUs, inertia, stages that are stale, and everything at once."""
    rig.params("f.json", friction_file())
    rig.params("full.json", full_file())
    empty = RigidStage(parameters=[], condition=0.0, rank=0, notes=["the arm is planar"])
    identified("rigid.gravity", "identify_gravity", empty)
    identified("imu_calibration.calibrate", "calibrate_imus", imu_stage())
    identified("rigid.inertia", "identify_inertia", rigid_stage("kg m^2"))
    found = (friction_stage(), rigid_stage())
    identified("rigid.simultaneous", "identify_simultaneous", found)
    with (rig.folder / "robot.toml").open("a") as file:
        file.write("# changed\n")
    check_transcript(rig, "stages")
    assert read_parameters(rig.folder / "g.json").stages.gravity == empty
    again = read_parameters(rig.folder / "again.json").stages
    assert again.inertia is None
    assert again.imu is not None


def test_json_is_the_file(rig: Rig, reader: Reader, identified: Replace) -> None:
    identified("friction_surface.stage", "identify_friction", friction_stage())
    reader.warnings = ("jitter is 20 %",)
    done = rig.run("friction", *COMMON, "--json")
    assert done.out == (rig.folder / "out.json").read_text()
    jsonschema.validate(json.loads(done.out), json_schema(SCHEMA))
    assert "warning: a.parquet: jitter is 20 %" in done.err


def test_what_friction_shows(rig: Rig, reader: Reader, identified: Replace) -> None:
    identified("friction_surface.stage", "identify_friction", friction_stage())
    check_transcript(rig, "friction")


@pytest.mark.parametrize("name", ["poor", "faulty", "partial"])
def test_what_is_poor(rig: Rig, reader: Reader, identified: Replace, name: str) -> None:
    """A verdict of the stage itself, errors in its logs, and logs that are read in part."""
    stage = friction_stage(good=name != "poor")
    identified("friction_surface.stage", "identify_friction", stage)
    if name == "faulty":
        fault = found("sign_mismatch", "it would gain", joint="elbow", channel="torque")
        reader.findings = (fault,)
    elif name == "partial":
        reader.partial = "the last 12 of 40 chunks are damaged"
    check_transcript(rig, f"friction_{name}")
    verdicts = read_parameters(rig.folder / "out.json").stages.friction.verdicts
    poor = {v.joint: v.reason for v in verdicts if not v.good}
    if name == "faulty":
        assert poor.keys() == {"elbow", ""}
        assert "a.parquet and 1 more log: torque it would gain" in poor["elbow"]
        assert poor[""].endswith("not good: elbow")
    assert bool(poor) == (name != "partial")
