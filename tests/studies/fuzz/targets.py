"""What is fuzzed: sound files of every kind, and the command lines that read them."""

from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path

import msgspec
import pyarrow.parquet as pq

from seqid_cli.params.document import now, tool
from seqid_cli.params.encode import encode
from seqid_cli.params.io import read_parameters
from seqid_cli.params.results.prediction import FileId
from seqid_cli.params.results.trend import TREND_SCHEMA, TrendFile
from tests.studies.fuzz.answers import answer
from tests.studies.fuzz.mutations import BINARY, TEXT, Damage, word
from tests.studies.fuzz.structured import column, element, record, row, value
from tests.unit.logs import format_writers as formats
from tests.unit.logs.samples import grid, make_motion
from tests.unit.logs.writers import rewrite, write_mcap
from tests.unit.params.documents import JOINTS, diagnosis_file, full_file
from tests.unit.report.pages import prediction_file, write_torques
from tests.unit.report.test_parts import payload_file, plan_file

MCAP, PARQUET, BAG = (*BINARY, *[record] * 8), (*BINARY, *[column] * 16), (*BINARY, *[word] * 16)
SQLITE, JSON, XML = (*BINARY, *[row] * 16), (*TEXT, *[value] * 20), (*TEXT, *[element] * 20)
Line = tuple[str, ...]  # of a command; {} is the damaged file, {@} the folder
_ARM = 'schema = "seqid/robot@1"\nname = "arm"\ngravity = [0.0, 0.0, -9.81]\n{more}\n' + "".join(
    f'[[joint]]\nname = "{name}"\n{{dh}}torque_constant = 0.1\ngear_ratio = {ratio}\n'
    "encoder_resolution = 1e-5\nposition_limits = [-2.8, 2.8]\nvelocity_limit = 2.0\n"
    for name, ratio in zip(JOINTS, (101.0, -50.0), strict=True)
)
_DH = "dh = { alpha = 0.5, a = 0.3, d = 0.0, theta0 = 0.0 }\n"
_MORE = """
[[imu]]
name = "imu_a"
after_joint = "elbow"
accelerometers = [{ position = [0.0, 0.1, 0.0], axis = [1.0, 0.0, 0.0] }]
gyro = true

[channels]
time = "t"
position = "{name}.position"
effort = "torque"

[[effect]]
name = "shoulder_drag"
joint = "elbow"
torque = "c1 * sin(p * dq_1) + c2 * tanh(dq / p) * abs(load) ** 2"
settings = { p = [0.5, 4.0] }
"""
_URDF = """<?xml version="1.0"?>
<robot name="arm">
  <link name="base"/>
  <link name="upper"><inertial><origin xyz="0.1 0 0" rpy="0 0 0.1"/><mass value="2.5"/>
    <inertia ixx="0.01" ixy="0" ixz="0" iyy="0.02" iyz="0" izz="0.02"/></inertial></link>
  <link name="lower"/>
  <joint name="shoulder" type="revolute"><parent link="base"/><child link="upper"/>
    <origin xyz="0 0 0.2" rpy="0.5 0 0"/><axis xyz="0 0 1"/>
    <limit lower="-2.8" upper="2.8" effort="100" velocity="2"/></joint>
  <joint name="elbow" type="continuous"><parent link="upper"/><child link="lower"/>
    <origin xyz="0.3 0 0"/><axis xyz="0 1 0"/></joint>
</robot>
"""


@dataclass(frozen=True)
class Target:
    """A kind of file: the name it gets, sound ones, ways to damage them, and who reads it."""

    name: str
    file: str
    seeds: Sequence[bytes]
    damages: Sequence[Damage]
    lines: Sequence[Line]
    beside: dict[str, bytes] = field(default_factory=dict)  # what else is in the folder


def targets(work: Path, rows: int = 60) -> list[Target]:
    """Make the sound files in a folder and return all kinds."""
    arm = _arm(work)
    return [*_logs(work, rows, arm), *_robots(arm), *_documents(work, arm)]


def _data(rows: int) -> formats.Data:
    motion = make_motion(grid(rows), n=2)
    return formats.Data(motion.t, tuple(JOINTS), motion.q, motion.dq, motion.tau, motion.tau)


