"""Log files written by the real libraries, from plain arrays."""

import json
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
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

Message = tuple[str, int, SimpleNamespace]  # topic, log time in ns, content
JOINT_STATE = "sensor_msgs/msg/JointState"
IMU = "sensor_msgs/msg/Imu"
DYNAMIC = "control_msgs/msg/DynamicJointState"
STRING = "std_msgs/msg/String"

LINE = "=" * 80
TIME = f"{LINE}\nMSG: builtin_interfaces/Time\nint32 sec\nuint32 nanosec\n"
HEADER = f"{LINE}\nMSG: std_msgs/Header\nbuiltin_interfaces/Time stamp\nstring frame_id\n"
DEFINITIONS = {
    JOINT_STATE: (
        "std_msgs/Header header\n\nstring[] name\nfloat64[] position\nfloat64[] velocity\n"
        f"float64[] effort\n{HEADER}{TIME}"
    ),
    IMU: (
        "std_msgs/Header header\n\n"
        "geometry_msgs/Quaternion orientation\nfloat64[9] orientation_covariance\n\n"
        "geometry_msgs/Vector3 angular_velocity\nfloat64[9] angular_velocity_covariance\n\n"
        "geometry_msgs/Vector3 linear_acceleration\nfloat64[9] linear_acceleration_covariance\n"
        f"{LINE}\nMSG: geometry_msgs/Quaternion\n"
        "float64 x 0\nfloat64 y 0\nfloat64 z 0\nfloat64 w 1\n"
        f"{LINE}\nMSG: geometry_msgs/Vector3\nfloat64 x\nfloat64 y\nfloat64 z\n{HEADER}{TIME}"
    ),
    DYNAMIC: (
        "# Generic form of joint states\nstd_msgs/Header header\n\nstring[] joint_names\n"
        "InterfaceValue[] interface_values\n"
        f"{LINE}\nMSG: control_msgs/InterfaceValue\nstring[] interface_names\n"
        f"float64[] values\n{HEADER}{TIME}"
    ),
    STRING: "string data\n",
}
_TOLD_BY = {"position": JOINT_STATE, "orientation": IMU, "joint_names": DYNAMIC, "data": STRING}
COMPRESSIONS = {
    "none": CompressionType.NONE,
    "lz4": CompressionType.LZ4,
    "zstd": CompressionType.ZSTD,
}


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
    """Write the default columns: `t` s, `<joint>.position` ..., `<imu>.a1` ..., `<imu>.gx` ...

    Arrays are (N, n) per joint, (N, K) per accelerometer array and (N, 3) per gyro. An IMU that has
    a gyro and three accelerometers is written as a triad (`ax`, `ay`, `az`).
    """
    columns: dict[str, Array] = {"t": np.asarray(t)}
    for quantity, values in {"position": q, "velocity": dq, **quantities}.items():
        if values is not None:
            columns |= {
                f"{j}.{quantity}": own for j, own in zip(joints, np.transpose(values), strict=True)
            }
    for imu, values in (accelerometers or {}).items():
        triad = values.shape[1] == 3 and imu in (gyros or {})
        names = ["ax", "ay", "az"] if triad else [f"a{k + 1}" for k in range(values.shape[1])]
        columns |= {f"{imu}.{name}": values[:, k] for k, name in enumerate(names)}
    for imu, values in (gyros or {}).items():
        columns |= {f"{imu}.{name}": values[:, k] for k, name in enumerate(("gx", "gy", "gz"))}
    pq.write_table(pa.table(columns), path)
    return path


