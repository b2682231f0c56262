"""`seqid init`: the robot file that it writes, and that the package reads it."""

import json
import re
import shutil
import tomllib
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from seqid_cli.errors import ConfigError
from seqid_cli.inspect.guess import guess_channels
from seqid_cli.logs.read import read_recording
from seqid_cli.robot.file import load_robot
from seqid_cli.robot.toml_schema import Columns
from seqid_cli.robot.types import Robot
from tests.commands.conftest import SAMPLE_LOGS, Rig
from tests.plants.robots.small import joint, link, urdf
from tests.unit.inspect.faults import SIX, read_columns, write_columns
from tests.unit.logs.format_writers import (
    Data,
    Write,
    rosbag1,
    rosbag2_mcap,
    rosbag2_sqlite,
)
from tests.unit.logs.writers import joint_messages, write_messages

SIX_JOINT = SAMPLE_LOGS / "six_joint"
URDF = SIX_JOINT / "six_joint.urdf"
LOG = SIX_JOINT / "validation" / "fourier_1.parquet"
WORDS = ("--urdf", "arm.urdf", "-o", "new.toml")


@dataclass(frozen=True)
class Start:
    """A folder with the sample log and its URDF,
    from which a robot file is to be made.
    """

    rig: Rig

    def log(self, rename: Mapping[str, str]) -> "Start":
        """Write the sample log under other column names, without its IMUs."""
        columns = {}
        for name, values in read_columns(LOG).items():
            for old, text in rename.items():
                name = name.replace(old, text)
            if "imu" not in name:
                columns[name] = values
        write_columns(self.rig.folder / "log.parquet", columns)
        return self

    def urdf(self, old: str, new: str) -> "Start":
        path = self.rig.folder / "arm.urdf"
        text = path.read_text()
        assert re.search(old, text)
        path.write_text(re.sub(old, new, text))
        return self

    def init(self, *words: str, code: int = 0) -> str:
        done = self.rig.run("init", *(words or ("log.parquet", *WORDS)))
        assert done.code == code, done.err
        return done.err

    @property
    def file(self) -> Path:
        return self.rig.folder / "new.toml"

    @property
    def document(self) -> dict[str, Any]:
        return tomllib.loads(self.file.read_text())

    def robot(self) -> Robot:
        """The robot, once the drive data are filled in that only a person knows."""
        pattern = r"# ((?:torque_constant|gear_ratio) = [0-9.]+)"
        self.file.write_text(re.sub(pattern, r"\1", self.file.read_text()))
        return load_robot(self.file)

    def findings(self, *words: str) -> list[dict[str, str]]:
        words = words or ("log.parquet", "-r", "new.toml")
        document = json.loads(self.rig.run("inspect", *words, "--json").out)
        return list(document["findings"])


@pytest.fixture
def start(rig: Rig) -> Start:
    (rig.folder / "robot.toml").unlink()  # of another arm: whoever begins has none
    shutil.copy(URDF, rig.folder / "arm.urdf")
    return Start(rig).log({})


def test_the_file_holds_what_log_and_urdf_say(start: Start) -> None:
    said = start.init()
    assert "to do: torque_constant and gear_ratio of every joint" in said
    robot = load_robot(start.file)
    assert robot.joint_names == SIX
    assert robot.joints[2].position_limits == (-2.4, 2.4)
    assert robot.joints[0].velocity_limit == 2.2
    assert robot.joints[1].encoder_resolution == pytest.approx(
        3.0517578125e-05, rel=1e-5
    )
    assert start.document["gravity"] == [0.0, 0.0, -9.81]


@pytest.mark.slow
@pytest.mark.parametrize(
    "form", ["{name}.", "axis{index}_", "axis{index}.", "arm_{name}_link."]
)
def test_names_of_any_logger_are_mapped_by_name_or_number(
    start: Start, form: str
) -> None:
    own = {name: form.format(name=name, index=k + 1) for k, name in enumerate(SIX)}
    start.log({f"{name}.": text for name, text in own.items()}).init()
    assert [joint["name"] for joint in start.document["joint"]] == list(SIX)
    channels = {quantity: f"{form}{quantity}" for quantity in ("position", "current")}
    usual = form == "{name}."
    assert start.document.get("channels", {}) == ({} if usual else channels)
    refused = start.rig.run("inspect", "log.parquet", "-r", "new.toml")
    assert refused.code == 1
    assert "[drive_data_missing]" in refused.out
    recording = read_recording(start.rig.folder / "log.parquet", start.robot())
    np.testing.assert_allclose(recording.q[:, 2], read_columns(LOG)["elbow.position"])
    assert start.findings() == []