def _arm(work: Path, rows: int = 300) -> dict[str, bytes]:
    """An arm of two joints: its robot file, a log, and a model that was identified from it."""
    robot, log = work / "robot.toml", formats.csv_own(work / "log.csv", _data(rows))
    robot.write_text(_ARM.format(more="", dh=_DH))
    code, said, _ = answer(["simultaneous", str(log), "-r", str(robot), "-o", f"{work}/model.json"])
    if code not in (0, 1):
        raise RuntimeError(said)
    short = formats.csv_own(work / "short.csv", _data(60)).read_bytes()
    model = read_parameters(work / "model.json")
    for joint in model.stages.friction.joints.values():  # most of the file
        joint.covariance = []
    return {
        "robot.toml": robot.read_bytes(),
        "log.csv": short,
        "model.json": encode(model).encode(),
        "arm.urdf": _URDF.encode(),
    }


def _logs(work: Path, rows: int, arm: dict[str, bytes]) -> list[Target]:
    data = _data(rows)
    with_robot: Line = ("inspect", "{}", "-r", "{@}/robot.toml")
    lines = (with_robot, with_robot, ("inspect", "{}"), ("init", "{}", "-o", "{@}/out.toml"))
    deep = (
        *lines,
        ("predict", "{}", "-r", "{@}/robot.toml", "-p", "{@}/model.json", "--cutoff", "20"),
    )

    def made(name: str, *writers: formats.Write) -> list[bytes]:
        folder = work / name
        folder.mkdir()
        return [_content(write(folder / str(k), data)) for k, write in enumerate(writers)]

    def log(name: str, seeds: list[bytes], damages: Sequence[Damage]) -> Target:
        return Target(name, "log", seeds, damages, deep, arm)

    cdr = made("mcap_cdr", formats.mcap_cdr, formats.mcap_dynamic, _with_imus)
    json = made("mcap_json", formats.mcap_json, formats.mcap_foxglove_json, formats.mcap_json_bare)
    bag2 = made("rosbag2", formats.rosbag2_sqlite)
    yaml = (work / "rosbag2" / "0" / "metadata.yaml").read_bytes()
    bag = Target(
        "ROS 2 bag: metadata.yaml",
        "bag/metadata.yaml",
        [yaml],
        TEXT,
        [tuple(part.replace("{}", "{@}/bag") for part in line) for line in lines],
        {**arm, "bag/0.db3": bag2[0]},
    )
    return [
        log("MCAP, CDR", cdr + _rewritten(work, cdr), MCAP),
        log("MCAP, JSON", json + _rewritten(work, json), MCAP),
        log("MCAP, protobuf", made("protobuf", formats.mcap_foxglove_protobuf), MCAP),
        log("Parquet", made("parquet", formats.parquet, _plain), PARQUET),
        log("Parquet, LeRobot episodes", made("lerobot", formats.lerobot, _episodes), PARQUET),
        log("CSV", made("csv", formats.csv_own, formats.csv_rtde, formats.csv_franka), TEXT),
        log("ROS 1 bag", made("rosbag1", formats.rosbag1), BAG),
        log("ROS 2 bag: SQLite", bag2, SQLITE),
        bag,
    ]


def _content(path: Path) -> bytes:
    return (next(path.glob("*.db3")) if path.is_dir() else path).read_bytes()


def _with_imus(path: Path, data: formats.Data) -> Path:
    motion = make_motion(data.t, n=2)
    return write_mcap(
        path.with_suffix(".mcap"),
        *(data.t, data.joints, data.q),
        encoding="cdr",
        accelerometers={"imu_a": motion.accelerometers["hand"]},
        gyros={"imu_a": motion.gyros["hand"]},
    )


def _rewritten(work: Path, logs: Sequence[bytes]) -> list[bytes]:
    """The same without compression and checksums: damage gets through to the messages."""
    source, target = work / "source.mcap", work / "target.mcap"
    found = []
    for content in logs:
        source.write_bytes(content)
        for chunking in (True, False):
            rewrite(source, target, compression="none", chunking=chunking, crc=False)
            found.append(target.read_bytes())
    return found