def write_mcap(
    path: Path,
    t: Array,
    joints: Sequence[str],
    q: Array,
    *,
    encoding: Literal["cdr", "json"],
    compression: str = "zstd",
    chunk_size: int = 1024 * 1024,
    log_offset_ns: int = 0,
    zero_stamps: bool = False,
    **channels: Any,
) -> Path:
    """Write the topics of `arm_messages`."""
    messages = arm_messages(t, joints, q, **channels)
    messages = [(topic, stamp + log_offset_ns, content) for topic, stamp, content in messages]
    if zero_stamps:
        for _, _, content in messages:
            content.header.stamp = SimpleNamespace(sec=0, nanosec=0)
    return write_messages(
        path, messages, encoding=encoding, compression=compression, chunk_size=chunk_size
    )


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

    An accelerometer array (N, K), K a multiple of 3, becomes `/<imu>/accel_1` ...; an IMU that is
    in `gyros` becomes `/<imu>/data` with its three accelerometers and its gyro.
    """
    stamps = t0_ns + np.rint(np.asarray(t) * 1e9).astype(np.int64)
    streams = [joint_messages(stamps, joints, q, dq=dq, effort=effort)]
    for imu, values in (accelerometers or {}).items():
        if imu not in (gyros or {}):
            for k in range(values.shape[1] // 3):
                triad = values[:, 3 * k : 3 * k + 3]
                streams.append(imu_messages(stamps, f"/{imu}/accel_{k + 1}", triad))
    for imu, rates in (gyros or {}).items():
        triad = (accelerometers or {}).get(imu, np.zeros_like(rates))
        streams.append(imu_messages(stamps, f"/{imu}/data", triad, rates))
    return [message for row in zip(*streams, strict=True) for message in row]


def encoded(
    messages: Sequence[Message],
    encoding: Literal["cdr", "json"],
    definitions: Mapping[str, str] = DEFINITIONS,
) -> tuple[dict[str, tuple[str, str, str, bytes]], Iterator[tuple[str, int, bytes]]]:
    """Encode messages for `write_raw`; the type of each topic is told from their fields."""
    kinds, schemas, encode = {}, {}, {}
    for topic, _, content in messages:
        if topic not in kinds:
            kinds[topic] = next(kind for name, kind in _TOLD_BY.items() if hasattr(content, name))
    for kind in kinds.values():
        if encoding == "json":
            schemas[kind], encode[kind] = ("jsonschema", b'{"type":"object"}'), as_json
        else:
            schemas[kind] = "ros2msg", definitions[kind].encode()
            encode[kind] = serialize_dynamic(kind, definitions[kind])[kind]
    topics = {topic: (encoding, kind, *schemas[kind]) for topic, kind in kinds.items()}
    return topics, ((topic, at, encode[kinds[topic]](content)) for topic, at, content in messages)


def as_json(content: object) -> bytes:
    """Write a message as JSON."""
    return json.dumps(content, default=vars).encode()


def write_messages(
    path: Path,
    messages: Sequence[Message],
    *,
    encoding: Literal["cdr", "json"],
    compression: str = "zstd",
    chunk_size: int = 1024 * 1024,
    definitions: Mapping[str, str] = DEFINITIONS,
) -> Path:
    """Write messages in the given order."""
    made = encoded(messages, encoding, definitions)
    return write_raw(path, *made, chunk_size=chunk_size, compression=COMPRESSIONS[compression])


def joint_messages(
    stamps_ns: NDArray[np.int64],
    joints: Sequence[str],
    q: Array,
    *,
    dq: Array | None = None,
    effort: Array | None = None,
    topic: str = "/joint_states",
) -> list[Message]:
    """JointState messages, one per row."""

    def row(values: Array | None, i: int) -> list[float]:
        return [] if values is None else [float(v) for v in values[i]]

    return [
        (
            topic,
            int(stamp),
            SimpleNamespace(
                header=header(int(stamp)),
                name=list(joints),
                position=row(q, i),
                velocity=row(dq, i),
                effort=row(effort, i),
            ),
        )
        for i, stamp in enumerate(stamps_ns)
    ]


def imu_messages(
    stamps_ns: NDArray[np.int64], topic: str, accelerations: Array, rates: Array | None = None
) -> list[Message]:
    """Imu messages, one per row of (N, 3) m/s^2 and (N, 3) rad/s."""
    rates = np.zeros_like(accelerations) if rates is None else rates
    return [
        (
            topic,
            int(stamp),
            SimpleNamespace(
                header=header(int(stamp), "imu_link"),
                orientation=SimpleNamespace(x=0.0, y=0.0, z=0.0, w=1.0),
                orientation_covariance=[-1.0] + [0.0] * 8,
                angular_velocity=_vector(rates[i]),
                angular_velocity_covariance=[0.0] * 9,
                linear_acceleration=_vector(accelerations[i]),
                linear_acceleration_covariance=[0.0] * 9,
            ),
        )
        for i, stamp in enumerate(stamps_ns)
    ]


def header(stamp_ns: int, frame: str = "base_link") -> SimpleNamespace:
    """Make a std_msgs/Header."""
    sec, nanosec = divmod(stamp_ns, 1_000_000_000)
    return SimpleNamespace(stamp=SimpleNamespace(sec=sec, nanosec=nanosec), frame_id=frame)


def rewrite(
    source: Path,
    target: Path,
    *,
    compression: str = "zstd",
    chunking: bool = True,
    index: bool = True,
    crc: bool = True,
    summary: bool = True,
    chunk_size: int = 1024 * 1024,
    keep: Callable[[str], bool] = lambda topic: True,
) -> Path:
    """Copy an MCAP file message by message with other settings of the writer."""
    with source.open("rb") as file, target.open("wb") as out:
        writer = RawWriter(
            out,
            chunk_size=chunk_size,
            compression=COMPRESSIONS[compression],
            index_types=IndexType.ALL if index else IndexType.NONE,
            use_chunking=chunking,
            enable_crcs=crc,
            enable_data_crcs=crc,
            use_statistics=summary,
            use_summary_offsets=summary,
            repeat_channels=summary,
            repeat_schemas=summary,
        )
        writer.start(profile="ros2")
        channels: dict[int, int] = {}
        for schema, channel, message in NonSeekingReader(file).iter_messages(log_time_order=False):
            if not keep(channel.topic):
                continue
            if channel.id not in channels:
                schema_id = 0
                if schema is not None:
                    schema_id = writer.register_schema(schema.name, schema.encoding, schema.data)
                channels[channel.id] = writer.register_channel(
                    channel.topic, channel.message_encoding, schema_id
                )
            writer.add_message(
                channels[channel.id],
                message.log_time,
                message.data,
                message.publish_time,
                message.sequence,
            )
        writer.finish()
    return target


def _vector(values: Array) -> SimpleNamespace:
    return SimpleNamespace(x=float(values[0]), y=float(values[1]), z=float(values[2]))


Channel = str | tuple[str, str, str, bytes]


def write_raw(
    path: Path,
    topics: Mapping[str, Channel],
    messages: Iterable[tuple[str, int, bytes]],
    *,
    chunk_size: int = 1024 * 1024,
    compression: CompressionType = CompressionType.ZSTD,
) -> Path:
    """Write messages (topic, log time in ns, bytes) as they are.

    `topics`: the encoding of each, and name, encoding and text of its schema where it has one.
    """
    with path.open("wb") as out:
        writer = RawWriter(out, chunk_size=chunk_size, compression=compression)
        writer.start(profile="ros2")
        channels = {}
        for topic, told in topics.items():
            encoding, *schema = (told,) if isinstance(told, str) else told
            number = writer.register_schema(*schema) if schema else 0
            channels[topic] = writer.register_channel(topic, encoding, number)
        for topic, stamp, data in messages:
            writer.add_message(channels[topic], stamp, data, stamp)
        writer.finish()
    return path
