"""`seqid init`: the robot file that it writes, and that the package reads it."""

import json
import re
import shutil
import tomllib
from pathlib import Path

import numpy as np
import pytest

from seqid_cli.errors import ConfigError
from seqid_cli.inspect.guess import guess_channels
from seqid_cli.inspect.propose import match_names
from seqid_cli.robot.file import load_robot
from seqid_cli.robot.toml.schema import Columns
from tests.commands.conftest import Rig
from tests.unit.inspect.faults import SAMPLES, SIX, read_columns, write_columns
from tests.unit.logs.format_writers import Data, Write, rosbag1, rosbag2_mcap, rosbag2_sqlite
from tests.unit.logs.writers import joint_messages, write_messages

URDF = SAMPLES / "six_joint" / "six_joint.urdf"
LOG = SAMPLES / "six_joint" / "validation" / "fourier_1.parquet"


def log_with(folder: Path, rename: dict[str, str]) -> str:
    """Write the sample log under other column names."""
    columns = {}
    for name, values in read_columns(LOG).items():
        for old, text in rename.items():
            name = name.replace(old, text)
        if "imu" not in name:
            columns[name] = values
    write_columns(folder / "log.parquet", columns)
    shutil.copy(URDF, folder / "arm.urdf")
    return "log.parquet"


def completed(path: Path) -> Path:
    """Fill in the drive data that only a person knows."""
    pattern = r"# ((?:torque_constant|gear_ratio) = [0-9.]+)"
    path.write_text(re.sub(pattern, r"\1", path.read_text()))
    return path


def test_the_file_holds_what_log_and_urdf_say_and_loads(rig: Rig) -> None:
    log = log_with(rig.folder, {})
    done = rig.run("init", log, "--urdf", "arm.urdf", "-o", "new.toml")
    assert done.code == 0, done.err
    assert "to do: torque_constant and gear_ratio of every joint" in done.err
    robot = load_robot(rig.folder / "new.toml")
    assert robot.joint_names == SIX
    assert robot.joints[2].position_limits == (-2.4, 2.4)
    assert robot.joints[0].velocity_limit == 2.2
    assert robot.joints[1].encoder_resolution == pytest.approx(3.0517578125e-05, rel=1e-5)
    document = tomllib.loads((rig.folder / "new.toml").read_text())
    assert "channels" not in document
    assert document["gravity"] == [0.0, 0.0, -9.81]
    completed(rig.folder / "new.toml")
    found = json.loads(rig.run("inspect", log, "-r", "new.toml", "--json").out)
    assert found["findings"] == []


@pytest.mark.parametrize(
    ("rename", "channels"),
    [
        (
            {f"{name}.": f"axis{k + 1}_" for k, name in enumerate(SIX)},
            {"position": "axis{index}_position", "current": "axis{index}_current"},
        ),
        ({name: f"arm_{name}_link" for name in SIX}, None),
    ],
)
def test_names_of_other_loggers_are_mapped(
    rig: Rig, rename: dict[str, str], channels: dict[str, str] | None
) -> None:
    log = log_with(rig.folder, rename)
    assert rig.run("init", log, "--urdf", "arm.urdf", "-o", "new.toml").code == 0
    document = tomllib.loads((rig.folder / "new.toml").read_text())
    assert [joint["name"] for joint in document["joint"]] == list(SIX)
    if channels is not None:
        assert document["channels"] == channels
    robot = load_robot(completed(rig.folder / "new.toml"))
    from seqid_cli.logs.read import read_recording

    recording = read_recording(rig.folder / log, robot)
    np.testing.assert_allclose(recording.q[:, 2], read_columns(LOG)["elbow.position"])


def test_an_unmapped_current_is_refused_with_the_key_to_fill_in(rig: Rig) -> None:
    log = log_with(rig.folder, {f"{name}.": f"axis{k + 1}_" for k, name in enumerate(SIX)})
    rig.run("init", log, "--urdf", "arm.urdf", "-o", "new.toml")
    done = rig.run("inspect", log, "-r", "new.toml")
    assert done.code == 2
    assert "torque_constant" in done.err


def test_without_a_urdf_the_geometry_is_left_to_be_filled_in(rig: Rig) -> None:
    log = log_with(rig.folder, {})
    done = rig.run("init", log, "-o", "new.toml")
    assert done.code == 0
    with pytest.raises(ConfigError, match="neither urdf nor joint"):
        load_robot(rig.folder / "new.toml")
    path = completed(rig.folder / "new.toml")
    path.write_text(path.read_text().replace("# dh = ", "dh = "))
    assert load_robot(path).joint_names == SIX


