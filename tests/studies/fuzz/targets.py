"""What is fuzzed: sound files of every kind, and the command lines that read them."""

import json
from collections.abc import Mapping, Sequence
from pathlib import Path

import msgspec
import pyarrow.parquet as pq

from seqid_cli.params.dates import now
from seqid_cli.params.document import head
from seqid_cli.params.encode import encode
from seqid_cli.params.io import read_parameters
from seqid_cli.params.results.prediction import FileId
from seqid_cli.params.results.trend import TREND_SCHEMA, TrendFile
from tests.studies.fuzz import readers
from tests.studies.fuzz.answers import answer
from tests.studies.fuzz.command_lines import lines_for
from tests.studies.fuzz.mutations import BINARY, TEXT, Damage, word
from tests.studies.fuzz.shapes import (
    csv_shape,
    json_shape,
    mcap_shape,
    parquet_shape,
    sqlite_shape,
    toml_shape,
    xml_shape,
)
from tests.studies.fuzz.structured import column, element, record, row, value
from tests.studies.fuzz.target import Line, Target
from tests.studies.fuzz.thrift import footer, page
from tests.unit.drive.test_command import bench
from tests.unit.inspect.faults import SAMPLES
from tests.unit.logs import format_writers as formats
from tests.unit.logs.samples import make_motion
from tests.unit.logs.writers import rewrite, write_mcap
from tests.unit.params.documents import JOINTS, diagnosis_file, full_file
from tests.unit.report.pages import (
    payload_file,
    plan_file,
    prediction_file,
    write_torques,
)

MCAP = (*BINARY, *[record] * 8, *[mcap_shape] * 2)
PARQUET = (*BINARY, *[column] * 12, *[footer] * 6, *[page] * 6, *[parquet_shape] * 2)
BAG = (*BINARY, *[word] * 16)
SQLITE = (*BINARY, *[row] * 16, *[sqlite_shape] * 3)
JSON = (*TEXT, *[value] * 20, *[json_shape] * 2)
TOML = (*TEXT, *[toml_shape] * 2)
XML = (*TEXT, *[element] * 20, *[xml_shape] * 4)
CSV = (*TEXT, *[csv_shape] * 2)
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
# In a folder for `run`, which goes by the suffix; the content tells the format.
LOG = "folder/inertia/log.parquet"
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


_SAMPLE = SAMPLES / "one_joint"
# Logs of the sample robot, by the names that command lines give them.
_TRIALS = {
    "log": "validation/point_to_point",
    "held_out": "changed/held_out",
    "friction": "friction/joint_1",
    "gravity": "gravity/joint_1",
    "imu": "imu/joint_1_posture_1",
    "inertia": "inertia/joint_1",
}


def targets(work: Path) -> list[Target]:
    arm, sample = _arm(work), sample_files(work)
    every = [*_logs(work, arm), *_robots(arm, sample), *_documents(work, arm, sample)]
    trials = [sample[name] for name in _TRIALS]
    log = Target("Parquet, trials", LOG, trials, PARQUET, lines_for("log"), (), sample)
    return [*every, log]


def _robots(arm: Mapping[str, bytes], sample: Mapping[str, bytes]) -> list[Target]:
    dh = arm["robot.toml"]
    by_urdf = _ARM.format(more='urdf = "arm.urdf"', dh="").encode()
    lines, kinds = lines_for("robot"), [dh, dh + _MORE.encode(), by_urdf]
    # A damaged URDF is read wherever the robot file that names it is.
    drawn = [
        *lines_for("URDF"),
        *_in_place_of("{}", "{@}/robot.toml", lines),
    ]
    urdfs, beside = [arm["arm.urdf"]], {**arm, "robot.toml": by_urdf}
    own = [sample["robot.toml"]]
    alone = readers.ROBOT
    (by_robot,) = _in_place_of("{}", "{@}/robot.toml", [alone])
    return [
        Target("robot.toml", "damaged.toml", kinds, TOML, lines, alone, arm),
        Target("robot.toml, trials", "damaged.toml", own, TOML, lines, (), sample),
        Target("URDF", "arm.urdf", urdfs, XML, drawn, by_robot, beside),
    ]


