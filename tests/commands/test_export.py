import json
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pytest

from seqid_cli.params.document import now, robot_id, tool
from seqid_cli.params.schema import SCHEMA, ParameterFile, Stages
from seqid_cli.robot.file import load_robot
from tests.commands.conftest import Rig
from tests.plants.robots.sample import sample_robot
from tests.plants.robots.stages import SAMPLES, random_bodies, stages_of


def file_of(stages: Stages, robot: str = "two_joint") -> ParameterFile:
    return ParameterFile(
        schema=SCHEMA,
        created=now(),
        tool=tool(),
        robot=robot_id(sample_robot(robot)),
        inputs=[],
        stages=stages,
    )


@pytest.fixture
def two(rig: Rig) -> Rig:
    """A rig with the two-joint sample robot and an inertia file of it."""
    (rig.folder / "robot.toml").write_bytes((SAMPLES / "two_joint" / "robot.toml").read_bytes())
    robot = load_robot(rig.folder / "robot.toml")
    stages = stages_of(robot, random_bodies(np.random.default_rng(0), 2))
    rig.params("inertia.json", file_of(stages))
    return rig


@pytest.mark.parametrize(
    "name", ["a.urdf", "a.xml", "a.mjcf", "a.yaml", "a.yml", "a.h", "a.py", "A.URDF"]
)
def test_every_suffix_is_written(two: Rig, name: str) -> None:
    done = two.run("export", "inertia.json", "-r", "robot.toml", "-o", name)
    assert done.code == 0, done.err
    assert (two.folder / name).stat().st_size > 500
    assert "met exactly" in done.out
    assert f"written: {name}" in done.err


def test_json_tells_links_friction_and_deviations(two: Rig) -> None:
    done = two.run("export", "inertia.json", "-r", "robot.toml", "-o", "a.urdf", "--json")
    found = json.loads(done.out)
    assert found["schema"] == "seqid/export@1"
    assert found["exact"] is True
    assert found["format"] == "URDF"
    assert set(found["joints"]) == {"joint_1", "joint_2"}
    assert found["joints"]["joint_1"]["prior"] == "guessed"
    assert found["joints"]["joint_1"]["friction"]["coulomb"] > 0.0
    assert {d["name"] for d in found["base_parameters"]} >= {"Izz_1", "mx_2", "my_2", "Izz_2"}


def test_robot_name_with_marks_makes_files_that_parse(rig: Rig) -> None:
    text = (SAMPLES / "two_joint" / "robot.toml").read_text()
    text = text.replace('name = "two_joint"', 'name = "a */ -- <b> \\"\\"\\"c\\""')
    (rig.folder / "robot.toml").write_text(text)
    robot = load_robot(rig.folder / "robot.toml")
    file = file_of(stages_of(robot, random_bodies(np.random.default_rng(0), 2)))
    file.robot.name = robot.name
    rig.params("inertia.json", file)
    for name in ("a.urdf", "a.xml", "a.h", "a.py"):
        assert rig.run("export", "inertia.json", "-r", "robot.toml", "-o", name).code == 0
    for name in ("a.urdf", "a.xml"):
        ElementTree.parse(rig.folder / name)
    assert (rig.folder / "a.h").read_text().split("*/")[0].count("two standard") == 0
    compile((rig.folder / "a.py").read_text(), "a.py", "exec")


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["inertia.json", "-r", "robot.toml", "-o", "a.stl"], "no format is known"),
        (["inertia.json", "-r", "robot.toml", "-o", "a"], "no format is known"),
        (["none.json", "-r", "robot.toml", "-o", "a.urdf"], "does not exist"),
        (["inertia.json", "-r", "none.toml", "-o", "a.urdf"], "none.toml"),
        (["inertia.json", "-r", "robot.toml", "-o", "no/a.urdf"], "folder does not exist"),
        (["inertia.json", "-r", "robot.toml"], "--output"),
        (["-r", "robot.toml", "-o", "a.urdf"], "FILE..."),
    ],
)
def test_what_cannot_be_done_is_said(two: Rig, arguments: list[str], words: str) -> None:
    done = two.run("export", *arguments)
    assert done.code == 2
    assert words in done.err
    assert not (two.folder / "a.urdf").exists()


def test_the_original_urdf_is_never_overwritten(rig: Rig) -> None:
    for name in ("robot.toml", "six_joint.urdf"):
        (rig.folder / name).write_bytes((SAMPLES / "six_joint" / name).read_bytes())
    robot = load_robot(rig.folder / "robot.toml")
    stages = stages_of(robot, random_bodies(np.random.default_rng(0), 6))
    rig.params("inertia.json", file_of(stages, "six_joint"))
    before = (rig.folder / "six_joint.urdf").read_bytes()
    done = rig.run("export", "inertia.json", "-r", "robot.toml", "-o", "six_joint.urdf")
    assert done.code == 2
    assert "is an input" in done.err
    assert (rig.folder / "six_joint.urdf").read_bytes() == before


def test_strict_fails_where_no_body_comes_near(two: Rig) -> None:
    robot = load_robot(two.folder / "robot.toml")
    stages = stages_of(robot, random_bodies(np.random.default_rng(0), 2))
    names = [p.name for p in stages.inertia.parameters]
    shift = np.where(np.array(names) == "Izz_2", -5000.0, 0.0)
    stages = stages_of(robot, random_bodies(np.random.default_rng(0), 2), shift=shift)
    two.params("odd.json", file_of(stages))
    arguments = ("export", "odd.json", "-r", "robot.toml", "-o", "a.urdf")
    done = two.run(*arguments)
    assert done.code == 0
    assert "standard errors away" in done.err
    assert two.run(*arguments, "--strict").code == 1


def test_another_robots_file_is_refused(two: Rig) -> None:
    done = two.run(
        "export", "inertia.json", "-r", str(SAMPLES / "one_joint" / "robot.toml"), "-o", "a.urdf"
    )
    assert done.code == 2
    assert "is about robot 'two_joint'" in done.err


def test_two_files_of_different_stages_are_joined(two: Rig) -> None:
    from seqid_cli.params.io import read_parameters

    whole = read_parameters(Path("inertia.json"))
    two.params("friction.json", file_of(Stages(friction=whole.stages.friction)))
    two.params("rigid.json", file_of(Stages(inertia=whole.stages.inertia)))
    one = two.run("export", "inertia.json", "-r", "robot.toml", "-o", "a.urdf")
    both = two.run("export", "friction.json", "rigid.json", "-r", "robot.toml", "-o", "b.urdf")
    assert one.code == both.code == 0
    assert (two.folder / "a.urdf").read_text() == (two.folder / "b.urdf").read_text()
