"""The stage commands: what they pass on, write, print and return; errors; several
processes.
"""

import importlib.util
import json
import shlex
import shutil
from collections.abc import Callable
from pathlib import Path

import jsonschema
import pyarrow.parquet as pq
import pytest
from msgspec import structs

from seqid_cli.commands.stages import _predict_command
from seqid_cli.errors import ConfigError, QualityError, SeqidError
from seqid_cli.identify.options import FrictionOptions, InertiaOptions
from seqid_cli.identify.rigid.gravity import GravityResult
from seqid_cli.identify.rigid.inertia import InertiaResult
from seqid_cli.identify.settings import FrictionSettings
from seqid_cli.inspect.findings import finding_of
from seqid_cli.motion.options import MotionOptions
from seqid_cli.params.io import read_parameters
from seqid_cli.params.schema import SCHEMA, RigidStage
from tests.commands.conftest import ONE_JOINT, SAMPLES, Reader, Rig
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
    options = [
        "--position-order",
        "4",
        "--velocity-order",
        "5",
        "--beta",
        "0.1",
        "--cutoff",
        "20",
    ]
    done = rig.run("friction", *COMMON, *options, "--time", "log")
    assert done.code == 0
    count, robot, given, settings = calls
    assert settings == FrictionSettings()
    own = {"position_order": 4, "velocity_order": 5, "beta": 0.1}
    assert (count, given) == (
        2,
        FrictionOptions(cutoff_hz=20.0, time_source="log", **own),
    )
    assert reader.reading.time_source == "log"
    file = read_parameters(rig.folder / "out.json")
    assert [(log.path, log.samples, log.stage) for log in file.inputs] == [
        ("a.parquet", SAMPLES, "friction"),
        ("b.parquet", SAMPLES, "friction"),
    ]
    assert file.robot.sha256 == robot.sha256


def test_stages_build_on_what_was_there(
    rig: Rig, reader: Reader, identified: Replace
) -> None:
    before = rig.params("p.json", gravity_file())
    identified("imu_calibration", "calibrate_imus", imu_stage())
    assert rig.run("imu-calib", *COMMON, "-p", before).code == 0
    assert read_parameters(rig.folder / "out.json").stages.gravity is not None

    result = InertiaResult(rigid_stage("kg m^2"), friction_stage())
    calls = identified("rigid.inertia", "identify_inertia", result)
    arguments = ["a.parquet", "-r", "robot.toml", "-p", "out.json", "-o", "final.json"]
    assert rig.run("inertia", *arguments, "--motion", "imu").code == 0
    assert calls[3] == InertiaOptions(motion=MotionOptions(), source="imu")
    file = read_parameters(rig.folder / "final.json")
    stages = file.stages
    assert None not in (stages.friction, stages.gravity, stages.imu, stages.inertia)
    assert [log.stage for log in file.inputs] == [
        "friction",
        "gravity",
        "imu",
        "imu",
        "inertia",
    ]


@pytest.mark.parametrize("offset", [False, True])
def test_simultaneous(
    rig: Rig, reader: Reader, identified: Replace, offset: bool
) -> None:
    found = (friction_stage(), rigid_stage())
    calls = identified("rigid.simultaneous", "identify_simultaneous", found)
    assert (
        rig.run("simultaneous", *COMMON, *([] if offset else ["--no-offset"])).code == 0
    )
    assert calls[-2] is offset
    stages = read_parameters(rig.folder / "out.json").stages
    assert None not in (stages.friction, stages.inertia)
    assert stages.gravity is None


