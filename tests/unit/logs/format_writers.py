"""The same samples in every format that is read, each written by the format's own
writer.
"""

import csv
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pyarrow as pa
import pyarrow.csv as pa_csv
import pyarrow.parquet as pq
from foxglove_schemas_protobuf.JointState_pb2 import JointState
from foxglove_schemas_protobuf.JointStates_pb2 import JointStates
from mcap_protobuf.writer import Writer as ProtobufWriter
from numpy.typing import NDArray
from rosbags.rosbag1 import Writer as Bag1Writer
from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin
from rosbags.rosbag2 import Writer as Bag2Writer
from rosbags.typesys import Stores, get_typestore

from tests import Array
from tests.unit.logs import writers
from tests.unit.logs.samples import grid, make_motion
from tests.unit.logs.writers import (
    Message,
    as_json,
    joint_messages,
    write_messages,
    write_raw,
)

T0_NS = 1_700_000_000_000_000_000


@dataclass(frozen=True)
class Data:
    """What a log shall hold: t (N,) s; q, dq, current [A], torque [N m] (N, n)."""

    t: Array
    joints: tuple[str, ...]
    q: Array
    dq: Array
    current: Array
    torque: Array

    @property
    def stamps_ns(self) -> NDArray[np.int64]:
        return np.rint(self.t * 1e9).astype(np.int64) + T0_NS


def moving(joints: Sequence[str], rows: int) -> Data:
    """Return what a log of joints in motion shall hold."""
    motion = make_motion(grid(rows), n=len(joints))
    return Data(
        t=motion.t,
        joints=tuple(joints),
        q=motion.q,
        dq=motion.dq,
        current=motion.tau,
        torque=motion.tau,
    )


Write = Callable[[Path, Data], Path]


def columns(
    data: Data, time: str, position: str, velocity: str, current: str, torque: str = ""
) -> pa.Table:
    """One column per joint, by patterns of {name}, {i} from 0 and {k} from 1."""
    patterns = {
        position: data.q,
        velocity: data.dq,
        current: data.current,
        torque: data.torque,
    }
    found: dict[str, Array] = {time: data.t}
    for i, joint in enumerate(data.joints):
        own = {
            p.format(name=joint, i=i, k=i + 1): q[:, i]
            for p, q in patterns.items()
            if p
        }
        found |= own
    return pa.table(found)


OWN = ("t", "{name}.position", "{name}.velocity", "{name}.current")


def named(*patterns: str) -> Write:
    def write(path: Path, data: Data) -> Path:
        path = path.with_suffix(".parquet")
        pq.write_table(columns(data, *patterns), path)
        return path

    return write


parquet = named(*OWN)


def lerobot(path: Path, data: Data) -> Path:
    """One episode of a LeRobot data set: lists of float32, time as float32."""
    path = path.with_suffix(".parquet")
    pq.write_table(lerobot_table([data]), path)
    return path


def lerobot_table(episodes: Sequence[Data]) -> pa.Table:
    """Columns of a LeRobot data file; the clock begins again with each episode."""
    parts, lists = [], ("observation.state", "observation.effort", "action")
    for number, data in enumerate(episodes):
        values = [list(x.astype(np.float32)) for x in (data.q, data.current, data.q)]
        t = (data.t - data.t[0]).astype(np.float32)
        found = dict(zip(lists, values, strict=True)) | {"timestamp": t}
        rows = np.arange(len(t))
        found |= {"episode_index": np.full(len(t), number), "frame_index": rows}
        parts.append(pa.table(found | {"index": rows, "task_index": rows}))
    return pa.concat_tables(parts)


def csv_own(path: Path, data: Data) -> Path:
    path = path.with_suffix(".csv")
    pa_csv.write_csv(columns(data, *OWN), path)
    return path


def csv_rtde(path: Path, data: Data) -> Path:
    """UR RTDE: Python's csv.writer with spaces, vectors of six numbered from 0."""
    path = path.with_suffix(".csv")
    n = len(data.joints)
    vectors = (
        "actual_q",
        "actual_qd",
        "actual_current",
        "joint_temperatures",
        "target_q",
    )
    tool = [f"actual_tool_accelerometer_{i}" for i in range(3)]
    with path.open("w", newline="") as file:
        writer = csv.writer(file, delimiter=" ")
        writer.writerow(
            ["timestamp", *(f"{v}_{i}" for v in vectors for i in range(n)), *tool]
        )
        for t, q, dq, current in zip(
            data.t, data.q, data.dq, data.current, strict=True
        ):
            row = [t + 1234.5, *q, *dq, *current, *[31.5] * n, *q, 0.1, -0.2, 9.8]
            writer.writerow(map(float, row))
    return path


