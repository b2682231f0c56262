"""The same samples in every format that is read, each written by the format's own writer."""

import csv
import json
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pyarrow as pa
import pyarrow.csv as pa_csv
import pyarrow.parquet as pq
from foxglove_schemas_protobuf.JointState_pb2 import JointState
from foxglove_schemas_protobuf.JointStates_pb2 import JointStates
from mcap_protobuf.writer import Writer as ProtobufWriter
from mcap_ros2.writer import Writer as Ros2Writer
from numpy.typing import NDArray
from rosbags.rosbag1 import Writer as Bag1Writer
from rosbags.rosbag2 import StoragePlugin
from rosbags.rosbag2 import Writer as Bag2Writer
from rosbags.typesys import Stores, get_typestore

from tests import Array
from tests.unit.logs.writers import (
    HEADER,
    LINE,
    TIME,
    Channel,
    header,
    write_mcap,
    write_parquet,
    write_raw,
)

T0_NS = 1_700_000_000_000_000_000
DYNAMIC = "control_msgs/msg/DynamicJointState"
DYNAMIC_DEFINITION = (
    "# Generic form of joint states\nstd_msgs/Header header\n\nstring[] joint_names\n"
    "InterfaceValue[] interface_values\n"
    f"{LINE}\nMSG: control_msgs/InterfaceValue\nstring[] interface_names\nfloat64[] values\n"
    f"{HEADER}{TIME}"
)


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
    def stamps_ns(self) -> list[int]:
        """Stamps of the rows as an epoch time."""
        whole: NDArray[np.int64] = np.rint(self.t * 1e9).astype(np.int64) + T0_NS
        return [int(stamp) for stamp in whole]


Write = Callable[[Path, Data], Path]


def parquet(path: Path, data: Data) -> Path:
    """Our own names."""
    path = path.with_suffix(".parquet")
    return write_parquet(path, data.t, data.joints, data.q, dq=data.dq, current=data.current)


def named(position: str, velocity: str, current: str, torque: str = "") -> Write:
    """Parquet with one column per joint, by patterns of {name} and {i}."""

    def write(path: Path, data: Data) -> Path:
        columns: dict[str, Array] = {"timestamp": data.t}
        quantities = {position: data.q, velocity: data.dq, current: data.current}
        if torque:
            quantities |= {torque: data.torque}
        for pattern, values in quantities.items():
            for i, joint in enumerate(data.joints):
                columns[pattern.format(name=joint, i=i, k=i + 1)] = values[:, i]
        path = path.with_suffix(".parquet")
        pq.write_table(pa.table(columns), path)
        return path

    return write


def lerobot(path: Path, data: Data) -> Path:
    """One episode of a LeRobot data set: lists of float32, time as float32."""
    path = path.with_suffix(".parquet")
    pq.write_table(lerobot_table([data]), path)
    return path


def lerobot_table(episodes: Sequence[Data]) -> pa.Table:
    """Columns of a LeRobot data file; the clock begins again with each episode."""
    lists = pa.list_(pa.float32())
    parts = []
    for number, data in enumerate(episodes):
        count = len(data.t)
        parts.append(
            pa.table(
                {
                    "observation.state": pa.array(list(data.q.astype(np.float32)), lists),
                    "observation.effort": pa.array(list(data.current.astype(np.float32)), lists),
                    "action": pa.array(list(data.q.astype(np.float32)), lists),
                    "timestamp": pa.array((data.t - data.t[0]).astype(np.float32)),
                    "frame_index": pa.array(np.arange(count)),
                    "episode_index": pa.array(np.full(count, number)),
                    "index": pa.array(np.arange(count)),
                    "task_index": pa.array(np.zeros(count, np.int64)),
                }
            )
        )
    return pa.concat_tables(parts)


def csv_own(path: Path, data: Data) -> Path:
    """Our own names as Arrow writes CSV."""
    columns = {"t": data.t}
    for i, joint in enumerate(data.joints):
        columns[f"{joint}.position"] = data.q[:, i]
        columns[f"{joint}.velocity"] = data.dq[:, i]
        columns[f"{joint}.current"] = data.current[:, i]
    path = path.with_suffix(".csv")
    pa_csv.write_csv(pa.table(columns), path)
    return path