def _plain(path: Path, data: formats.Data) -> Path:
    source = formats.parquet(path, data)
    table = pq.read_table(source)
    pq.write_table(table, source, compression="none", use_dictionary=False, row_group_size=16)
    return source


def _episodes(path: Path, data: formats.Data) -> Path:
    path = path.with_suffix(".parquet")
    pq.write_table(formats.lerobot_table([data, data]), path, compression="none")
    return path


def _robots(arm: dict[str, bytes]) -> list[Target]:
    dh = arm["robot.toml"]
    by_urdf = _ARM.format(more='urdf = "arm.urdf"', dh="").encode()
    lines: Sequence[Line] = (
        ("export", "{@}/model.json", "-r", "{@}/robot.toml", "-o", "{@}/out.urdf"),
        ("plan", "gravity", "-r", "{@}/robot.toml", "-o", "{@}/out.json"),
        (
            "predict",
            "{@}/log.csv",
            "-r",
            "{@}/robot.toml",
            "-p",
            "{@}/model.json",
            "--cutoff",
            "20",
        ),
    )
    urdf = ("init", "{@}/log.csv", "--urdf", "{}", "-o", "{@}/out.toml")
    seeds = [dh, dh + _MORE.encode(), by_urdf]
    with_urdf = {**arm, "robot.toml": by_urdf}
    return [
        Target("robot.toml", "robot.toml", seeds, TEXT, lines, arm),
        Target("URDF", "arm.urdf", [arm["arm.urdf"]], XML, (*lines, urdf), with_urdf),
    ]


def _documents(work: Path, arm: dict[str, bytes]) -> list[Target]:
    folder = work / "documents"
    folder.mkdir()
    torques = _few_rows(write_torques(folder / "torques.parquet"))
    full = encode(full_file()).encode()
    prediction = encode(prediction_file()).encode().replace(b"4000", b"100")
    report: Line = ("report", "{}", "-o", "{@}/out.html")
    beside = {**arm, "sound.json": full}

    def document(name: str, content: object) -> Target:
        return Target(name, "file.json", [encode(content).encode()], JSON, [report], beside)

    used = FileId(path="model.json", sha256="0" * 64)
    parameters = (
        ("compare", "{}", "{@}/sound.json"),
        ("compare", "{@}/model.json", "{}"),
        ("trend", "{}", "{@}/sound.json", "-o", "{@}/out.json"),
        ("export", "{}", "-r", "{@}/robot.toml", "-o", "{@}/out.xml"),
        ("gravity", "{@}/log.csv", "-r", "{@}/robot.toml", "-p", "{}"),
        report,
    )
    return [
        Target("parameters", "file.json", [full, arm["model.json"]], JSON, parameters, beside),
        document("diagnosis", diagnosis_file()),
        Target(
            "prediction", "file.json", [prediction], JSON,
            [report, (*report, "--torques", "{@}/torques.parquet")],
            {**beside, "torques.parquet": torques},
        ),
        Target(
            "torques", "torques.parquet", [torques], PARQUET,
            [("report", "{@}/prediction.json", "--torques", "{}", "-o", "{@}/out.html")],
            {"prediction.json": prediction},
        ),
        document("payload", payload_file(used)),
        document("plan", plan_file()),
        document("trend", _trend(used)),
    ]  # fmt: skip


def _few_rows(path: Path) -> bytes:
    table = pq.read_table(path)
    pq.write_table(table.take(list(range(0, len(table), 40))), path)
    return path.read_bytes()


def _trend(used: FileId) -> TrendFile:
    day = now()
    series = {"dates": [day, day], "values": [1, 2], "std_errors": [0.1, 0.1]}
    quantity = {
        "robot": "arm",
        "stage": "friction",
        "joint": "elbow",
        "name": "at 1",
        "unit": "N m",
    }
    return msgspec.convert(
        {
            "schema": TREND_SCHEMA, "created": now(), "tool": msgspec.to_builtins(tool()),
            "files": [msgspec.to_builtins(used)], "robots": ["arm"], "alarm": False, "limit": 4.0,
            "inflation": {"friction": 1.0}, "changes": [quantity | {"kind": "step", "since": day}],
            "series": [quantity | series],
        },
        TrendFile,
    )  # fmt: skip