def test_mimic_and_fixed_joints_and_other_branches_are_left_out(rig: Rig) -> None:
    log = log_with(rig.folder, {})
    text = (rig.folder / "arm.urdf").read_text()
    tip = re.findall(r'<child link="([^"]+)"', text)[-1]
    gripper = (
        '<link name="l"/><link name="r"/><link name="t"/>'
        f'<joint name="left" type="prismatic"><parent link="{tip}"/><child link="l"/>'
        '<limit lower="0" upper="1" effort="1" velocity="1"/></joint>'
        f'<joint name="right" type="prismatic"><parent link="{tip}"/><child link="r"/>'
        '<limit lower="0" upper="1" effort="1" velocity="1"/><mimic joint="left"/></joint>'
        f'<joint name="tool" type="fixed"><parent link="{tip}"/><child link="t"/></joint></robot>'
    )
    (rig.folder / "arm.urdf").write_text(text.replace("</robot>", gripper))
    assert rig.run("init", log, "--urdf", "arm.urdf", "-o", "new.toml").code == 0
    assert load_robot(completed(rig.folder / "new.toml")).joint_names == SIX
    assert "lacks, locked at zero: left" in (rig.folder / "new.toml").read_text()


def test_joints_of_other_names_are_told_apart_by_their_number(rig: Rig) -> None:
    log = log_with(rig.folder, {f"{name}.": f"axis{k + 1}." for k, name in enumerate(SIX)})
    assert rig.run("init", log, "--urdf", "arm.urdf", "-o", "new.toml").code == 0
    document = tomllib.loads((rig.folder / "new.toml").read_text())
    assert [joint["name"] for joint in document["joint"]] == list(SIX)
    assert document["channels"] == {
        "position": "axis{index}.position",
        "current": "axis{index}.current",
    }
    completed(rig.folder / "new.toml")
    done = rig.run("inspect", log, "-r", "new.toml", "--json")
    assert json.loads(done.out)["findings"] == []


@pytest.mark.parametrize(
    ("old", "new"),
    [
        (r"<limit[^>]*/>", ""),
        (r' effort="[^"]*"', ""),
        (r'"elbow_link"', '"elbow"'),
        (r"</robot>", "<!-- <xacro:arm prefix=''/> --></robot>"),
        (r"</link>", '<visual><geometry><mesh filename="package://a/b.dae"/></geometry></visual></link>'),
        (r'type="revolute"', 'type="continuous"'),
        (r"(?s)<inertial>.*?</inertial>", ""),
        (r'<link name="base_link"/>', '<link name="world"/><link name="base_link"/>'
         '<joint name="free" type="floating"><parent link="world"/>'
         '<child link="base_link"/></joint>'),
    ],
    ids=["no limits", "no effort", "link named as joint", "comment", "mesh", "continuous",
         "no inertials", "floating"],
)  # fmt: skip
def test_unusual_urdfs_lead_to_a_file_that_is_accepted(rig: Rig, old: str, new: str) -> None:
    log = log_with(rig.folder, {})
    text = (rig.folder / "arm.urdf").read_text()
    assert re.search(old, text)
    (rig.folder / "arm.urdf").write_text(re.sub(old, new, text))
    assert rig.run("init", log, "--urdf", "arm.urdf", "-o", "new.toml").code == 0
    assert load_robot(completed(rig.folder / "new.toml")).joint_names == SIX


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        (r"</robot>", '<link name="elbow_link"/></robot>', "two links are named 'elbow_link'"),
        (r"</robot>", '<link name="other"/></robot>', "2 root links"),
        (r'child link="elbow_link"', 'child link="elbo"', "its child link 'elbo'"),
        (r'upper="[^"]*"', 'upper="pi"', "<limit upper='pi'>"),
        (r"</robot>", '<joint name="back" type="fixed"><parent link="wrist_3_link"/>'
         '<child link="base_link"/></joint></robot>', "a loop"),
        (r"</robot>", '<xacro:arm prefix=""/></robot>', "xacro"),
    ],
)  # fmt: skip
def test_urdfs_that_nobody_can_use_are_refused_in_one_message(
    rig: Rig, old: str, new: str, message: str
) -> None:
    log = log_with(rig.folder, {})
    text = (rig.folder / "arm.urdf").read_text()
    assert re.search(old, text)
    (rig.folder / "arm.urdf").write_text(re.sub(old, new, text, count=1))
    done = rig.run("init", log, "--urdf", "arm.urdf", "-o", "new.toml")
    assert done.code == 2
    assert message in done.err
    assert "hint:" in done.err
    assert not (rig.folder / "new.toml").exists()