def test_a_torque_of_an_unknown_name_is_left_to_be_named(start: Start) -> None:
    said = start.log({".current": ".xyz"}).init()
    assert "to do: the torques or currents: no column or message was taken for" in said
    assert "to do: the torques" not in start.log({}).init(
        "log.parquet", *WORDS, "--force"
    )


def test_without_a_urdf_the_geometry_is_left_to_be_filled_in(start: Start) -> None:
    start.init("log.parquet", "-o", "new.toml")
    with pytest.raises(ConfigError, match="neither urdf nor joint"):
        start.robot()
    start.file.write_text(start.file.read_text().replace("# dh = ", "dh = "))
    assert load_robot(start.file).joint_names == SIX


def test_mimic_and_fixed_joints_and_other_branches_are_left_out(start: Start) -> None:
    tip = re.findall(r'<child link="([^"]+)"', URDF.read_text())[-1]
    gripper = (
        '<link name="l"/><link name="r"/><link name="t"/><joint name="left"'
        f' type="prismatic"><parent link="{tip}"/><child link="l"/><limit lower="0"'
        ' upper="1" effort="1" velocity="1"/></joint><joint name="right"'
        f' type="prismatic"><parent link="{tip}"/><child link="r"/><limit lower="0"'
        ' upper="1" effort="1" velocity="1"/><mimic joint="left"/></joint><joint'
        f' name="tool" type="fixed"><parent link="{tip}"/><child'
        ' link="t"/></joint></robot>'
    )
    start.urdf("</robot>", gripper).init()
    assert start.robot().joint_names == SIX
    assert "lacks, locked at zero: left" in start.file.read_text()


@pytest.mark.slow
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
    ids=["no limits", "no effort", "link named as joint", "comment", "mesh",
         "continuous", "no inertials", "floating"],
)  # fmt: skip
def test_unusual_urdfs_lead_to_a_file_that_is_accepted(
    start: Start, old: str, new: str
) -> None:
    start.urdf(old, new).init()
    assert start.robot().joint_names == SIX


NO_USE = {  # URDFs
    "twice": ("</robot>", '<link name="elbow_link"/></robot>'),
    "pi": (r'upper="[^"]*"', 'upper="pi"'),
    "loop": ("</robot>", '<joint name="back" type="fixed"><parent link="wrist_3_link"/>'
             '<child link="base_link"/></joint></robot>'),
}  # fmt: skip


@pytest.mark.slow
@pytest.mark.parametrize("turn", [np.pi / 2, 0.7])
def test_gravity_is_written_as_the_logs_tell_it(start: Start, turn: float) -> None:
    """The base frame of the URDF is turned about x: by a quarter, as of a wall, or
    slanted.
    """
    first = r'(?s)(<joint name="shoulder_pan".*?)rpy="[^"]*"'
    constants = [0.122, 0.12, 0.118, 0.104, 0.101, 0.103]
    drives = ("--torque-constant", ",".join(map(str, constants)), "--gear-ratio", "101")
    said = start.urdf(first, rf'\1rpy="{turn} 0 0"').init(
        "log.parquet", *WORDS, *drives
    )
    assert "the logs tell the mounting" in said
    robot = load_robot(start.file)
    gravity = 9.81 * np.array([0.0, np.sin(turn), -np.cos(turn)])
    np.testing.assert_allclose(robot.gravity, gravity, atol=0.01 if turn > 1.0 else 0.1)
    assert [joint.torque_constant for joint in robot.joints] == constants
    assert robot.name == "six_joint"
    assert start.findings() == []


def test_what_is_refused_and_an_existing_file_is_kept_unless_forced(
    start: Start,
) -> None:
    for name, (old, new) in NO_USE.items():
        text = re.sub(old, new, URDF.read_text(), count=1)
        (start.rig.folder / f"{name}.urdf").write_text(text)
    start.file.write_text("mine")
    start.rig.check_transcript("init")
    assert start.file.read_text() == "mine"
    assert not (start.rig.folder / "none.toml").exists()
    start.init("log.parquet", *WORDS, "--force")
    assert load_robot(start.file).n == 6


