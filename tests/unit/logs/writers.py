"""Log files written by the real libraries, from plain arrays."""

import json
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from functools import cache
from pathlib import Path
from types import SimpleNamespace
from typing import Any, Literal

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
from mcap.reader import NonSeekingReader
from mcap.writer import CompressionType, IndexType
from mcap.writer import Writer as RawWriter
from mcap_ros2._dynamic import serialize_dynamic
from numpy.typing import NDArray

from tests import Array

Encoding = Literal["cdr", "json"]
# encoding; name, encoding and text of its schema
Channel = str | tuple[str, str, str, bytes]
Message = tuple[str, int, SimpleNamespace]  # topic, log time in ns, content
JOINT_STATE = "sensor_msgs/msg/JointState"
IMU = "sensor_msgs/msg/Imu"
DYNAMIC = "control_msgs/msg/DynamicJointState"
CONTROLLER = "control_msgs/msg/JointTrajectoryControllerState"
STRING = "std_msgs/msg/String"

LINE = "=" * 80
TIME = f"{LINE}\nMSG: builtin_interfaces/Time\nint32 sec\nuint32 nanosec\n"
HEADER = (
    f"{LINE}\nMSG: std_msgs/Header\nbuiltin_interfaces/Time stamp\nstring frame_id\n"
)
DEFINITIONS = {
    JOINT_STATE: (
        "std_msgs/Header header\n\nstring[] name\nfloat64[] position\nfloat64[]"
        f" velocity\nfloat64[] effort\n{HEADER}{TIME}"
    ),
    IMU: (
        "std_msgs/Header header\n\ngeometry_msgs/Quaternion orientation\nfloat64[9]"
        " orientation_covariance\n\ngeometry_msgs/Vector3 angular_velocity\nfloat64[9]"
        " angular_velocity_covariance\n\ngeometry_msgs/Vector3"
        f" linear_acceleration\nfloat64[9] linear_acceleration_covariance\n{LINE}\nMSG:"
        " geometry_msgs/Quaternion\nfloat64 x 0\nfloat64 y 0\nfloat64 z 0\nfloat64 w"
        f" 1\n{LINE}\nMSG: geometry_msgs/Vector3\nfloat64 x\nfloat64 y\nfloat64"
        f" z\n{HEADER}{TIME}"
    ),
    DYNAMIC: (
        "# Generic form of joint states\nstd_msgs/Header header\n\nstring[]"
        f" joint_names\nInterfaceValue[] interface_values\n{LINE}\nMSG:"
        " control_msgs/InterfaceValue\nstring[] interface_names\nfloat64[]"
        f" values\n{HEADER}{TIME}"
    ),
    CONTROLLER: (
        "std_msgs/Header header\nstring[] joint_names\ntrajectory_msgs/"
        "JointTrajectoryPoint reference\ntrajectory_msgs/JointTrajectoryPoint"
        " feedback\ntrajectory_msgs/JointTrajectoryPoint error\ntrajectory_msgs/"
        f"JointTrajectoryPoint output\n{LINE}\nMSG: trajectory_msgs/"
        "JointTrajectoryPoint\nfloat64[] positions\nfloat64[] velocities\nfloat64[]"
        " accelerations\nfloat64[] effort\nbuiltin_interfaces/Duration"
        f" time_from_start\n{LINE}\nMSG: builtin_interfaces/Duration\nint32 sec\n"
        f"uint32 nanosec\n{HEADER}{TIME}"
    ),
    STRING: "string data\n",
}
_TOLD_BY = {
    "position": JOINT_STATE,
    "orientation": IMU,
    "reference": CONTROLLER,
    "joint_names": DYNAMIC,
    "data": STRING,
}
COMPRESSIONS = {kind.name.lower(): kind for kind in CompressionType}


def write_parquet(
    path: Path,
    t: Array,
    joints: Sequence[str],
    q: Array,
    *,
    dq: Array | None = None,
    accelerometers: dict[str, Array] | None = None,
    gyros: dict[str, Array] | None = None,
    **quantities: Array | None,
) -> Path:
    """Write the default columns: `t` s, `<joint>.position` ..., `<imu>.a1` ...,
    `<imu>.gx` ...

    Arrays are (N, n) per joint, (N, K) per accelerometer array and (N, 3) per gyro. An
    IMU that has a gyro and three accelerometers is written as a triad (`ax`, `ay`,
    `az`).
    """
    gyros = gyros or {}
    columns: dict[str, Array] = {"t": np.asarray(t)}
    for quantity, values in {"position": q, "velocity": dq, **quantities}.items():
        if values is not None:
            names = [f"{joint}.{quantity}" for joint in joints]
            columns |= zip(names, np.transpose(values), strict=True)
    for imu, values in (accelerometers or {}).items():
        count = values.shape[1]
        triad = count == 3 and imu in gyros
        names = [f"{imu}.a{axis}" for axis in ("xyz" if triad else range(1, count + 1))]
        columns |= zip(names, values.T, strict=True)
    for imu, values in gyros.items():
        columns |= zip([f"{imu}.g{axis}" for axis in "xyz"], values.T, strict=True)
    pq.write_table(pa.table(columns), path)
    return path