def test_what_the_other_stages_show(
    rig: Rig, reader: Reader, identified: Replace
) -> None:
    """Nothing to identify, IMUs, inertia, stages that are stale, and everything at
    once.
    """
    rig.params("f.json", friction_file())
    rig.params("full.json", full_file())
    empty = RigidStage(
        parameters=[], condition=0.0, rank=0, notes=["the arm is planar"]
    )
    friction = read_parameters(rig.folder / "f.json").stages.friction
    identified("rigid.gravity", "identify_gravity", GravityResult(empty, friction))
    identified("imu_calibration", "calibrate_imus", imu_stage())
    result = InertiaResult(rigid_stage("kg m^2"), friction)
    identified("rigid.inertia", "identify_inertia", result)
    found = (friction_stage(), rigid_stage())
    identified("rigid.simultaneous", "identify_simultaneous", found)
    with (rig.folder / "robot.toml").open("a") as file:
        file.write("# changed\n")
    rig.check_transcript("stages")
    written = read_parameters(rig.folder / "g.json").stages.gravity
    assert structs.replace(written, settings=None) == empty
    again = read_parameters(rig.folder / "again.json").stages
    assert again.inertia is None
    assert again.imu is not None


def test_what_friction_shows(rig: Rig, reader: Reader, identified: Replace) -> None:
    identified("friction_surface.stage", "identify_friction", friction_stage())
    rig.check_transcript("friction")
    reader.warnings = ("jitter is 20 %",)
    done = rig.run("friction", *COMMON, "--json")
    assert done.out == (rig.folder / "out.json").read_text()
    jsonschema.validate(json.loads(done.out), json_schema(SCHEMA))
    assert "warning: a.parquet and 1 more log: jitter is 20 %" in done.err


@pytest.mark.parametrize("name", ["poor", "faulty", "partial"])
def test_what_is_poor(rig: Rig, reader: Reader, identified: Replace, name: str) -> None:
    """A verdict of the stage itself, errors in its logs, and logs that are read in
    part.
    """
    stage = friction_stage(good=name != "poor")
    identified("friction_surface.stage", "identify_friction", stage)
    if name == "faulty":
        fault = finding_of(
            "sign_mismatch", "it would gain", joint="elbow", channel="torque"
        )
        reader.findings = (fault,)
    elif name == "partial":
        reader.partial = "the last 12 of 40 chunks are damaged"
    rig.check_transcript(f"friction_{name}")
    verdicts = read_parameters(rig.folder / "out.json").stages.friction.verdicts
    poor = {v.joint: v.reason for v in verdicts if not v.good}
    if name == "faulty":
        assert poor.keys() == {"elbow", ""}
        assert "a.parquet and 1 more log: torque it would gain" in poor["elbow"]
        assert poor[""].endswith("not good: elbow")
    assert bool(poor) == (name != "partial")


FRICTION = ["friction", "a.parquet", "-r", "robot.toml", "-o", "out.json"]


def test_what_cannot_run(rig: Rig) -> None:
    """Every line has an error, a hint and the exit code 2; with --json a document says
    the same.
    """
    rig.params("f.json", friction_file())
    rig.params("g.json", gravity_file())
    other, swapped = friction_file(), friction_file()
    other.robot.name = "leg"
    rig.params("other.json", other)
    swapped.robot.joints = swapped.robot.joints[::-1]
    rig.params("swapped.json", swapped)
    (rig.folder / "logs").mkdir()
    rig.check_transcript("errors")
    assert not (rig.folder / "out").exists()
    assert (
        "No such option: --cutof"
        in rig.run("friction", "a", "-r", "r", "--cutof", "3").err
    )
    assert not (rig.folder / "out.json").exists()
    done = rig.run("friction", "no", "-r", "robot.toml", "--json")
    told = {"code": 2, "message": "does not exist", "where": "no"}
    assert json.loads(done.out)["error"].items() >= told.items()


@pytest.mark.parametrize(
    ("kind", "code"), [(QualityError, 1), (ConfigError, 2)], ids=["quality", "config"]
)
def test_a_stage_that_gives_up_writes_nothing(
    rig: Rig, reader: Reader, identified: Replace, kind: type[SeqidError], code: int
) -> None:
    error = kind("joint elbow never moves alone", hint="Record it.")
    (rig.folder / "out.json").write_text("old")
    identified("friction_surface.stage", "identify_friction", error)
    done = rig.run(*FRICTION, "--json")
    assert done.code == code
    assert json.loads(done.out) == {
        "error": {
            "code": code,
            "message": error.message,
            "hint": error.hint,
            "where": "",
        }
    }
    assert done.err == f"seqid friction: error: {error}\n  hint: {error.hint}\n"
    assert (rig.folder / "out.json").read_text() == "old"


