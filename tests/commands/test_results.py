"""What becomes of results: `compare`, `trend`, `report`, `export`; and `plan`."""

import json
import shutil
from pathlib import Path
from xml.etree import ElementTree

import jsonschema
import numpy as np
import pytest

from seqid_cli.params.document import robot_id, with_stage
from seqid_cli.params.encode import encode
from seqid_cli.params.results.comparison import COMPARISON_SCHEMA
from seqid_cli.params.results.plan import PLAN_SCHEMA
from seqid_cli.params.schema import ParameterFile
from seqid_cli.robot.file import load_robot
from tests.commands.conftest import SAMPLE_LOGS, Rig
from tests.plants.robots.stages import random_bodies, stages_of
from tests.unit.params.documents import diagnosis_file, inertia_file
from tests.unit.params.generate import json_schema
from tests.unit.report.pages import (
    all_documents,
    good_documents,
    made_with,
    plan_file,
    prediction_file,
    source,
    write_documents,
    write_torques,
)
from tests.unit.trend.test_trend import STEP, history


def test_compare(rig: Rig) -> None:
    """A file, a copy of it, one whose gravity is another, and one of another robot."""
    moved, other = inertia_file(), inertia_file()
    moved.stages.gravity.parameters[0].value = 1.5
    other.robot.name = "another"
    files = {
        "a": inertia_file(),
        "same": inertia_file(),
        "moved": moved,
        "other": other,
    }
    for name, file in files.items():
        rig.params(f"{name}.json", file)
    rig.check_transcript("compare")
    (rig.folder / "plan.json").write_text(encode(plan_file()))
    assert "is a plan file" in rig.run("compare", "a.json", "plan.json").err
    given = (["--json"], ["--format", "json"])
    done, again = (rig.run("compare", "a.json", "moved.json", *form) for form in given)
    assert done.code == again.code == 1
    assert done.err == again.err
    found = json.loads(done.out)
    assert json.loads(again.out) | {"created": found["created"]} == found
    assert (found["schema"], found["changed"]) == (COMPARISON_SCHEMA, 1)
    assert found["different"] is True
    change = next(item for item in found["differences"] if item["different"])
    assert (change["a"], change["b"], change["unit"]) == (1.25, 1.5, "kg m")

    # An error is JSON as well, however that was asked for.
    failed = [
        rig.run("compare", "a.json", "plan.json", *form)
        for form in (*given, ["--format=json"])
    ]
    errors = [json.loads(done.out)["error"] for done in failed]
    assert errors[0]["code"] == 2
    assert errors == errors[:1] * 3


def test_trend(rig: Rig) -> None:
    """The gravity of a robot changes at the eighth date."""
    for number, file in enumerate(history(1, STEP)):
        rig.params(f"{number:02}.json", file)
    rig.check_transcript("trend")
    assert json.loads((rig.folder / "trend.json").read_text())["alarm"] is True
    assert (rig.folder / "trend.parquet").is_file()


def test_report(rig: Rig) -> None:
    """Of one model, of all documents, of a fleet; what is refused leaves all files as
    they are.
    """
    names = write_documents(rig.folder, all_documents())
    (rig.folder / "cell").mkdir()
    good = write_documents(rig.folder / "cell", good_documents())
    other = diagnosis_file()
    other.robot.name = "another"
    (rig.folder / "other.json").write_text(encode(other))
    stale = made_with(prediction_file(), source("inertia.json", diagnosis_file()))
    (rig.folder / "stale.json").write_text(encode(stale))
    (rig.folder / "trend.json").write_text('{"schema": "seqid/trend@1"}')
    for name in ("t.parquet", "torques.parquet"):
        write_torques(rig.folder / name)
    before = [(rig.folder / name).read_bytes() for name in names]
    rig.check_transcript("report")
    assert [(rig.folder / name).read_bytes() for name in names] == before
    assert not list(rig.folder.glob(".*.tmp"))
    fleet = [
        *good,
        *(f"cell/{name}" for name in good),
        "--by",
        "folder",
        "-o",
        "f.html",
        "--json",
    ]
    told = json.loads(rig.run("report", *fleet).out)
    assert (told["robot"], told["verdict"]) == ("., cell", "good")