def test_imus_and_the_meaning_of_effort_are_left_to_be_said(rig: Rig) -> None:
    shutil.copy(
        SAMPLE_LOGS / "two_joint" / "imu" / "joint_2.mcap", rig.folder / "log.mcap"
    )
    document = json.loads(rig.run("init", "log.mcap", "--json").out)
    assert document["joints"] == ["joint_1", "joint_2"]
    text = document["robot_toml"]
    assert text.count("# [[imu]]") == 2
    assert all(line in text for line in ('# name = "imu_a"', '# effort = "current"'))
    assert tomllib.loads(text)["schema"] == "seqid/robot@1"


@pytest.mark.slow
@pytest.mark.parametrize("write", [rosbag1, rosbag2_sqlite, rosbag2_mcap])
def test_a_bag_needs_no_names_of_columns(start: Start, write: Write) -> None:
    t = np.arange(0.0, 2.0, 0.01)
    q = np.sin(np.outer(t, np.arange(1.0, 7.0)))
    log = write(start.rig.folder / "log", Data(t, tuple(SIX), q, q, q, q))
    assert "whether effort is torque" in start.init(log.name, *WORDS)
    assert load_robot(start.file).joint_names == SIX
    assert start.document["channels"] == {}


@pytest.mark.parametrize(
    ("columns", "patterns", "joints"),
    [
        (
            ["timestamp", *(f"{c}_{k}" for c in ("actual_q", "target_q", "actual_qd",
             "actual_current", "target_moment", "joint_temperatures")
             for k in range(6))],
            {"position": "actual_q_{index0}", "velocity": "actual_qd_{index0}",
             "current": "actual_current_{index0}",
             "temperature": "joint_temperatures_{index0}"},
            6,
        ),
        (
            ["t", *(f"{c}_{k}" for c in ("q", "dq", "tau", "tau_des")
             for k in (1, 2, 3))],
            {"position": "q_{index}", "velocity": "dq_{index}",
             "torque": "tau_{index}"},
            3,
        ),
        (
            ["time", *(f"state.{c}[{k}]" for c in ("q", "q_d", "tau_J")
             for k in range(7))],
            {"position": "state.q[{index0}]", "torque": "state.tau_J[{index0}]"},
            7,
        ),
        (
            ["time", "elbow/pos", "elbow/effort", "wrist/pos", "wrist/effort"],
            {"position": "{name}/pos", "torque": "{name}/effort"},
            2,
        ),
        (["time", "voltage", "status_1"], {}, 0),
        (["Zeit [ms]", *(f"{w} A{k} [x]" for w in ("Istposition", "Sollposition",
             "Istdrehzahl", "Motorstrom") for k in (1, 2))],
         {"position": "Istposition A{index} [x]",
          "velocity": "Istdrehzahl A{index} [x]",
          "current": "Motorstrom A{index} [x]"}, 2),
        (["time", "q2", "i2"], {"position": "q2", "current": "i2"}, 1),
        (["time", "q2", "q3", "i1", "i2", "i3"],
         {"position": ("q2", "q3"), "current": ("i2", "i3")}, 2),
        (["Zeit [s]", "Position A1 [°]", "Position A2 [mm]", "Strom A1 [A]",
          "Strom A2 [A]"],
         {"position": ("Position A1 [°]", "Position A2 [mm]"),
          "current": "Strom A{index} [A]"}, 2),
        (["time", "q_des", "q_act", "tau"], {"position": "q_act", "torque": "tau"}, 1),
        (["time", "elbow/pos [deg]", "wrist/pos [deg]"],
         {"position": "{name}/pos [deg]"}, 2),
    ],
)  # fmt: skip
def test_guessed_channels(
    columns: list[str], patterns: dict[str, Columns], joints: int
) -> None:
    found, names = guess_channels(columns)
    assert found == patterns
    assert len(names) == joints