def test_a_bug_hides_its_traceback(
    rig: Rig, reader: Reader, identified: Replace
) -> None:
    identified("friction_surface.stage", "identify_friction", ZeroDivisionError("ouch"))
    done = rig.run(*FRICTION)
    assert done.code == 70
    assert "this is a bug in seqid: ZeroDivisionError: ouch" in done.err
    assert "Traceback" not in done.err
    assert "Traceback" in rig.run(*FRICTION, "--debug").err
    assert json.loads(rig.run(*FRICTION, "--json").out)["error"]["code"] == 70


def test_no_infinite_number_is_a_result(
    rig: Rig, reader: Reader, identified: Replace
) -> None:
    stage = friction_stage()
    stage.joints["elbow"].rmse = float("inf")
    identified("friction_surface.stage", "identify_friction", stage)
    done = rig.run(*FRICTION)
    assert done.code == 70
    assert "$.stages.friction.joints.elbow.rmse is inf" in done.err
    assert not (rig.folder / "out.json").exists()


def test_processes_change_no_bit(rig: Rig) -> None:
    """Of a prediction with its torques; the other stages: see `test_run`."""
    logs, robot, golden = (
        str(ONE_JOINT / x) for x in ("validation", "robot.toml", "golden.json")
    )
    found = []
    for jobs in ("1", "2"):
        files = ("-o", "out.json", "--torques", "t.parquet", "--jobs", jobs)
        done = rig.run(
            "predict", logs, "-r", robot, "-p", golden, *files, "--motion", "encoder"
        )
        assert done.code == 0, done.err
        document = (rig.folder / "out.json").read_bytes()
        found.append(
            (document, (rig.folder / "t.parquet").read_bytes(), done.out, done.err)
        )
    assert found[0] == found[1]


@pytest.mark.slow
@pytest.mark.parametrize("jobs", ["1", "2"])
def test_logs_that_fail_stop_a_command_or_are_left_out(jobs: str, rig: Rig) -> None:
    """A good log and its copy, one without torque, one that is cut short."""
    shutil.copy(ONE_JOINT / "robot.toml", rig.folder)
    good, *_ = sorted((ONE_JOINT / "friction").glob("*.parquet"))
    for name in ("a.parquet", "copy.parquet"):
        shutil.copy(good, rig.folder / name)
    table = pq.read_table(good)
    kept = [
        name
        for name in table.column_names
        if not name.endswith((".current", ".torque"))
    ]
    pq.write_table(table.select(kept), rig.folder / "b.parquet")
    (rig.folder / "c.parquet").write_bytes(b"PAR1 and no more")
    rig.check_transcript("jobs", {"JOBS": jobs})
    assert not (rig.folder / "failed.json").exists()
    alone, copied, skipped = (
        read_parameters(rig.folder / f"{name}.json")
        for name in ("alone", "copied", "skipped")
    )
    assert alone.stages.friction.joints == copied.stages.friction.joints
    assert [log.path for log in skipped.inputs] == ["a.parquet"]
    notes = "\n".join(skipped.stages.friction.notes)
    assert all(
        f"left out: {path}" in notes
        for path in ("b.parquet", "c.parquet", "none.parquet")
    )


def test_dask_that_is_not_installed(rig: Rig, monkeypatch: pytest.MonkeyPatch) -> None:
    find = importlib.util.find_spec

    def found(name: str, *more: object) -> object:
        return None if name == "distributed" else find(name, *more)  # type: ignore[arg-type]

    monkeypatch.setattr(importlib.util, "find_spec", found)
    done = rig.run("friction", "a.parquet", "-r", "robot.toml", "--engine", "dask")
    assert done.code == 2
    assert "pip install 'seqid[dask]'" in done.err


def test_the_command_to_type_next_is_one_that_a_shell_takes() -> None:
    following = _predict_command(Path("my arm/robot.toml"), Path("out/inertia.json"))
    assert shlex.split(following)[4:6] == ["my arm/robot.toml", "-p"]
