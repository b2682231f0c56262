"""Measured, predicted and residual torque, with the motion behind it, as Parquet or MCAP.

MCAP is for Foxglove, PlotJuggler and rerun: topics of `sensor_msgs/msg/JointState` in
CDR, as ROS 2 records them. `effort` holds the torque (`low` and `high` the model's
bounds: at rest an interval, else the predicted value; `std` the standard deviation of
the prediction), `position` and `velocity` the motion, `header.frame_id` the name of the
log. A log without a clock, or one that would overlap the log before it, starts a second
after that log; the metadata record `seqid.logs` says where each log went. Every message
of one log has the same layout, so that messages are filled in as rows of bytes.
"""

import contextlib
import struct
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
from mcap.writer import CompressionType, Writer
from numpy.typing import NDArray

from seqid_cli import __version__
from seqid_cli.identify.prediction.predict import LogPrediction
from seqid_cli.params.files import replacing, writing
from seqid_cli.typing import Array

PARAMETERS = "seqid.parameters"  # of the metadata
# Columns of a joint and what they are of a `LogPrediction`; bounds are null where it
# slides.
_KINDS = ("predicted", "residual", "sliding", "std", "low", "high")
_TORQUES = {"torque": "tau", **{kind: kind for kind in _KINDS}}
_MOTION = {"position": "q", "velocity": "dq"}


@contextlib.contextmanager
def parquet_writer(
    path: Path, joints: Sequence[str], parameters: Sequence[str] = ()
) -> Iterator[Callable[[LogPrediction], None]]:
    """Write torques to `path` in one step; yields what appends a log, or a part of one."""
    # Columns: `t`, `log`, torques of each joint, `used` (whether the errors count the
    # sample), then position and velocity of each joint. The SHA-256 of the model's
    # files are metadata.
    kinds = {"t": pa.float64(), "log": pa.string()}
    kinds |= {f"{name}.{kind}": pa.float64() for name in joints for kind in _TORQUES}
    kinds |= {f"{name}.sliding": pa.bool_() for name in joints}
    kinds |= {"used": pa.bool_()}
    kinds |= {f"{name}.{kind}": pa.float64() for name in joints for kind in _MOTION}
    schema = pa.schema(
        kinds.items(), {PARAMETERS: " ".join(parameters)} if parameters else None
    )
    with replacing(path) as temporary:
        with writing(path):
            # Torques hardly repeat: a dictionary of them takes most of the time for
            # nothing.
            writer = pq.ParquetWriter(temporary, schema, use_dictionary=["log"])

        def write(log: LogPrediction, *, rows: int = 65536) -> None:
            with writing(path):
                writer.write_table(
                    pa.table(_columns(log), schema=schema), row_group_size=rows
                )

        yield write
        with writing(path):
            writer.close()


def _columns(log: LogPrediction) -> list[pa.Array]:
    torques = {kind: getattr(log, field) for kind, field in _TORQUES.items()}
    columns = [pa.array(log.t), pa.array([str(log.path)] * len(log.t), pa.string())]
    for j, slides in enumerate(log.sliding.T):
        for kind, values in torques.items():
            # Parquet has nulls for what is not known, and bounds where there are none.
            mask = np.isnan(values[:, j]) if kind == "std" else None
            if kind in ("low", "high"):
                mask = slides
            columns.append(pa.array(values[:, j], mask=mask))
    columns.append(pa.array(log.used))
    joints, motion = (
        range(len(log.sliding.T)),
        [getattr(log, field) for field in _MOTION.values()],
    )
    return columns + [
        pa.array(x[:, j], from_pandas=True) for j in joints for x in motion
    ]


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
    """Write torques to `path` in one step; yields what appends a log, or a part of one."""
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
    """Where each log goes on one time axis: `start` and `end` [s] of the last one."""

    def __init__(self) -> None:
        self.start, self.end = 0.0, -np.inf
        self.places: dict[str, str] = {}

    def stamps(
        self, log: LogPrediction, *, pause_s: float = 1.0, latest_s: float = 2.0**31
    ) -> NDArray[np.int64]:
        """Time stamps (N,) ns of a log's samples."""
        if log.part == 0:
            period = float(log.t[-1] - log.t[0]) / max(len(log.t) - 1, 1)
            usable = (
                self.end < log.start < latest_s - log.samples * period
                and log.start >= 0.0
            )
            self.start = log.start if usable else max(self.end + pause_s, 0.0)
        self.end = self.start + float(log.t[-1])
        if log.last:
            place = f"{log.path}: {self.start:.6f} to {self.end:.6f} s"
            self.places[f"{len(self.places) + 1}"] = place
        return round(self.start * 1e9) + np.round(log.t * 1e9).astype(np.int64)


def _messages(
    stamps: NDArray[np.int64], log: LogPrediction, joints: Sequence[str], torque: Array
) -> NDArray[np.uint8]:
    """Messages (N, bytes), all of one layout, of one topic, for its torque (N, n)."""
    # Encapsulation header, stamp (to be filled in), frame and joint names in CDR.
    message, places = (
        bytearray(b"\x00\x01\x00\x00" + bytes(8) + _string(str(log.path))),
        [],
    )
    message += bytes(-len(message) % 4) + struct.pack("<I", len(joints))
    for name in joints:
        message += bytes(-len(message) % 4) + _string(name)
    for values in (log.q, log.dq, torque):
        message += bytes(-len(message) % 4) + struct.pack("<I", len(joints))
        # from behind the encapsulation header
        message += bytes(-(len(message) - 4) % 8)
        places.append((len(message), np.ascontiguousarray(values, dtype="<f8")))
        message += bytes(8 * len(joints))
    rows = np.tile(np.frombuffer(message, dtype=np.uint8), (len(stamps), 1))
    seconds, nanoseconds = (
        part[:, None].astype("<u4") for part in np.divmod(stamps, 10**9)
    )
    for at, values in ((4, seconds), (8, nanoseconds), *places):
        rows[:, at : at + values.itemsize * values.shape[1]] = values.view(np.uint8)
    return rows


def _string(text: str) -> bytes:
    data = text.encode("utf-8", "replace") + b"\0"
    return struct.pack("<I", len(data)) + data