@pytest.mark.parametrize("turn", [np.pi / 2, 0.7])
def test_gravity_is_written_as_the_logs_tell_it(rig: Rig, turn: float) -> None:
    """The base frame of the URDF is turned about x: by a quarter, as of a wall, or slanted."""
    log = log_with(rig.folder, {})
    text = (rig.folder / "arm.urdf").read_text()
    first = text.index('<joint name="shoulder_pan"')
    turned = re.sub(r'rpy="[^"]*"', f'rpy="{turn} 0 0"', text[first:], count=1)
    (rig.folder / "arm.urdf").write_text(text[:first] + turned)
    constants = "0.122,0.12,0.118,0.104,0.101,0.103"
    words = ("--torque-constant", constants, "--gear-ratio", "101", "-o", "new.toml")
    done = rig.run("init", log, "--urdf", "arm.urdf", *words)
    assert done.code == 0, done.err
    assert "the logs tell the mounting" in done.err
    robot = load_robot(rig.folder / "new.toml")
    gravity = 9.81 * np.array([0.0, np.sin(turn), -np.cos(turn)])
    np.testing.assert_allclose(robot.gravity, gravity, atol=0.01 if turn > 1.0 else 0.1)
    assert [joint.torque_constant for joint in robot.joints] == [*map(float, constants.split(","))]
    assert robot.name == "six_joint"
    found = json.loads(rig.run("inspect", log, "-r", "new.toml", "--json").out)
    assert found["findings"] == []


@pytest.mark.parametrize("given", ["0.1,0.2", "a tenth"])
def test_drives_data_are_one_number_or_one_for_each_joint(rig: Rig, given: str) -> None:
    log = log_with(rig.folder, {})
    done = rig.run("init", log, "--torque-constant", given)
    assert done.code == 2
    assert "one for each" in done.err


def test_an_existing_file_is_kept_unless_forced(rig: Rig) -> None:
    log = log_with(rig.folder, {})
    (rig.folder / "new.toml").write_text("mine")
    done = rig.run("init", log, "--urdf", "arm.urdf", "-o", "new.toml")
    assert done.code == 2
    assert "--force" in done.err
    assert (rig.folder / "new.toml").read_text() == "mine"
    assert rig.run("init", log, "--urdf", "arm.urdf", "-o", "new.toml", "--force").code == 0
    assert load_robot(rig.folder / "new.toml").n == 6


def test_imus_and_the_meaning_of_effort_are_left_to_be_said(rig: Rig) -> None:
    shutil.copy(SAMPLES / "two_joint" / "imu" / "joint_2.mcap", rig.folder / "log.mcap")
    done = rig.run("init", "log.mcap", "--json")
    document = json.loads(done.out)
    assert document["joints"] == ["joint_1", "joint_2"]
    text = document["robot_toml"]
    assert '# name = "imu_a"' in text
    assert text.count("# [[imu]]") == 2
    assert '# effort = "current"' in text
    assert tomllib.loads(text)["schema"] == "seqid/robot@1"


@pytest.mark.parametrize("write", [rosbag1, rosbag2_sqlite, rosbag2_mcap])
def test_a_bag_needs_no_names_of_columns(rig: Rig, write: Write) -> None:
    t = np.arange(0.0, 2.0, 0.01)
    q = np.sin(np.outer(t, np.arange(1.0, 7.0)))
    log = write(rig.folder / "log", Data(t, tuple(SIX), q, q, q, q))
    shutil.copy(URDF, rig.folder / "arm.urdf")
    done = rig.run("init", log.name, "--urdf", "arm.urdf", "-o", "new.toml")
    assert done.code == 0, done.err
    assert "whether effort is torque" in done.err
    assert load_robot(rig.folder / "new.toml").joint_names == SIX
    assert tomllib.loads((rig.folder / "new.toml").read_text())["channels"] == {}