def test_a_sliding_joint_in_mm_is_told_by_its_unit(start: Start) -> None:
    """The encoder's step is written in m and rad, also beside a turning joint in
    degrees.
    """
    t = np.arange(0.0, 8.0, 0.01)
    waves = (0.01 * np.round(4e3 * np.sin(t)), 0.5 * np.round(1e3 * np.sin(0.7 * t)))
    names = (
        "Position Achse 1 [°]",
        "Position Achse 2 [mm]",
        "Moment Achse 1",
        "Moment Achse 2",
    )
    lines = [";".join(["Zeit [s]", *names])]
    table = np.column_stack([t, *waves, 1.0 + t, 1.0 + t])
    lines += [";".join(f"{x:.2f}" for x in row).replace(".", ",") for row in table]
    (start.rig.folder / "log.csv").write_text("\n".join([*lines, ""]))
    links = [link(f"l{k}") for k in range(3)]
    joints = [
        joint("Achse 1", "l0", "l1"),
        joint("Achse 2", "l1", "l2", kind="prismatic"),
    ]
    (start.rig.folder / "arm.urdf").write_text(urdf(*links, *joints))
    assert 'check length_unit = "mm"' in start.init("log.csv", *WORDS)
    robot = load_robot(start.file)
    assert robot.channels.length_unit == "mm"
    found = [joint.encoder_resolution for joint in robot.joints]
    assert found == pytest.approx([np.radians(0.01), 5e-4], rel=1e-4)
    q = read_recording(start.rig.folder / "log.csv", robot).q
    for own, factor, wave in zip(q.T, (np.radians(1.0), 1e-3), waves, strict=True):
        np.testing.assert_allclose(own, factor * wave, atol=1e-9)


def test_the_log_that_is_named_first_says_which_imus_there_are(start: Start) -> None:
    """In whatever order the names sort."""
    shutil.copy(LOG, start.rig.folder / "more.parquet")
    said = start.init("more.parquet", "log.parquet", *WORDS)
    assert "to do: where IMU imu_a rides, and its layout" in said


@pytest.mark.slow
def test_a_gripper_on_the_same_topic_is_left_out(start: Start) -> None:
    columns = read_columns(LOG)
    t = columns["t"]
    q, tau = (
        np.column_stack([columns[f"{j}.{k}"] for j in SIX])
        for k in ("position", "current")
    )
    stamps = 1_700_000_000_000_000_000 + np.rint(t * 1e9).astype(np.int64)
    own = joint_messages(stamps, SIX, q, effort=tau)
    finger = joint_messages(
        stamps[::50] + 1_000_000, ["finger"], np.full((len(t), 1), 0.02)
    )
    messages = sorted([*own, *finger], key=lambda message: message[1])
    write_messages(start.rig.folder / "log.mcap", messages, encoding="cdr")
    (lacking,) = start.findings("log.mcap")  # nor do the arm's joints lack its samples
    assert (lacking["code"], lacking["joint"]) == ("torque_missing", "finger")
    said = start.init("log.mcap", *WORDS)
    assert "to do: the log has neither torque nor current of finger: left out" in said
    assert load_robot(start.file).joint_names == SIX


def bag(start: Start, *topics: str, names: Mapping[str, str] = {}) -> None:
    """Write the sample log as joint states on some topics, joints renamed."""
    columns = read_columns(LOG)
    q, tau = (
        np.column_stack([columns[f"{joint}.{quantity}"] for joint in SIX])
        for quantity in ("position", "current")
    )
    stamps = 1_700_000_000_000_000_000 + np.rint(columns["t"] * 1e9).astype(np.int64)
    joints = [names.get(joint, joint) for joint in SIX]
    messages = []
    for topic in topics:
        messages += joint_messages(stamps, joints, q, effort=tau, topic=topic)
    write_messages(start.rig.folder / "log.mcap", messages, encoding="cdr")


@pytest.mark.slow
def test_a_namespaced_topic_is_written_and_to_be_checked(start: Start) -> None:
    bag(start, "/arm/cmd_joint_states", "/right/joint_states", "/left/joint_states")
    said = start.init("log.mcap", *WORDS)
    assert "joints are read from /left/joint_states; this robot's states may" in said
    assert "on /right/joint_states, /arm/cmd_joint_states" in said
    assert start.document["channels"] == {"topic": "/left/joint_states"}
    read_recording(start.rig.folder / "log.mcap", load_robot(start.file))


@pytest.mark.slow
def test_a_prefix_in_the_log_is_written(start: Start) -> None:
    names = {joint: f"UR2024_{joint}" for joint in SIX}
    bag(start, "/joint_states", names=names)
    start.init("log.mcap", *WORDS)
    assert start.document["channels"] == {"prefix": "UR2024_"}
    robot = load_robot(start.file)
    assert robot.joint_names == SIX
    read_recording(start.rig.folder / "log.mcap", robot)