def test_the_json_of_a_report_sums_it_up(rig: Rig) -> None:
    """Its torques are named or found."""
    good = write_documents(rig.folder, good_documents())
    for name, more in (
        ("torques.parquet", ()),
        ("t.parquet", ("t.parquet", "--title", "An arm")),
    ):
        write_torques(rig.folder / name)
        done = rig.run("report", *good, *more, "-o", "report.html", "--json")
        document = json.loads(done.out)
        assert document["torques"] == name
    size = (rig.folder / "report.html").stat().st_size
    sections = document.pop("sections")
    assert {"id": "torque", "complete": True} in sections
    assert {"id": "loop", "complete": False} in sections
    assert document.pop("sentence").startswith("On 2 logs")
    assert size < 1_000_000
    told = {"output": "report.html", "robot": "arm", "verdict": "good", "points": []}
    made_of = {"files": good, "torques": "t.parquet", "bytes": size, "figures": []}
    assert document == {**told, **made_of}
    assert "<h1>An arm</h1>" in (rig.folder / "report.html").read_text(encoding="utf-8")


def model_of(folder: Path, *, shift: float = 0.0) -> ParameterFile:
    """A model of the robot of a folder;
    bodies exist unless Izz of the last is shifted.
    """
    robot = load_robot(folder / "robot.toml")
    bodies = random_bodies(np.random.default_rng(0), robot.n)
    stages = stages_of(robot, bodies)
    if shift:
        by = np.array(
            [shift * (p.name == f"Izz_{robot.n}") for p in stages.inertia.parameters]
        )
        stages = stages_of(robot, bodies, shift=by)
    return with_stage(
        None, robot_id(robot), [], friction=stages.friction, inertia=stages.inertia
    )


@pytest.fixture
def two(rig: Rig) -> Rig:
    """A rig with the two-joint sample robot and an inertia file of it."""
    shutil.copy(SAMPLE_LOGS / "two_joint" / "robot.toml", rig.folder)
    rig.params("inertia.json", model_of(rig.folder))
    return rig


def test_export(two: Rig) -> None:
    """Every suffix, a model that no body has, another robot's file, and mistakes."""
    two.params("odd.json", model_of(two.folder, shift=-5000.0))
    shutil.copy(SAMPLE_LOGS / "one_joint" / "robot.toml", two.folder / "one.toml")
    two.check_transcript("export")
    for name in (
        "a.urdf",
        "a.xml",
        "a.mjcf",
        "a.yaml",
        "a.yml",
        "a.h",
        "a.py",
        "A.URDF",
    ):
        assert (two.folder / name).stat().st_size > 500
    assert not (two.folder / "no.urdf").exists()
    done = two.run(
        "export", "inertia.json", "-r", "robot.toml", "-o", "a.urdf", "--json"
    )
    found = json.loads(done.out)
    told = {"schema": "seqid/export@1", "exact": True, "format": "URDF"}
    assert found.items() >= told.items()
    assert set(found["joints"]) == {"joint_1", "joint_2"}
    assert found["joints"]["joint_1"]["prior"] == "guessed"
    assert found["joints"]["joint_1"]["friction"]["coulomb"] > 0.0
    assert {d["name"] for d in found["base_parameters"]} >= {
        "Izz_1",
        "mx_2",
        "my_2",
        "Izz_2",
    }


def test_a_robot_name_with_marks_makes_files_that_parse(rig: Rig) -> None:
    text = (SAMPLE_LOGS / "two_joint" / "robot.toml").read_text()
    text = text.replace('name = "two_joint"', 'name = "a */ -- <b> \\"\\"\\"c\\""')
    (rig.folder / "robot.toml").write_text(text)
    rig.params("inertia.json", model_of(rig.folder))
    for name in ("a.urdf", "a.xml", "a.h", "a.py"):
        assert (
            rig.run("export", "inertia.json", "-r", "robot.toml", "-o", name).code == 0
        )
    for name in ("a.urdf", "a.xml"):
        ElementTree.parse(rig.folder / name)
    assert (rig.folder / "a.h").read_text().split("*/")[0].count("two standard") == 0
    compile((rig.folder / "a.py").read_text(), "a.py", "exec")


