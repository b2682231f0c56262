"""Measured, predicted and residual torque with its motion, as Parquet or MCAP.

MCAP is for Foxglove, PlotJuggler and rerun: topics of `sensor_msgs/msg/JointState` in
CDR, as ROS 2 records them. `effort` holds the torque, `position` and `velocity` the
motion, and `header.frame_id` the name of the log. Topics `low` and `high` hold the
model's bounds: at rest an interval, else the predicted value. `std` holds the standard
deviation of the prediction.

A log without a clock starts a second after the log before it, and so does a log that
would overlap with it. The metadata record `seqid.logs` states the time of each log.

All messages of one log have the same layout. They are therefore filled in as rows of an
array of bytes, which is much faster than message by message.
"""

import contextlib
import struct
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
from mcap.writer import CompressionType, Writer
from numpy.typing import NDArray

from seqid_cli import __version__
from seqid_cli.identify.prediction.predict import LogPrediction
from seqid_cli.params.files import replacing, writing
from seqid_cli.typing import Array

PARAMETERS = "seqid.parameters"  # key of the metadata
# Columns of a joint and their fields of a `LogPrediction`; bounds are null where it
# slides.
_KINDS = ("predicted", "residual", "sliding", "std", "low", "high")
_TORQUES = {"torque": "tau", **{kind: kind for kind in _KINDS}}
_MOTION = {"position": "q", "velocity": "dq"}


@contextlib.contextmanager
def parquet_writer(
    path: Path, joints: Sequence[str], parameters: Sequence[str] = ()
) -> Iterator[Callable[[LogPrediction], None]]:
    """Open a Parquet file, and give the function that appends a log or a part of one.

    The file appears at its path in one step, when it is complete. Its columns are `t`,
    `log`, the torques of each joint, `used` (whether the sample counts in the errors),
    then position and velocity of each joint.

    Parameters
    ----------
    path : Path
        The file.
    joints : sequence of str
        Names of the joints.
    parameters : sequence of str
        SHA-256 of the model's files, for the metadata.
    """
    types = {"t": pa.float64(), "log": pa.string()}
    types |= {f"{name}.{kind}": pa.float64() for name in joints for kind in _TORQUES}
    types |= {f"{name}.sliding": pa.bool_() for name in joints}
    types |= {"used": pa.bool_()}
    types |= {f"{name}.{kind}": pa.float64() for name in joints for kind in _MOTION}
    metadata = {PARAMETERS: " ".join(parameters)} if parameters else None
    schema = pa.schema(types.items(), metadata)

    with replacing(path) as temporary:
        with writing(path):
            # Torques hardly repeat. A dictionary of them would take most of the time
            # and save nothing.
            writer = pq.ParquetWriter(temporary, schema, use_dictionary=["log"])

        def write(log: LogPrediction, *, rows: int = 65536) -> None:
            with writing(path):
                table = pa.table(_columns(log), schema=schema)
                writer.write_table(table, row_group_size=rows)

        yield write
        with writing(path):
            writer.close()


def _columns(log: LogPrediction) -> list[pa.Array]:
    """Return the columns of a table, in the order of its schema."""
    torques = {kind: getattr(log, field) for kind, field in _TORQUES.items()}
    motion = [getattr(log, field) for field in _MOTION.values()]

    columns = [pa.array(log.t), pa.array([str(log.path)] * len(log.t), pa.string())]
    for j, is_sliding in enumerate(log.sliding.T):
        for kind, values in torques.items():
            # Nulls stand for deviations that are not stated, and for the bounds of a
            # joint that slides, which has none.
            mask = np.isnan(values[:, j]) if kind == "std" else None
            if kind in ("low", "high"):
                mask = is_sliding
            columns.append(pa.array(values[:, j], mask=mask))

    columns.append(pa.array(log.used))
    for j in range(log.sliding.shape[1]):
        for values in motion:
            columns.append(pa.array(values[:, j], from_pandas=True))
    return columns


TOPICS = (
    "/seqid/measured",
    "/seqid/predicted",
    "/seqid/residual",
    "/seqid/std",
    "/seqid/low",
    "/seqid/high",
)
JOINT_STATE = "sensor_msgs/msg/JointState"
_RULE = "=" * 80
_DEFINITION = (
    "std_msgs/Header header\nstring[] name\nfloat64[] position\nfloat64[]"
    f" velocity\nfloat64[] effort\n{_RULE}\nMSG:"
    f" std_msgs/Header\nbuiltin_interfaces/Time stamp\nstring frame_id\n{_RULE}\nMSG:"
    " builtin_interfaces/Time\nint32 sec\nuint32 nanosec\n"
)