def _data(rows: int = 60) -> formats.Data:
    return formats.moving(JOINTS, rows)


def _arm(work: Path, rows: int = 300) -> dict[str, bytes]:
    """An arm of two joints: its robot file, a log, and a model that was identified from
    it.
    """
    robot, log = work / "robot.toml", formats.csv_own(work / "log.csv", _data(rows))
    robot.write_text(_ARM.format(more="", dh=_DH))
    model = work / "model.json"
    _done("simultaneous", str(log), "-r", str(robot), "-o", str(model))
    short = formats.csv_own(work / "short.csv", _data()).read_bytes()
    # A log that is held out is not one of those that are fitted.
    other = formats.csv_own(work / "other.csv", _data(70)).read_bytes()
    logs = dict.fromkeys(_TRIALS, short) | {"held_out": other}
    return {
        **logs,
        "robot.toml": robot.read_bytes(),
        "model.json": _light(model),
        "later.json": _later(_light(model)),
        "arm.urdf": _URDF.encode(),
        "folder/inertia/log.parquet": short,
    }


def sample_files(work: Path) -> dict[str, bytes]:
    """The sample robot of one joint, with a log for each stage."""
    logs = {
        name: (_SAMPLE / f"{path}.parquet").read_bytes()
        for name, path in _TRIALS.items()
    }
    return {
        **logs,
        "robot.toml": (_SAMPLE / "robot.toml").read_bytes(),
        "model.json": _light(_SAMPLE / "golden.json"),
        "later.json": _later(_light(_SAMPLE / "golden.json")),
        "arm.urdf": _URDF.encode(),
        "folder/friction/log.parquet": logs["friction"],
        "folder/gravity/log.parquet": logs["gravity"],
        "folder/inertia/log.parquet": logs["inertia"],
        "folder/validation/log.parquet": logs["log"],
    }


def _light(path: Path) -> bytes:
    """Return a parameter file with few digits in friction's covariances, most of its
    bytes.
    """
    model = read_parameters(path)
    for joint in model.stages.friction.joints.values():
        joint.covariance = [
            [float(f"{value:.1g}") if j == k else 0.0 for j, value in enumerate(row)]
            for k, row in enumerate(joint.covariance)
        ]
    return encode(model).encode()


def _later(model: bytes) -> bytes:
    """Return a parameter file of another date."""
    document = json.loads(model) | {"created": "2031-01-01T00:00:00Z"}
    return json.dumps(document).encode()


def _done(*line: str) -> None:
    """Run a command that has to work."""
    code, said, _ = answer(line, 60.0)
    if code not in (0, 1):
        raise RuntimeError(said)


def _logs(work: Path, arm: Mapping[str, bytes]) -> list[Target]:
    def made(name: str, *writers: formats.Write) -> list[bytes]:
        folder = work / name
        folder.mkdir()
        paths = [write(folder / str(k), _data()) for k, write in enumerate(writers)]
        return [
            (next(p.glob("*.db3")) if p.is_dir() else p).read_bytes() for p in paths
        ]

    cdr = made("mcap_cdr", formats.mcap_cdr, formats.mcap_dynamic, _with_imus)
    texts = made(
        "mcap_json",
        formats.mcap_json,
        formats.mcap_foxglove_json,
        formats.mcap_json_bare,
    )
    bag = made("rosbag2", formats.rosbag2_sqlite)
    logs: dict[str, tuple[list[bytes], Sequence[Damage]]] = {
        "MCAP, CDR": (cdr + _rewritten(work, cdr), MCAP),
        "MCAP, JSON": (texts + _rewritten(work, texts), MCAP),
        "MCAP, protobuf": (made("protobuf", formats.mcap_foxglove_protobuf), MCAP),
        "Parquet": (made("parquet", formats.parquet, _plain), PARQUET),
        "Parquet, LeRobot episodes": (
            made("lerobot", formats.lerobot, _episodes),
            PARQUET,
        ),
        "CSV": (
            made("csv", formats.csv_own, formats.csv_rtde, formats.csv_franka),
            CSV,
        ),
        "ROS 1 bag": (made("rosbag1", formats.rosbag1), BAG),
        "ROS 2 bag: SQLite": (bag, SQLITE),
    }
    lines = lines_for("log")
    found = [
        Target(name, LOG, seeds, how, lines, readers.LOG, arm)
        for name, (seeds, how) in logs.items()
    ]
    # A bag has it, and that is all that is asked of it: readers alone do not read it.
    yaml = [(work / "rosbag2" / "0" / "metadata.yaml").read_bytes()]
    name, bag_lines = "ROS 2 bag: metadata.yaml", _in_place_of("{}", "{@}/bag", lines)
    beside = {**arm, "bag/0.db3": bag[0]}
    return [
        *found,
        Target(name, "bag/metadata.yaml", yaml, TEXT, bag_lines, (), beside),
    ]