def test_match_names_pairs_the_nearest_one_to_one() -> None:
    urdf = ["shoulder_pan_joint", "shoulder_lift_joint", "elbow_joint", "joint_1", "joint_2"]
    log = ["ShoulderPan", "elbow", "shoulder_lift", "Joint2"]
    assert match_names(log, urdf) == {
        "ShoulderPan": "shoulder_pan_joint",
        "elbow": "elbow_joint",
        "shoulder_lift": "shoulder_lift_joint",
        "Joint2": "joint_2",
    }


@pytest.mark.parametrize(
    ("columns", "patterns", "joints"),
    [
        (
            ["timestamp", *(f"{c}_{k}" for c in ("actual_q", "target_q", "actual_qd",
             "actual_current", "target_moment", "joint_temperatures") for k in range(6))],
            {"position": "actual_q_{index0}", "velocity": "actual_qd_{index0}",
             "current": "actual_current_{index0}", "temperature": "joint_temperatures_{index0}"},
            6,
        ),
        (
            ["t", *(f"{c}_{k}" for c in ("q", "dq", "tau", "tau_des") for k in (1, 2, 3))],
            {"position": "q_{index}", "velocity": "dq_{index}", "torque": "tau_{index}"},
            3,
        ),
        (
            ["time", *(f"state.{c}[{k}]" for c in ("q", "q_d", "tau_J") for k in range(7))],
            {"position": "state.q[{index0}]", "torque": "state.tau_J[{index0}]"},
            7,
        ),
        (
            ["time", "elbow/pos", "elbow/effort", "wrist/pos", "wrist/effort"],
            {"position": "{name}/pos", "torque": "{name}/effort"},
            2,
        ),
        (["time", "voltage", "status_1"], {}, 0),
        (["time", "q1", "q2", "i1", "i2"], {"position": "q{index}", "current": "i{index}"}, 2),
        (["Zeit [s]", "Winkel Achse 1 [°]", "Winkel Achse 2 [°]", "Strom 1 [A]", "Strom 2 [A]"],
         {"position": "Winkel Achse {index} [°]", "current": "Strom {index} [A]"}, 2),
        (["Zeit [ms]", *(f"{w} A{k} [x]" for w in ("Istposition", "Sollposition", "Istdrehzahl",
             "Motorstrom") for k in (1, 2))],
         {"position": "Istposition A{index} [x]", "velocity": "Istdrehzahl A{index} [x]",
          "current": "Motorstrom A{index} [x]"}, 2),
        (["time", "q2", "i2"], {"position": "q2", "current": "i2"}, 1),
        (["time", "q2", "q3", "i1", "i2", "i3"],
         {"position": ("q2", "q3"), "current": ("i2", "i3")}, 2),
        (["time [s]", "a1 position [rad]", "a2 position [rad]"],
         {"position": "a{index} position [rad]"}, 2),
        (["Zeit [s]", "Position A1 [°]", "Position A2 [mm]", "Strom A1 [A]", "Strom A2 [A]"],
         {"position": ("Position A1 [°]", "Position A2 [mm]"), "current": "Strom A{index} [A]"}, 2),
        (["time", "q_des", "q_act", "tau"], {"position": "q_act", "torque": "tau"}, 1),
        (["time", "elbow/pos [deg]", "wrist/pos [deg]"], {"position": "{name}/pos [deg]"}, 2),
    ],
)  # fmt: skip
def test_channels_are_guessed_from_names(
    columns: list[str], patterns: dict[str, Columns], joints: int
) -> None:
    found, names = guess_channels(columns)
    assert found == patterns
    assert len(names) == joints


def test_a_sliding_joint_in_mm_is_told_by_its_limits(tmp_path: Path, rig: Rig) -> None:
    t = np.arange(0.0, 8.0, 0.01)
    q = 0.5 * np.round(800.0 * np.sin(0.7 * t))  # mm
    table = {"t": t, "z.position": q, "z.torque": np.cos(0.7 * t)}
    write_columns(tmp_path / "log.parquet", table)
    (tmp_path / "arm.urdf").write_text(
        '<robot name="arm"><link name="l0"/><link name="l1"/><joint name="z" type="prismatic">'
        '<parent link="l0"/><child link="l1"/><axis xyz="0 0 1"/>'
        '<limit lower="-0.5" upper="0.5" velocity="1" effort="9"/></joint></robot>'
    )
    path, log = tmp_path / "new.toml", str(tmp_path / "log.parquet")
    done = rig.run("init", log, "--urdf", str(tmp_path / "arm.urdf"), "-o", str(path))
    assert done.code == 0, done.err
    assert 'check length_unit = "mm"' in done.err
    robot = load_robot(path)
    assert robot.channels.length_unit == "mm"
    assert robot.joints[0].encoder_resolution == pytest.approx(5e-4, rel=1e-4)


