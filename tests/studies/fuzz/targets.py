"""What is fuzzed: sound files of every kind, and the command lines that read them."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

import msgspec
import pyarrow.parquet as pq

from seqid_cli.params.dates import now
from seqid_cli.params.document import head
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
from tests.unit.report.pages import (
    payload_file,
    plan_file,
    prediction_file,
    write_torques,
)

MCAP, PARQUET, BAG = (
    (*BINARY, *[record] * 8),
    (*BINARY, *[column] * 16),
    (*BINARY, *[word] * 16),
)
SQLITE, JSON, XML = (
    (*BINARY, *[row] * 16),
    (*TEXT, *[value] * 20),
    (*TEXT, *[element] * 20),
)
_ARM = (
    'schema = "seqid/robot@1"\nname = "arm"\ngravity = [0.0, 0.0, -9.81]\n{more}\n'
    + "".join(
        f'[[joint]]\nname = "{name}"\n{{dh}}torque_constant = 0.1\ngear_ratio ='
        f" {ratio}\nencoder_resolution = 1e-5\nposition_limits = [-2.8,"
        " 2.8]\nvelocity_limit = 2.0\n"
        for name, ratio in zip(JOINTS, (101.0, -50.0), strict=True)
    )
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
    <inertia ixx="0.01" ixy="0" ixz="0" iyy="0.02" iyz="0" izz="0.02"/></inertial>
  </link>
  <link name="lower"/>
  <joint name="shoulder" type="revolute"><parent link="base"/><child link="upper"/>
    <origin xyz="0 0 0.2" rpy="0.5 0 0"/><axis xyz="0 0 1"/>
    <limit lower="-2.8" upper="2.8" effort="100" velocity="2"/></joint>
  <joint name="elbow" type="continuous"><parent link="upper"/><child link="lower"/>
    <origin xyz="0.3 0 0"/><axis xyz="0 1 0"/></joint>
</robot>
"""


Line = list[str]  # of a command; {} is the damaged file, {@} the folder


def _lines(text: str) -> list[Line]:
    return [line.split() for line in text.strip().splitlines()]


_READ = """
inspect {} -r {@}/robot.toml
inspect {} -r {@}/robot.toml
inspect {}
init {} -o {@}/out.toml
"""
_LOG = _lines(_READ + "predict {} -r {@}/robot.toml -p {@}/model.json --cutoff 20")
_ROBOT = _lines("""
export {@}/model.json -r {@}/robot.toml -o {@}/out.urdf
plan gravity -r {@}/robot.toml -o {@}/out.json
predict {@}/log.csv -r {@}/robot.toml -p {@}/model.json --cutoff 20
""")
_DRAWING = [*_ROBOT, *_lines("init {@}/log.csv --urdf {} -o {@}/out.toml")]
_REPORT = _lines("report {} -o {@}/out.html")
_PARAMETERS = _lines("""
compare {} {@}/sound.json
compare {@}/model.json {}
trend {} {@}/sound.json -o {@}/out.json
export {} -r {@}/robot.toml -o {@}/out.xml
gravity {@}/log.csv -r {@}/robot.toml -p {}
report {} -o {@}/out.html
""")
_TORQUES = _lines("report {@}/prediction.json --torques {} -o {@}/out.html")
_BOTH = _lines("report {} -o {@}/out.html --torques {@}/torques.parquet")


@dataclass(frozen=True)
class Target:
    """A kind of file: the name it gets, sound ones, ways to damage them, and who reads
    it.
    """

    name: str
    file: str
    seeds: Sequence[bytes]
    damages: Sequence[Damage]
    lines: Sequence[Line]
    # what else is in the folder
    beside: Mapping[str, bytes] = field(default_factory=dict)


def targets(work: Path) -> list[Target]:
    arm = _arm(work)
    dh, by_urdf = (
        arm["robot.toml"],
        _ARM.format(more='urdf = "arm.urdf"', dh="").encode(),
    )
    robots = [
        Target(
            "robot.toml", "robot.toml", [dh, dh + _MORE.encode(), by_urdf], TEXT, _ROBOT
        ),
        Target(
            "URDF",
            "arm.urdf",
            [arm["arm.urdf"]],
            XML,
            _DRAWING,
            {"robot.toml": by_urdf},
        ),
    ]
    every = [*_logs(work), *robots, *_documents(work, arm["model.json"])]
    return [replace(target, beside={**arm, **target.beside}) for target in every]


def _data(rows: int = 60) -> formats.Data:
    motion = make_motion(grid(rows), n=2)
    return formats.Data(
        motion.t, tuple(JOINTS), motion.q, motion.dq, motion.tau, motion.tau
    )


def _arm(work: Path, rows: int = 300) -> dict[str, bytes]:
    """An arm of two joints: its robot file, a log, and a model that was identified from
    it.
    """
    robot, log = work / "robot.toml", formats.csv_own(work / "log.csv", _data(rows))
    robot.write_text(_ARM.format(more="", dh=_DH))
    code, said, _ = answer(
        ["simultaneous", str(log), "-r", str(robot), "-o", f"{work}/model.json"]
    )
    if code not in (0, 1):
        raise RuntimeError(said)
    short = formats.csv_own(work / "short.csv", _data()).read_bytes()
    model = read_parameters(work / "model.json")
    for joint in model.stages.friction.joints.values():  # most of the file
        joint.covariance = []
    return {
        "robot.toml": robot.read_bytes(),
        "log.csv": short,
        "model.json": encode(model).encode(),
        "arm.urdf": _URDF.encode(),
    }