def test_the_original_urdf_is_never_overwritten(rig: Rig) -> None:
    for name in ("robot.toml", "six_joint.urdf"):
        shutil.copy(SAMPLE_LOGS / "six_joint" / name, rig.folder)
    rig.params("inertia.json", model_of(rig.folder))
    before = (rig.folder / "six_joint.urdf").read_bytes()
    done = rig.run("export", "inertia.json", "-r", "robot.toml", "-o", "six_joint.urdf")
    assert done.code == 2
    assert "is an input" in done.err
    assert (rig.folder / "six_joint.urdf").read_bytes() == before


def test_two_files_of_different_stages_are_joined(two: Rig) -> None:
    whole = model_of(two.folder)
    for stage in ("friction", "inertia"):
        own = {stage: getattr(whole.stages, stage)}
        two.params(f"{stage}_alone.json", with_stage(None, whole.robot, [], **own))
    parts = ("friction_alone.json", "inertia_alone.json")
    for files, name in ((("inertia.json",), "a.urdf"), (parts, "b.urdf")):
        assert two.run("export", *files, "-r", "robot.toml", "-o", name).code == 0
    assert (two.folder / "a.urdf").read_text() == (two.folder / "b.urdf").read_text()


TWO = str(SAMPLE_LOGS / "two_joint" / "robot.toml")
SHORT = ("--duration", "12", "--move-duration", "4")


def test_a_plan_is_written_with_its_trajectories(rig: Rig) -> None:
    files = ("-o", "plan.json", "--trajectories", "moves")
    done = rig.run("plan", "inertia", "-r", TWO, *files, *SHORT)
    assert done.code == 0, done.err
    plan = json.loads((rig.folder / "plan.json").read_text())
    jsonschema.validate(plan, json_schema(PLAN_SCHEMA))
    assert "3 moves, 12 s of motion" in done.out
    for move in plan["moves"]:
        path = rig.folder / "moves" / move["file"]
        rows = np.loadtxt(path, delimiter=",", skiprows=1)
        assert path.read_text().split(",")[:3] == [
            "time",
            "position_joint_1",
            "position_joint_2",
        ]
        assert rows[-1, 0] == pytest.approx(4.0)
        assert rows[0, 1:3] == pytest.approx(list(move["start"].values()), abs=5e-7)
        speed = np.gradient(rows[:, 1], rows[:, 0])
        assert np.abs(speed - rows[:, 3]).max() < 0.02 * np.abs(rows[:, 3]).max() + 1e-6


def test_mistakes_of_a_plan_are_told(rig: Rig) -> None:
    for path in map(Path, (TWO, TWO.replace("robot.toml", "golden.json"))):
        shutil.copy(path, rig.folder / f"two{path.suffix}")
    rig.check_transcript("plan")


def test_a_plan_that_cannot_reach_full_rank_is_poor(rig: Rig) -> None:
    arguments = ("plan", "inertia", "-r", TWO, "--lock", "joint_2", *SHORT)
    done = rig.run(*arguments)
    assert done.code == 0
    assert "warning: inertia: rank 3 of 4" in done.err
    assert "note: not excited: " in done.err
    assert rig.run(*arguments, "--strict").code == 1


def test_logs_that_are_there_count_as_well(rig: Rig) -> None:
    errors, logs = [], str(SAMPLE_LOGS / "two_joint/inertia")
    for more in ((), ("--have", logs)):
        line = ("--duration", "8", "--move-duration", "4", *more, "--json")
        done = rig.run("plan", "inertia", "-r", TWO, *line)
        assert done.code == 0
        stage = json.loads(done.out)["stages"]["inertia"]
        errors.append(np.array([p["std_error"] for p in stage["parameters"]]))
    assert (errors[1] < errors[0]).all()