def write_mcap(
    path: Path,
    t: Array,
    joints: Sequence[str],
    q: Array,
    *,
    encoding: Encoding,
    compression: str = "zstd",
    chunk_size: int = 1024 * 1024,
    log_offset_ns: int = 0,
    zero_stamps: bool = False,
    **channels: Any,
) -> Path:
    messages = []
    for topic, stamp, content in arm_messages(t, joints, q, **channels):
        if zero_stamps:
            content.header.stamp = SimpleNamespace(sec=0, nanosec=0)
        messages.append((topic, stamp + log_offset_ns, content))
    storage = {"compression": compression, "chunk_size": chunk_size}
    return write_messages(path, messages, encoding=encoding, **storage)


def arm_messages(
    t: Array,
    joints: Sequence[str],
    q: Array,
    *,
    dq: Array | None = None,
    effort: Array | None = None,
    accelerometers: dict[str, Array] | None = None,
    gyros: dict[str, Array] | None = None,
    t0_ns: int = 1_700_000_000_000_000_000,
) -> list[Message]:
    """Messages on `/joint_states` and the IMU topics with the stamps t0_ns + t.

    An accelerometer array (N, K), K a multiple of 3, becomes `/<imu>/accel_1` ...; an
    IMU that is in `gyros` becomes `/<imu>/data` with its three accelerometers and its
    gyro.
    """
    accelerometers, gyros = accelerometers or {}, gyros or {}
    stamps = t0_ns + np.rint(np.asarray(t) * 1e9).astype(np.int64)
    streams = [joint_messages(stamps, joints, q, dq=dq, effort=effort)]
    for imu, values in accelerometers.items():
        for k in range(0 if imu in gyros else values.shape[1] // 3):
            triad = values[:, 3 * k : 3 * k + 3]
            streams.append(imu_messages(stamps, f"/{imu}/accel_{k + 1}", triad))
    for imu, rates in gyros.items():
        triad = accelerometers.get(imu, np.zeros_like(rates))
        streams.append(imu_messages(stamps, f"/{imu}/data", triad, rates))
    return [message for row in zip(*streams, strict=True) for message in row]


def encoded(
    messages: Sequence[Message], encoding: Encoding
) -> tuple[dict[str, Channel], Iterator[tuple[str, int, bytes]]]:
    """Encode messages for `write_raw`; the type of each topic is told from their
    fields.
    """
    topics: dict[str, Channel] = {}
    encode: dict[str, Callable[[object], bytes]] = {}
    for topic, _, content in messages:
        if topic not in topics:
            kind = next(
                kind for name, kind in _TOLD_BY.items() if hasattr(content, name)
            )
            if encoding == "json":
                schema, encode[topic] = ("jsonschema", b'{"type":"object"}'), as_json
            else:
                schema = "ros2msg", DEFINITIONS[kind].encode()
                encode[topic] = serialize_dynamic(kind, DEFINITIONS[kind])[kind]
            topics[topic] = (encoding, kind, *schema)
    return topics, (
        (topic, at, encode[topic](content)) for topic, at, content in messages
    )


def as_json(content: object) -> bytes:
    return json.dumps(content, default=vars).encode()


def write_messages(
    path: Path, messages: Sequence[Message], *, encoding: Encoding, **storage: Any
) -> Path:
    """Write messages in the given order; `storage`: see `write_raw`."""
    return write_raw(path, *encoded(messages, encoding), **storage)


def joint_messages(
    stamps_ns: NDArray[np.int64],
    joints: Sequence[str],
    q: Array,
    *,
    dq: Array | None = None,
    effort: Array | None = None,
    topic: str = "/joint_states",
) -> list[Message]:
    quantities = {"position": q, "velocity": dq, "effort": effort}
    messages = []
    for i, stamp in enumerate(stamps_ns.tolist()):
        rows = {
            n: [] if v is None else list(map(float, v[i]))
            for n, v in quantities.items()
        }
        content = SimpleNamespace(header=header(stamp), name=list(joints), **rows)
        messages.append((topic, stamp, content))
    return messages


def controller_messages(
    stamps_ns: NDArray[np.int64],
    joints: Sequence[str],
    *,
    reference: Array,
    velocity: Array,
    feedback: Array,
    effort: Array,
    topic: str = "/arm_controller/controller_state",
) -> list[Message]:
    """States of a joint trajectory controller that commands effort, one per row."""

    def point(**rows: Array) -> SimpleNamespace:
        names = ("positions", "velocities", "accelerations", "effort")
        lists = {name: list(map(float, rows.get(name, ()))) for name in names}
        return SimpleNamespace(
            **lists, time_from_start=SimpleNamespace(sec=0, nanosec=0)
        )

    messages = []
    for i, stamp in enumerate(stamps_ns.tolist()):
        content = SimpleNamespace(
            header=header(stamp),
            joint_names=list(joints),
            reference=point(positions=reference[i], velocities=velocity[i]),
            feedback=point(positions=feedback[i]),
            error=point(positions=reference[i] - feedback[i]),
            output=point(effort=effort[i]),
        )
        messages.append((topic, stamp, content))
    return messages


def imu_messages(
    stamps_ns: NDArray[np.int64],
    topic: str,
    accelerations: Array,
    rates: Array | None = None,
) -> list[Message]:
    """Imu messages, one per row of (N, 3) m/s^2 and (N, 3) rad/s."""
    rates = np.zeros_like(accelerations) if rates is None else rates
    messages = []
    for stamp, rate, acceleration in zip(
        stamps_ns.tolist(), rates, accelerations, strict=True
    ):
        content = SimpleNamespace(
            header=header(stamp, "imu_link"),
            orientation=SimpleNamespace(x=0.0, y=0.0, z=0.0, w=1.0),
            orientation_covariance=[-1.0] + [0.0] * 8,
            angular_velocity=_vector(rate),
            angular_velocity_covariance=[0.0] * 9,
            linear_acceleration=_vector(acceleration),
            linear_acceleration_covariance=[0.0] * 9,
        )
        messages.append((topic, stamp, content))
    return messages


def header(stamp_ns: int, frame: str = "base_link") -> SimpleNamespace:
    sec, nanosec = divmod(stamp_ns, 1_000_000_000)
    return SimpleNamespace(
        stamp=SimpleNamespace(sec=sec, nanosec=nanosec), frame_id=frame
    )


def rewrite(
    source: Path,
    target: Path,
    *,
    chunking: bool = True,
    index: bool = True,
    crc: bool = True,
    summary: bool = True,
    **storage: Any,
) -> Path:
    """Copy an MCAP file message by message with other settings of the writer."""
    summaries = (
        "use_statistics",
        "use_summary_offsets",
        "repeat_channels",
        "repeat_schemas",
    )
    storage |= dict.fromkeys(summaries, summary) | {"use_chunking": chunking}
    storage |= dict.fromkeys(("enable_crcs", "enable_data_crcs"), crc)
    storage["index_types"] = IndexType.ALL if index else IndexType.NONE
    with source.open("rb") as file:
        found = list(NonSeekingReader(file).iter_messages(log_time_order=False))
    topics: dict[str, Channel] = {
        link.topic: (
            (link.message_encoding, schema.name, schema.encoding, schema.data)
            if schema
            else link.message_encoding
        )
        for schema, link, _ in found
    }
    messages = (
        (link.topic, message.log_time, message.data) for _, link, message in found
    )
    return write_raw(target, topics, messages, at_once=False, **storage)


def _vector(values: Array) -> SimpleNamespace:
    return SimpleNamespace(**dict(zip("xyz", map(float, values), strict=True)))


def write_raw(
    path: Path,
    topics: Mapping[str, Channel],
    messages: Iterable[tuple[str, int, bytes]],
    *,
    compression: str = "zstd",
    at_once: bool = True,
    **storage: Any,
) -> Path:
    """Write messages (topic, log time in ns, bytes), all channels before them or as
    they come.
    """
    with path.open("wb") as out:
        writer = RawWriter(out, compression=COMPRESSIONS[compression], **storage)
        writer.start(profile="ros2")

        @cache
        def channel(topic: str) -> int:
            told = topics[topic]
            encoding, *schema = (told,) if isinstance(told, str) else told
            number = writer.register_schema(*schema) if schema else 0
            return writer.register_channel(topic, encoding, number)

        list(map(channel, topics if at_once else ()))
        for topic, stamp, data in messages:
            writer.add_message(channel(topic), stamp, data, stamp)
        writer.finish()
    return path