def test_other_names_in_the_log_are_listed(start: Start) -> None:
    names = {joint: f"motor_{k + 1}" for k, joint in enumerate(SIX)}
    bag(start, "/joint_states", names=names)
    said = start.init("log.mcap", *WORDS)
    assert "check names under [channels]" in said
    assert start.document["channels"] == {"names": list(names.values())}
    read_recording(start.rig.folder / "log.mcap", load_robot(start.file))


def test_time_in_ms_without_a_unit_is_told_by_the_rate(start: Start) -> None:
    columns = read_columns(LOG)
    columns["time"] = columns.pop("t") * 1000.0
    columns = {name: x for name, x in columns.items() if "imu" not in name}
    write_columns(start.rig.folder / "log.parquet", columns)
    said = start.init()
    assert 'check time_unit = "ms" under [channels]' in said
    recording = read_recording(start.rig.folder / "log.parquet", start.robot())
    assert recording.rate_hz == pytest.approx(250.0)
    without = start.file.read_text().replace('time_unit = "ms"\n', "")
    start.file.write_text(without)
    refused = start.rig.run("simultaneous", "log.parquet", "-r", start.file.name)
    assert refused.code == 2
    assert "the time column is not in seconds" in refused.err
    assert 'time_unit = "ms"' in refused.err


def lerobot(start: Start, factor: float, *kinds: str) -> None:
    """Write the sample log as a LeRobot data set, with its torques in N m."""
    drives = load_robot(SIX_JOINT / "robot.toml").joints
    columns = {name: x[::5] for name, x in read_columns(LOG).items()}
    values = {
        "pos": [factor * columns[f"{joint}.position"] for joint in SIX],
        "vel": [
            factor * np.gradient(columns[f"{joint}.position"], columns["t"])
            for joint in SIX
        ],
        "torque": [
            (drive.torque_per_ampere or 1.0) * columns[f"{drive.name}.current"]
            for drive in drives
        ],
    }
    names = [f"{joint}.{kind}" for joint in SIX for kind in kinds]
    states = [values[kind][j] for j in range(len(SIX)) for kind in kinds]
    table = {"observation.state": list(np.column_stack(states).astype(np.float32))}
    if "torque" not in kinds:
        torques = np.column_stack(values["torque"]).astype(np.float32)
        table["observation.effort"] = list(torques)
    table["timestamp"] = columns["t"].astype(np.float32)

    folder = start.rig.folder / "set"
    (folder / "meta").mkdir(parents=True)
    (folder / "data").mkdir()
    info = {"features": {"observation.state": {"names": names}}}
    (folder / "meta" / "info.json").write_text(json.dumps(info))
    pq.write_table(pa.table(table), folder / "data" / "file-000.parquet")


@pytest.mark.slow
def test_degrees_of_a_state_with_speeds_are_told_by_the_limits(start: Start) -> None:
    start.urdf("(?s)<inertial.*?</inertial>", "")  # nor do masses tell it
    lerobot(start, np.degrees(1.0), "pos", "vel", "torque")
    said = start.init("set", *WORDS)
    assert 'check unit = "deg"' in said
    assert start.document["channels"] == {"unit": "deg"}
    recording = read_recording(
        start.rig.folder / "set" / "data" / "file-000.parquet", load_robot(start.file)
    )
    expected = read_columns(LOG)[f"{SIX[0]}.position"][::5]
    np.testing.assert_allclose(recording.q[:, 0], expected, atol=1e-4)


@pytest.mark.slow
def test_percent_and_degrees_are_asked_for_where_nothing_tells(start: Start) -> None:
    lerobot(start, 100.0 / np.pi, "pos")
    said = start.init("set", *WORDS)
    assert "to do: whether positions are in degrees or in percent of the range" in said
    assert "unit" not in start.document["channels"]
    errors = {finding["code"] for finding in start.findings("set", "-r", "new.toml")}
    assert "position_scale" in errors  # no stage says good before it is declared

    start.init("set", *WORDS, "--force", "--unit", "percent")
    assert start.document["channels"]["unit"] == "percent"
    load_robot(start.file)


def test_nothing_is_written_that_cannot_read_the_log(start: Start) -> None:
    """Two columns of one name are told apart by no robot file."""
    columns = read_columns(LOG)
    names = [name for name in columns if "imu" not in name]
    table = pa.table([columns[name] for name in names], names=names)
    table = table.append_column(
        f"{SIX[1]}.position", table.column(f"{SIX[1]}.position")
    )
    pq.write_table(table, start.rig.folder / "twice.parquet")
    assert "is there 2 times" in start.init("twice.parquet", *WORDS, code=2)
    assert not start.file.exists()