def test_a_sliding_joint_in_mm_beside_a_turning_one_in_degrees(tmp_path: Path, rig: Rig) -> None:
    """By the columns' own units; the encoder's step is written in m and rad."""
    t = np.arange(0.0, 8.0, 0.01)
    turn, slide = 0.01 * np.round(4e3 * np.sin(t)), 0.02 * np.round(2e3 * np.sin(0.7 * t))
    rows = zip(t, turn, slide, strict=True)
    lines = ["Zeit [s];Position Achse 1 [°];Position Achse 2 [mm];Moment Achse 1;Moment Achse 2"]
    lines += [f"{a:.2f};{b:.2f};{c:.2f};1;2".replace(".", ",") for a, b, c in rows]
    (tmp_path / "log.csv").write_text("\n".join([*lines, ""]))
    joints = "".join(
        f'<link name="l{k}"/><joint name="Achse {k}" type="{kind}"><parent link="l{k - 1}"/>'
        f'<child link="l{k}"/><axis xyz="0 0 1"/>'
        '<limit lower="-1" upper="1" velocity="9" effort="9"/></joint>'
        for k, kind in ((1, "revolute"), (2, "prismatic"))
    )
    (tmp_path / "arm.urdf").write_text(f'<robot name="arm"><link name="l0"/>{joints}</robot>')
    path = tmp_path / "new.toml"
    done = rig.run(
        "init", str(tmp_path / "log.csv"), "--urdf", str(tmp_path / "arm.urdf"), "-o", str(path)
    )
    assert done.code == 0, done.err
    assert 'check length_unit = "mm"' in done.err
    robot = load_robot(path)
    steps = [joint.encoder_resolution for joint in robot.joints]
    assert steps == pytest.approx([np.radians(0.01), 2e-5], rel=1e-4)
    from seqid_cli.logs.read import read_recording

    read = read_recording(tmp_path / "log.csv", robot)
    np.testing.assert_allclose(read.q[:, 0], np.radians(turn), atol=1e-9)
    np.testing.assert_allclose(read.q[:, 1], 1e-3 * slide, atol=1e-9)


def test_the_log_that_is_named_first_says_which_imus_there_are(rig: Rig) -> None:
    """In whatever order the names sort."""
    log = log_with(rig.folder, {})
    shutil.copy(rig.folder / log, rig.folder / "a.parquet")
    shutil.copy(LOG, rig.folder / "b.parquet")
    done = rig.run("init", "b.parquet", "a.parquet", "--urdf", "arm.urdf", "-o", "new.toml")
    assert "to do: where IMU imu_a rides, and its layout" in done.err


def test_a_gripper_on_the_same_topic_is_left_out(rig: Rig) -> None:
    columns = read_columns(LOG)
    t = columns["t"]
    q, tau = (np.column_stack([columns[f"{j}.{k}"] for j in SIX]) for k in ("position", "current"))
    stamps = 1_700_000_000_000_000_000 + np.rint(t * 1e9).astype(np.int64)
    own = joint_messages(stamps, SIX, q, effort=tau)
    finger = joint_messages(stamps[::50] + 1_000_000, ["finger"], np.full((len(t), 1), 0.02))
    messages = sorted([*own, *finger], key=lambda message: message[1])
    write_messages(rig.folder / "log.mcap", messages, encoding="cdr")
    shutil.copy(URDF, rig.folder / "arm.urdf")
    seen = rig.run("inspect", "log.mcap", "--json")
    assert seen.code == 0, seen.err
    found = json.loads(seen.out)
    assert tuple(joint["name"] for joint in found["logs"][0]["joints"]) == SIX
    (lacking,) = found["findings"]  # nor are its messages samples that the arm's joints miss
    assert (lacking["code"], lacking["joint"]) == ("torque_missing", "finger")
    done = rig.run("init", "log.mcap", "--urdf", "arm.urdf", "-o", "new.toml")
    assert done.code == 0, done.err
    assert "to do: the log has neither torque nor current of finger: left out" in done.err
    assert load_robot(rig.folder / "new.toml").joint_names == SIX