def csv_franka(path: Path, data: Data) -> Path:
    """libfranka: time in whole milliseconds, arrays in brackets."""
    path = path.with_suffix(".csv")
    n = len(data.joints)
    groups = [
        f"state.{g}"
        for g in ("q", "q_d", "dq", "dq_d", "tau_J", "tau_ext_hat_filtered")
    ]
    names = [f"{group}[{i}]" for group in [*groups, "cmd.q_d"] for i in range(n)]
    q, dq, tau = data.q, data.dq, data.torque
    milliseconds = np.column_stack([np.rint(data.t * 1000), np.ones(len(q))])
    rows = np.hstack([milliseconds, q, q, dq, dq, tau, tau * 0.0, q])
    header = ",".join(["time", "success_rate", *names])
    np.savetxt(path, rows, fmt="%.17g", delimiter=",", header=header, comments="")
    return path


def mcap_json_bare(path: Path, data: Data) -> Path:
    """Fields of JointState as JSON, no schema at all."""
    rows = [
        ("joint_states", at, as_json(content)) for _, at, content in joint_states(data)
    ]
    return write_raw(path.with_suffix(".mcap"), {"joint_states": "json"}, rows)


def joint_states(data: Data, dq: Array | None = None) -> list[Message]:
    return joint_messages(
        data.stamps_ns, data.joints, data.q, dq=dq, effort=data.current
    )


def dynamic_states(data: Data) -> list[Message]:
    """control_msgs/msg/DynamicJointState, joints in another order, with another
    interface.
    """
    kinds = ["position", "velocity", "effort", "estop"]
    messages, names = [], list(data.joints[::-1])
    values = np.stack([data.q, data.dq, data.current, np.zeros_like(data.q)], axis=2)[
        :, ::-1
    ]
    for stamp, rows in zip(data.stamps_ns.tolist(), values.tolist(), strict=True):
        own = [SimpleNamespace(interface_names=kinds, values=row) for row in rows]
        message = {
            "header": writers.header(stamp),
            "joint_names": names,
            "interface_values": own,
        }
        messages.append(("/dynamic_joint_states", stamp, SimpleNamespace(**message)))
    return messages


def mcap(messages: Callable[[Data], list[Message]], encoding: str) -> Write:
    def write(path: Path, data: Data) -> Path:
        return write_messages(
            path.with_suffix(".mcap"), messages(data), encoding=encoding
        )

    return write


mcap_cdr = mcap(lambda data: joint_states(data, dq=data.dq), "cdr")
mcap_dynamic, mcap_json = mcap(dynamic_states, "cdr"), mcap(joint_states, "json")


def mcap_foxglove_protobuf(
    path: Path, data: Data, topic: str = "/joint_states", chunk_size: int = 1024 * 1024
) -> Path:
    path = path.with_suffix(".mcap")
    with path.open("wb") as out, ProtobufWriter(out, chunk_size=chunk_size) as writer:
        for i, stamp in enumerate(data.stamps_ns.tolist()):
            message = JointStates()
            message.timestamp.FromNanoseconds(stamp)
            for j, name in enumerate(data.joints):
                row = {"position": data.q, "velocity": data.dq, "effort": data.current}
                own = {quantity: values[i, j] for quantity, values in row.items()}
                message.joints.append(JointState(name=name, **own))
            writer.write_message(topic, message, stamp, stamp)
    return path


def mcap_foxglove_json(path: Path, data: Data) -> Path:
    rows = []
    for i, stamp in enumerate(data.stamps_ns.tolist()):
        sec, nsec = divmod(stamp, 10**9)
        joints = [
            {
                "name": n,
                "position": data.q[i, j],
                "velocity": None,
                "effort": data.current[i, j],
            }
            for j, n in enumerate(data.joints)
        ]
        message = {"timestamp": {"sec": sec, "nsec": nsec}, "joints": joints}
        rows.append(("/joint_states", stamp, as_json(message)))
    channel = ("json", "foxglove.JointStates", "jsonschema", b'{"type": "object"}')
    return write_raw(path.with_suffix(".mcap"), {"/joint_states": channel}, rows)