def described(
    folder: Path, descriptions: Mapping[str, str], topic: str = "/joint_states"
) -> None:
    """Write the sample log as a bag with descriptions of robots in front."""
    columns = read_columns(LOG)
    q, tau = (
        np.column_stack([columns[f"{joint}.{quantity}"] for joint in SIX])
        for quantity in ("position", "current")
    )
    stamps = 1_700_000_000_000_000_000 + np.rint(columns["t"] * 1e9).astype(np.int64)
    messages = [
        (name, int(stamps[0]), SimpleNamespace(data=text))
        for name, text in descriptions.items()
    ]
    messages += joint_messages(stamps, SIX, q, effort=tau, topic=topic)
    write_messages(folder / "log.mcap", messages, encoding="cdr")


def test_the_urdf_of_a_bag_is_taken_and_written(start: Start) -> None:
    (start.rig.folder / "arm.urdf").unlink()
    other = urdf(joint("a", "b", "c"), link("b"), link("c"))
    described(
        start.rig.folder,
        {"/robot_description": other, "/left/robot_description": URDF.read_text()},
        topic="/left/joint_states",
    )
    said = start.init("log.mcap", "-o", "new.toml")
    assert "written: new.urdf, of /left/robot_description in log.mcap" in said
    assert (start.rig.folder / "new.urdf").read_text() == URDF.read_text()
    assert start.document["urdf"] == "new.urdf"
    assert load_robot(start.file).joint_names == SIX


@pytest.mark.slow
def test_another_urdf_is_kept_unless_forced(start: Start) -> None:
    described(start.rig.folder, {"/robot_description": URDF.read_text()})
    (start.rig.folder / "new.urdf").write_text("<robot name='mine'/>")
    words = ("log.mcap", "-o", "new.toml")
    assert "--urdf" in start.init(*words, code=2)
    assert not start.file.exists()
    start.init(*words, "--force")
    assert (start.rig.folder / "new.urdf").read_text() == URDF.read_text()


@pytest.mark.slow
@pytest.mark.parametrize(
    ("text", "why"),
    [
        ("<robot>" + "<link name='a'/>" * 2 + "</robot>", "is left out"),
        ('<!DOCTYPE x [<!ENTITY a "b">]><robot name="x"/>', "XML entities"),
        ("no robot", ""),
    ],
)
def test_a_description_that_is_no_urdf_is_left_out(
    start: Start, text: str, why: str
) -> None:
    described(start.rig.folder, {"/robot_description": text})
    said = start.init("log.mcap", "-o", "new.toml")
    assert why in said
    assert "to do: the geometry" in said
    assert not (start.rig.folder / "new.urdf").exists()


def test_without_a_place_the_urdf_of_a_bag_is_told(start: Start) -> None:
    described(start.rig.folder, {"/robot_description": URDF.read_text()})
    assert "has a URDF on /robot_description: -o FILE" in start.init("log.mcap")


def test_files_without_names_and_time(start: Start) -> None:
    columns = read_columns(LOG)
    folder = start.rig.folder / "logs"
    folder.mkdir()
    for stem, quantity in (("positions", "position"), ("currents", "current")):
        table = np.column_stack([columns[f"{joint}.{quantity}"] for joint in SIX])
        np.savetxt(folder / f"{stem}.csv", table, delimiter=",")
    assert "rate = 200" in start.init("logs", *WORDS, code=2)
    start.init("logs", *WORDS, "--rate", "250")
    assert start.document["channels"] == {"rate": 250.0}
    recording = read_recording(folder / "positions.csv", start.robot())
    assert recording.rate_hz == pytest.approx(250.0)
    expected = np.column_stack([columns[f"{joint}.position"] for joint in SIX])
    np.testing.assert_allclose(recording.q, expected)
    assert recording.tau is not None


def test_limits_that_are_none_are_left_out(start: Start) -> None:
    """Programs that export URDFs write 1e16 where a joint has no limit."""
    urdf = start.rig.folder / "arm.urdf"
    text = re.sub(
        'lower="[^"]*" upper="[^"]*"', 'lower="-1e16" upper="1e16"', urdf.read_text()
    )
    urdf.write_text(text)
    start.init("log.parquet", *WORDS)
    assert all("position_limits" not in joint for joint in start.document["joint"])
    load_robot(start.file)