def _in_place_of(word: str, other: str, lines: Sequence[Line]) -> list[Line]:
    return [tuple(x.replace(word, other) for x in line) for line in lines]


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


def _documents(
    work: Path, arm: Mapping[str, bytes], sample: Mapping[str, bytes]
) -> list[Target]:
    path, used = work / "torques.parquet", FileId(path="model.json", sha256="0" * 64)
    table = pq.read_table(write_torques(path))
    pq.write_table(table.take(list(range(0, len(table), 40))), path)
    torques, full = path.read_bytes(), encode(full_file()).encode()
    prediction = encode(prediction_file()).encode().replace(b"4000", b"100")
    more = {**arm, "prediction.json": prediction, "torques.parquet": torques}
    report = lines_for("document")
    report += [(*line, "--torques", "{@}/torques.parquet") for line in report]
    own = lines_for("parameters")
    driven = driven_files(work)
    kinds: dict[str, tuple[list[bytes], list[Line], Mapping[str, bytes]]] = {
        "parameters": ([full, arm["model.json"]], own, more),
        "parameters, trials": ([sample["model.json"]], own, {**more, **sample}),
        "plan": ([encode(plan_file()).encode()], lines_for("plan"), more),
        "drive": ([driven["drive.json"]], lines_for("drive"), {**more, **driven}),
    }
    others = {
        "diagnosis": diagnosis_file(),
        "payload": payload_file(used),
        "trend": _trend(used),
    }
    kinds["prediction"] = [prediction], [], more
    for name, content in others.items():
        kinds[name] = [encode(content).encode()], [], more
    reported = [
        Target(
            name=name,
            file="file.json",
            seeds=seeds,
            damages=JSON,
            lines=[*lines, *report],
            alone=() if "trials" in name else readers.RESULT,
            beside=beside,
        )
        for name, (seeds, lines, beside) in kinds.items()
    ]
    by_prediction = _in_place_of(
        "{@}/model.json", "{@}/prediction.json", lines_for("torques")
    )
    drawn = Target(
        name="torques",
        file="torques.parquet",
        seeds=[torques],
        damages=PARQUET,
        lines=by_prediction,
        alone=readers.TORQUES,
        beside=more,
    )
    return [*reported, drawn]


def driven_files(work: Path) -> dict[str, bytes]:
    """A joint with its controller: a robot file, a log with commands, a drive."""
    folder = work / "driven"
    folder.mkdir()
    robot = bench(folder)
    log, model = folder / "log_0.parquet", folder / "inertia.json"
    drive = folder / "drive.json"
    _done("drive", str(log), *robot, "-p", str(model), "-o", str(drive))
    return {
        "robot.toml": (folder / "robot.toml").read_bytes(),
        "log": log.read_bytes(),
        "model.json": model.read_bytes(),
        "drive.json": drive.read_bytes(),
    }


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
