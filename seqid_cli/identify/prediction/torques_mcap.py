"""Measured, predicted and residual torque as MCAP, for Foxglove, PlotJuggler and rerun.

Topics of `sensor_msgs/msg/JointState` in CDR, as ROS 2 records them: `effort` holds the torque
(`low` and `high` the model's bounds: at rest an interval, else the predicted value), `position`
and `velocity` the motion behind the prediction, `header.frame_id` the name of the log. A log
without a clock, or one that would overlap the log before it, starts a second after that log; the
metadata record `seqid.logs` says where each log went.

Every message of one log has the same layout, so that messages are filled in as rows of bytes.
"""

import contextlib
import struct
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from mcap.writer import CompressionType, Writer
from numpy.typing import NDArray

from seqid_cli import __version__
from seqid_cli.params.files import replacing, writing
from seqid_cli.typing import Array

if TYPE_CHECKING:
    from seqid_cli.identify.prediction.predict import LogPrediction


TOPICS = ("/seqid/measured", "/seqid/predicted", "/seqid/residual", "/seqid/low", "/seqid/high")
JOINT_STATE = "sensor_msgs/msg/JointState"
_RULE = "=" * 80
_DEFINITION = (
    "std_msgs/Header header\nstring[] name\nfloat64[] position\nfloat64[] velocity\n"
    f"float64[] effort\n{_RULE}\nMSG: std_msgs/Header\nbuiltin_interfaces/Time stamp\n"
    f"string frame_id\n{_RULE}\nMSG: builtin_interfaces/Time\nint32 sec\nuint32 nanosec\n"
)


class McapTorqueWriter:
    """Writes the torques of logs, one after the other."""

    def __init__(self, path: Path, writer: Writer, joints: Sequence[str]) -> None:
        self._path = path
        self._writer = writer
        self._joints = tuple(joints)
        self._start, self._end = 0.0, -np.inf  # of the log that is being written
        self._count = 0  # of its messages on each topic
        self._places: dict[str, str] = {}
        schema = writer.register_schema(JOINT_STATE, "ros2msg", _DEFINITION.encode())
        self._channels = [writer.register_channel(topic, "cdr", schema) for topic in TOPICS]

    @classmethod
    @contextlib.contextmanager
    def open(cls, path: Path, joints: Sequence[str]) -> "Iterator[McapTorqueWriter]":
        """Write to `path` in one step: an interrupted run leaves the old file or none."""
        with replacing(path) as temporary:
            with writing(path):
                stream = temporary.open("wb")
            with stream:
                with writing(path):
                    writer = Writer(stream, compression=CompressionType.ZSTD)
                    writer.start(profile="ros2", library=f"seqid {__version__}")
                torques = cls(path, writer, joints)
                yield torques
                with writing(path):
                    writer.add_metadata("seqid.logs", torques._places)
                    writer.finish()  # type: ignore[no-untyped-call]

    def write(self, log: "LogPrediction") -> None:
        """Append a log, or the next part of one, all its samples."""
        stamps = self._stamps(log)
        tables = [
            _messages(stamps, str(log.path), self._joints, log.q, log.dq, torque)
            for torque in (log.tau, log.predicted, log.residual, log.low, log.high)
        ]
        with writing(self._path):
            for k, stamp in enumerate(stamps.tolist()):
                for channel, table in zip(self._channels, tables, strict=True):
                    self._writer.add_message(
                        channel, stamp, table[k].tobytes(), stamp, self._count + k
                    )
        self._count += len(stamps)

    def _stamps(
        self, log: "LogPrediction", *, pause_s: float = 1.0, latest_s: float = 2.0**31
    ) -> NDArray[np.int64]:
        """Time stamps (N,) ns of a log's samples."""
        if log.part == 0:
            period = float(log.t[-1] - log.t[0]) / max(len(log.t) - 1, 1)
            usable = 0.0 <= log.start < latest_s - log.samples * period
            after = self._end + pause_s if np.isfinite(self._end) else 0.0
            self._start = log.start if usable and log.start > self._end else after
            self._count = 0
        self._end = self._start + float(log.t[-1])
        if log.last:
            place = f"{log.path}: {self._start:.6f} to {self._end:.6f} s"
            self._places[f"{len(self._places) + 1}"] = place
        return round(self._start * 1e9) + np.round(log.t * 1e9).astype(np.int64)


def _messages(
    stamps: NDArray[np.int64],
    frame: str,
    joints: Sequence[str],
    q: Array,
    dq: Array,
    torque: Array,
) -> NDArray[np.uint8]:
    """Return the messages (N, bytes) of one topic; arrays are (N, n)."""
    # Encapsulation header, stamp (to be filled in), frame and joint names in CDR.
    message, places = bytearray(b"\x00\x01\x00\x00" + bytes(8) + _string(frame)), []
    message += bytes(-len(message) % 4) + struct.pack("<I", len(joints))
    for name in joints:
        message += bytes(-len(message) % 4) + _string(name)
    for values in (q, dq, torque):
        message += bytes(-len(message) % 4) + struct.pack("<I", len(joints))
        message += bytes(-(len(message) - 4) % 8)  # from behind the encapsulation header
        places.append((len(message), values))
        message += bytes(8 * len(joints))
    rows = np.tile(np.frombuffer(message, dtype=np.uint8), (len(stamps), 1))
    rows[:, 4:8] = _bytes((stamps // 10**9).astype("<i4")[:, None])
    rows[:, 8:12] = _bytes((stamps % 10**9).astype("<u4")[:, None])
    for at, values in places:
        rows[:, at : at + 8 * values.shape[1]] = _bytes(values.astype("<f8"))
    return rows


def _string(text: str) -> bytes:
    data = text.encode("utf-8", "replace") + b"\0"
    return struct.pack("<I", len(data)) + data


def _bytes(values: NDArray[np.generic]) -> NDArray[np.uint8]:
    """Return the bytes (N, k) of values (N, ...) in memory order."""
    return np.ascontiguousarray(values).view(np.uint8)