def csv_rtde(path: Path, data: Data) -> Path:
    """UR RTDE: Python's csv.writer with spaces, vectors of six numbered from 0."""
    path = path.with_suffix(".csv")
    n = len(data.joints)
    vectors = ("actual_q", "actual_qd", "actual_current", "joint_temperatures", "target_q")
    with path.open("w", newline="") as file:
        writer = csv.writer(file, delimiter=" ")
        tool = [f"actual_tool_accelerometer_{i}" for i in range(3)]
        writer.writerow(["timestamp", *(f"{v}_{i}" for v in vectors for i in range(n)), *tool])
        for i, t in enumerate(data.t.tolist()):
            row = [*data.q[i], *data.dq[i], *data.current[i], *[31.5] * n, *data.q[i]]
            writer.writerow([t + 1234.5, *map(float, row), 0.1, -0.2, 9.8])
    return path


def csv_franka(path: Path, data: Data, digits: int = 17) -> Path:
    """libfranka: time in whole milliseconds, arrays in brackets."""
    path = path.with_suffix(".csv")
    n = len(data.joints)
    groups = ("q", "q_d", "dq", "dq_d", "tau_J", "tau_ext_hat_filtered")
    names = ["time", "success_rate", *(f"state.{g}[{i}]" for g in groups for i in range(n))]
    names += [f"cmd.q_d[{i}]" for i in range(n)]
    lines = [",".join(names)]
    for i, t in enumerate(data.t.tolist()):
        q, dq, tau = data.q[i], data.dq[i], data.torque[i]
        row = np.concatenate([q, q, dq, dq, tau, tau * 0.0, q])
        lines.append(f"{round(t * 1000)},1," + ",".join(f"{v:.{digits}g}" for v in row))
    path.write_text("\n".join(lines) + "\n")
    return path


def mcap_cdr(path: Path, data: Data) -> Path:
    """sensor_msgs/msg/JointState as ROS 2 records it."""
    return write_mcap(
        path.with_suffix(".mcap"),
        data.t,
        data.joints,
        data.q,
        encoding="cdr",
        dq=data.dq,
        effort=data.current,
    )


def mcap_dynamic(path: Path, data: Data) -> Path:
    """control_msgs/msg/DynamicJointState, joints in another order, with other interfaces."""
    path = path.with_suffix(".mcap")
    order = list(range(len(data.joints)))[::-1]
    with path.open("wb") as out:
        writer = Ros2Writer(out)
        schema = writer.register_msgdef(DYNAMIC, DYNAMIC_DEFINITION)
        for i, stamp in enumerate(data.stamps_ns):
            values = [
                SimpleNamespace(
                    interface_names=["position", "velocity", "effort", "estop"],
                    values=[data.q[i, j], data.dq[i, j], data.current[i, j], 0.0],
                )
                for j in order
            ]
            message = SimpleNamespace(
                header=header(stamp),
                joint_names=[data.joints[j] for j in order],
                interface_values=values,
            )
            writer.write_message("/dynamic_joint_states", schema, message, stamp, stamp)
        writer.finish()  # type: ignore[no-untyped-call]
    return path


def mcap_foxglove_protobuf(
    path: Path, data: Data, topic: str = "/joint_states", chunk_size: int = 1024 * 1024
) -> Path:
    """foxglove.JointStates by the generated classes."""
    path = path.with_suffix(".mcap")
    with path.open("wb") as out, ProtobufWriter(out, chunk_size=chunk_size) as writer:
        for i, stamp in enumerate(data.stamps_ns):
            message = JointStates()
            message.timestamp.FromNanoseconds(stamp)
            for j, name in enumerate(data.joints):
                message.joints.append(
                    JointState(
                        name=name,
                        position=data.q[i, j],
                        velocity=data.dq[i, j],
                        effort=data.current[i, j],
                    )
                )
            writer.write_message(topic, message, stamp, stamp)
    return path


def mcap_foxglove_json(path: Path, data: Data) -> Path:
    """foxglove.JointStates as JSON."""
    return _json(path, _foxglove_rows(data), "foxglove.JointStates", "/joint_states")


def mcap_json(path: Path, data: Data) -> Path:
    """Fields of JointState as JSON with a JSON schema."""
    return _json(path, _joint_state_rows(data), "JointState", "/joint_states")


def mcap_json_bare(path: Path, data: Data) -> Path:
    """Fields of JointState as JSON, no schema at all."""
    return _json(path, _joint_state_rows(data), "", "joint_states")