def _logs(work: Path) -> list[Target]:
    def made(name: str, *writers: formats.Write) -> list[bytes]:
        folder = work / name
        folder.mkdir()
        paths = [write(folder / str(k), _data()) for k, write in enumerate(writers)]
        return [
            (next(p.glob("*.db3")) if p.is_dir() else p).read_bytes() for p in paths
        ]

    cdr = made("mcap_cdr", formats.mcap_cdr, formats.mcap_dynamic, _with_imus)
    json = made(
        "mcap_json",
        formats.mcap_json,
        formats.mcap_foxglove_json,
        formats.mcap_json_bare,
    )
    bag = made("rosbag2", formats.rosbag2_sqlite)
    logs: dict[str, tuple[list[bytes], Sequence[Damage]]] = {
        "MCAP, CDR": (cdr + _rewritten(work, cdr), MCAP),
        "MCAP, JSON": (json + _rewritten(work, json), MCAP),
        "MCAP, protobuf": (made("protobuf", formats.mcap_foxglove_protobuf), MCAP),
        "Parquet": (made("parquet", formats.parquet, _plain), PARQUET),
        "Parquet, LeRobot episodes": (
            made("lerobot", formats.lerobot, _episodes),
            PARQUET,
        ),
        "CSV": (
            made("csv", formats.csv_own, formats.csv_rtde, formats.csv_franka),
            TEXT,
        ),
        "ROS 1 bag": (made("rosbag1", formats.rosbag1), BAG),
        "ROS 2 bag: SQLite": (bag, SQLITE),
    }
    found = [
        Target(name, "log", seeds, how, _LOG) for name, (seeds, how) in logs.items()
    ]
    yaml = [(work / "rosbag2" / "0" / "metadata.yaml").read_bytes()]
    lines, name = _lines(_READ.replace("{}", "{@}/bag")), "ROS 2 bag: metadata.yaml"
    beside = {"bag/0.db3": bag[0]}
    return [*found, Target(name, "bag/metadata.yaml", yaml, TEXT, lines, beside)]


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
    """The same without compression and checksums:
    damage gets through to the messages.
    """
    source, target, found = work / "source.mcap", work / "target.mcap", []
    for content in logs:
        source.write_bytes(content)
        for chunking in (True, False):
            rewrite(source, target, compression="none", chunking=chunking, crc=False)
            found.append(target.read_bytes())
    return found


def _plain(path: Path, data: formats.Data) -> Path:
    source, plain = (
        formats.parquet(path, data),
        {"compression": "none", "use_dictionary": False},
    )
    pq.write_table(pq.read_table(source), source, row_group_size=16, **plain)
    return source


def _episodes(path: Path, data: formats.Data) -> Path:
    path = path.with_suffix(".parquet")
    pq.write_table(formats.lerobot_table([data, data]), path, compression="none")
    return path


def _documents(work: Path, model: bytes) -> list[Target]:
    path, used = work / "torques.parquet", FileId(path="model.json", sha256="0" * 64)
    table = pq.read_table(write_torques(path))
    pq.write_table(table.take(list(range(0, len(table), 40))), path)
    torques, full = path.read_bytes(), encode(full_file()).encode()
    prediction = encode(prediction_file()).encode().replace(b"4000", b"100")
    more = {"prediction.json": prediction, "torques.parquet": torques}
    documents: dict[str, tuple[list[bytes], list[Line], dict[str, bytes]]] = {
        "parameters": ([full, model], _PARAMETERS, {"sound.json": full}),
        "prediction": ([prediction], [*_REPORT, *_BOTH], more),
    }
    others = {
        "diagnosis": diagnosis_file(),
        "payload": payload_file(used),
        "plan": plan_file(),
    }
    for name, content in (others | {"trend": _trend(used)}).items():
        documents[name] = [encode(content).encode()], _REPORT, {}
    found = [
        Target(name, "file.json", seeds, JSON, lines, beside)
        for name, (seeds, lines, beside) in documents.items()
    ]
    return [
        *found,
        Target("torques", "torques.parquet", [torques], PARQUET, _TORQUES, more),
    ]


def _trend(used: FileId) -> TrendFile:
    day = now()
    series = {"dates": [day, day], "values": [1, 2], "std_errors": [0.1, 0.1]}
    quantity = {"robot": "arm", "stage": "friction", "joint": "elbow", "name": "at 1"}
    quantity["unit"] = "N m"
    return msgspec.convert(
        {
            **msgspec.to_builtins(head(TREND_SCHEMA, day)),
            "files": [msgspec.to_builtins(used)],
            "robots": ["arm"],
            "alarm": False,
            "limit": 4.0,
            "inflation": {"friction": 1.0},
            "changes": [quantity | {"kind": "step", "since": day}],
            "series": [quantity | series],
        },
        TrendFile,
    )
