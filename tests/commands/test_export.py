"""`seqid export`: every form, and what it says of bodies that cannot be."""

import json
import shutil
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pytest

from seqid_cli.params.document import now, robot_id, tool
from seqid_cli.params.io import read_parameters
from seqid_cli.params.schema import SCHEMA, ParameterFile, Stages
from seqid_cli.robot.file import load_robot
from tests.commands.conftest import Rig
from tests.commands.transcripts import check_transcript
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


def test_what_the_user_sees(two: Rig) -> None:
    """Every suffix, a model that no body has, another robot's file, and mistakes."""
    robot = load_robot(two.folder / "robot.toml")
    stages = stages_of(robot, random_bodies(np.random.default_rng(0), 2))
    shift = np.array([-5000.0 * (p.name == "Izz_2") for p in stages.inertia.parameters])
    stages = stages_of(robot, random_bodies(np.random.default_rng(0), 2), shift=shift)
    two.params("odd.json", file_of(stages))
    shutil.copy(SAMPLES / "one_joint" / "robot.toml", two.folder / "one.toml")
    check_transcript(two, "export")
    written = [two.folder / name for name in ("a.urdf", "a.xml", "a.mjcf", "a.yaml", "a.yml")]
    written += [two.folder / name for name in ("a.h", "a.py", "A.URDF")]
    assert all(path.stat().st_size > 500 for path in written)
    assert not (two.folder / "no.urdf").exists()


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


def test_two_files_of_different_stages_are_joined(two: Rig) -> None:
    whole = read_parameters(Path("inertia.json"))
    two.params("friction.json", file_of(Stages(friction=whole.stages.friction)))
    two.params("rigid.json", file_of(Stages(inertia=whole.stages.inertia)))
    one = two.run("export", "inertia.json", "-r", "robot.toml", "-o", "a.urdf")
    both = two.run("export", "friction.json", "rigid.json", "-r", "robot.toml", "-o", "b.urdf")
    assert one.code == both.code == 0
    assert (two.folder / "a.urdf").read_text() == (two.folder / "b.urdf").read_text()