def _foxglove_rows(data: Data) -> Iterator[tuple[int, dict[str, object]]]:
    for i, stamp in enumerate(data.stamps_ns):
        sec, nsec = divmod(stamp, 10**9)
        joints = [
            {"name": n, "position": data.q[i, j], "velocity": None, "effort": data.current[i, j]}
            for j, n in enumerate(data.joints)
        ]
        yield stamp, {"timestamp": {"sec": sec, "nsec": nsec}, "joints": joints}


def _joint_state_rows(data: Data) -> Iterator[tuple[int, dict[str, object]]]:
    for i, stamp in enumerate(data.stamps_ns):
        sec, nanosec = divmod(stamp, 10**9)
        yield (
            stamp,
            {
                "header": {"stamp": {"sec": sec, "nanosec": nanosec}, "frame_id": ""},
                "name": list(data.joints),
                "position": data.q[i].tolist(),
                "velocity": [],
                "effort": data.current[i].tolist(),
            },
        )


def _json(
    path: Path, rows: Iterator[tuple[int, dict[str, object]]], schema: str, topic: str
) -> Path:
    channel: Channel = ("json", schema, "jsonschema", b'{"type": "object"}') if schema else "json"
    messages = ((topic, stamp, json.dumps(row).encode()) for stamp, row in rows)
    return write_raw(path.with_suffix(".mcap"), {topic: channel}, messages)


def rosbag2_sqlite(path: Path, data: Data) -> Path:
    """A ROS 2 bag folder with an SQLite file; returns the folder."""
    return _rosbag2(path, data, StoragePlugin.SQLITE3)


def rosbag2_mcap(path: Path, data: Data) -> Path:
    """A ROS 2 bag folder with an MCAP file; returns the folder."""
    return _rosbag2(path, data, StoragePlugin.MCAP)


def _rosbag2(path: Path, data: Data, plugin: StoragePlugin) -> Path:
    store = get_typestore(Stores.ROS2_HUMBLE)
    with Bag2Writer(path, version=9, storage_plugin=plugin) as writer:
        kind = "sensor_msgs/msg/JointState"
        connection = writer.add_connection("/joint_states", kind, typestore=store)
        for stamp, message in ros_messages(data, store.types, {}):
            writer.write(connection, stamp, store.serialize_cdr(message, kind))
    return path


def rosbag1(path: Path, data: Data) -> Path:
    """A ROS 1 bag."""
    path = path.with_suffix(".bag")
    store = get_typestore(Stores.ROS1_NOETIC)
    with Bag1Writer(path) as writer:
        kind = "sensor_msgs/msg/JointState"
        connection = writer.add_connection("/joint_states", kind, typestore=store)
        for stamp, message in ros_messages(data, store.types, {"seq": 3}):
            writer.write(connection, stamp, store.serialize_ros1(message, kind))
    return path


def ros_messages(
    data: Data, types: dict[str, type], more: dict[str, int]
) -> Iterator[tuple[int, object]]:
    """Joint states with the joints in reverse order."""
    names = list(data.joints)[::-1]
    joint_state, head = types["sensor_msgs/msg/JointState"], types["std_msgs/msg/Header"]
    time = types["builtin_interfaces/msg/Time"]
    for i, stamp in enumerate(data.stamps_ns):
        sec, nanosec = divmod(stamp, 10**9)
        yield (
            stamp,
            joint_state(
                header=head(stamp=time(sec=sec, nanosec=nanosec), frame_id="base", **more),
                name=names,
                position=np.array(data.q[i, ::-1]),
                velocity=np.array(data.dq[i, ::-1]),
                effort=np.array(data.current[i, ::-1]),
            ),
        )


EXACT: dict[str, Write] = {
    "parquet": parquet,
    "parquet q_0": named("q_{i}", "dq_{i}", "current_{i}", "tau_{i}"),
    "parquet q_1": named("q_{k}", "qd_{k}", "current_{k}"),
    "parquet joint/position": named("{name}/position", "{name}/velocity", "{name}/effort"),
    "parquet position.joint": named("position.{name}", "velocity.{name}", "effort.{name}"),
    "csv": csv_own,
    "csv rtde": csv_rtde,
    "csv libfranka": csv_franka,
    "mcap cdr": mcap_cdr,
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