@contextlib.contextmanager
def mcap_writer(
    path: Path, joints: Sequence[str]
) -> Iterator[Callable[[LogPrediction], None]]:
    """Open an MCAP file, and give the function that appends a log or a part of one.

    The file appears at its path in one step, when it is complete.

    Parameters
    ----------
    path : Path
        The file.
    joints : sequence of str
        Names of the joints.
    """
    with replacing(path) as temporary:
        with writing(path):
            stream = temporary.open("wb")
        with stream:
            with writing(path):
                writer = Writer(stream, compression=CompressionType.ZSTD)
                writer.start(profile="ros2", library=f"seqid {__version__}")

            schema = writer.register_schema(
                JOINT_STATE, "ros2msg", _DEFINITION.encode()
            )
            channels = [
                writer.register_channel(topic, "cdr", schema) for topic in TOPICS
            ]
            clock = _Clock()

            def write(log: LogPrediction) -> None:
                stamps = clock.stamps(log)
                torques = (
                    log.tau,
                    log.predicted,
                    log.residual,
                    log.std,
                    log.low,
                    log.high,
                )
                tables = [_messages(stamps, log, joints, torque) for torque in torques]
                with writing(path):
                    for stamp, *rows in zip(stamps.tolist(), *tables, strict=True):
                        for channel, row in zip(channels, rows, strict=True):
                            writer.add_message(channel, stamp, row.tobytes(), stamp)

            yield write
            with writing(path):
                writer.add_metadata("seqid.logs", clock.places)
                writer.finish()  # type: ignore[no-untyped-call]


class _Clock:
    """A time axis for all logs, with `start` and `end` [s] of the last log on it."""

    def __init__(self) -> None:
        self.start = 0.0
        self.end = -np.inf
        self.places: dict[str, str] = {}

    def stamps(
        self, log: LogPrediction, *, pause_s: float = 1.0, latest_s: float = 2.0**31
    ) -> NDArray[np.int64]:
        """Return the time stamps (N,) ns of the samples of a log, or of a part of one.

        A log keeps its own clock if that starts after the log before, at 0 s or later,
        and ends before `latest_s`. Otherwise it starts `pause_s` after the log before.
        """
        if log.part == 0:
            period = float(log.t[-1] - log.t[0]) / max(len(log.t) - 1, 1)
            latest_start = latest_s - log.samples * period
            if self.end < log.start < latest_start and log.start >= 0.0:
                self.start = log.start
            else:
                self.start = max(self.end + pause_s, 0.0)

        self.end = self.start + float(log.t[-1])
        if log.last:
            place = f"{log.path}: {self.start:.6f} to {self.end:.6f} s"
            self.places[f"{len(self.places) + 1}"] = place
        return round(self.start * 1e9) + np.round(log.t * 1e9).astype(np.int64)


def _messages(
    stamps: NDArray[np.int64], log: LogPrediction, joints: Sequence[str], torque: Array
) -> NDArray[np.uint8]:
    """Return the messages of one topic as rows of bytes, all of one layout.

    Parameters
    ----------
    stamps : array (N,)
        Time stamps [ns].
    log : LogPrediction
        The log, or a part of one.
    joints : sequence of str
        Names of the n joints.
    torque : array (N, n)
        Torque of the topic [N m].

    Returns
    -------
    array (N, bytes)
        Messages in CDR, little-endian.
    """
    # The template begins with the encapsulation header, the stamp (filled in below),
    # the frame and the joint names.
    template = bytearray(b"\x00\x01\x00\x00" + bytes(8) + _string(str(log.path)))
    template += bytes(-len(template) % 4) + struct.pack("<I", len(joints))
    for name in joints:
        template += bytes(-len(template) % 4) + _string(name)

    seconds, nanoseconds = np.divmod(stamps, 10**9)
    fields: list[tuple[int, NDArray[Any]]] = [
        (4, seconds[:, None].astype("<u4")),
        (8, nanoseconds[:, None].astype("<u4")),
    ]
    for values in (log.q, log.dq, torque):
        template += bytes(-len(template) % 4) + struct.pack("<I", len(joints))
        # CDR aligns numbers to 8 bytes from behind its encapsulation header.
        template += bytes(-(len(template) - 4) % 8)
        fields.append((len(template), np.ascontiguousarray(values, dtype="<f8")))
        template += bytes(8 * len(joints))

    rows = np.tile(np.frombuffer(template, dtype=np.uint8), (len(stamps), 1))
    for offset, values in fields:
        end = offset + values.itemsize * values.shape[1]
        rows[:, offset:end] = values.view(np.uint8)
    return rows


def _string(text: str) -> bytes:
    """Return a string in CDR: its length with the closing zero, then its bytes."""
    data = text.encode("utf-8", "replace") + b"\0"
    return struct.pack("<I", len(data)) + data