def write_bag(
    path: Path,
    messages: Sequence[Message],
    *,
    plugin: StoragePlugin = StoragePlugin.SQLITE3,
    compression: CompressionMode | None = None,
) -> Path:
    """Write a ROS 1 bag, where the path ends with `.bag`,
    or the folder of a ROS 2 bag.
    """
    topics, rows = writers.encoded(messages, "cdr")
    humble, noetic = (
        get_typestore(Stores.ROS2_HUMBLE),
        get_typestore(Stores.ROS1_NOETIC),
    )
    first = path.suffix == ".bag"
    writer = (
        Bag1Writer(path)
        if first
        else Bag2Writer(path, version=9, storage_plugin=plugin)
    )
    if compression is not None:
        writer.set_compression(compression, CompressionFormat.ZSTD)
    with writer:
        links = {}
        for topic, (_, kind, _, definition) in topics.items():
            about = {"msgdef": definition.decode(), "rihs01": "RIHS01_0"}
            about = {"typestore": noetic} if first else about
            links[topic] = writer.add_connection(topic, kind, **about)
        for topic, at, data in rows:
            content = (
                bytes(humble.cdr_to_ros1(data, topics[topic][1])) if first else data
            )
            writer.write(links[topic], at, content)
    return path


def mcap_ros1(path: Path, data: Data) -> Path:
    """A ROS 1 bag that was converted to MCAP: its messages stay as they are."""
    return write_ros1(path.with_suffix(".mcap"), joint_states(data, dq=data.dq))


def write_ros1(
    path: Path, messages: Sequence[Message], *, defined: bool = True
) -> Path:
    """Write MCAP of ROS 1 messages, with or without their definitions."""
    noetic = get_typestore(Stores.ROS1_NOETIC)
    channels: dict[str, writers.Channel] = {}
    for topic, (_, kind, _, _) in writers.encoded(messages, "cdr")[0].items():
        text, _ = noetic.generate_msgdef(kind, ros_version=1)
        content = text.encode() if defined else b""
        channels[topic] = ("ros1", kind.replace("/msg/", "/"), "ros1msg", content)
    return write_raw(path, channels, ros1_rows(messages))


def ros1_rows(messages: Sequence[Message]) -> list[tuple[str, int, bytes]]:
    """Pack messages as ROS 1 does: topic, time of logging, content."""
    topics, rows = writers.encoded(messages, "cdr")
    humble = get_typestore(Stores.ROS2_HUMBLE)
    return [
        (topic, at, bytes(humble.cdr_to_ros1(data, topics[topic][1])))
        for topic, at, data in rows
    ]


def rosbag2_sqlite(path: Path, data: Data) -> Path:
    return write_bag(path, reversed_states(data))


def rosbag2_mcap(path: Path, data: Data) -> Path:
    return write_bag(path, reversed_states(data), plugin=StoragePlugin.MCAP)


def rosbag1(path: Path, data: Data) -> Path:
    return write_bag(path.with_suffix(".bag"), reversed_states(data))


def reversed_states(data: Data) -> list[Message]:
    rows = {name: getattr(data, name)[:, ::-1] for name in ("q", "dq", "current")}
    turned = replace(data, joints=data.joints[::-1], **rows)
    return joint_states(turned, dq=turned.dq)


WORDS = ("position", "velocity", "effort")
EXACT: dict[str, Write] = {
    "parquet": parquet,
    "parquet q_0": named("timestamp", "q_{i}", "dq_{i}", "current_{i}", "tau_{i}"),
    "parquet q_1": named("timestamp", "q_{k}", "qd_{k}", "current_{k}"),
    "parquet joint/position": named("timestamp", *(f"{{name}}/{own}" for own in WORDS)),
    "parquet position.joint": named("timestamp", *(f"{own}.{{name}}" for own in WORDS)),
    "csv": csv_own,
    "csv rtde": csv_rtde,
    "csv libfranka": csv_franka,
    "mcap cdr": mcap_cdr,
    "mcap ros1": mcap_ros1,
    "mcap DynamicJointState": mcap_dynamic,
    "mcap foxglove protobuf": mcap_foxglove_protobuf,
    "mcap foxglove json": mcap_foxglove_json,
    "mcap json": mcap_json,
    "mcap json without schema": mcap_json_bare,
    "rosbag2 sqlite": rosbag2_sqlite,
    "rosbag2 mcap": rosbag2_mcap,
    "rosbag1": rosbag1,
}
FLOAT32: dict[str, Write] = {"lerobot": lerobot}
