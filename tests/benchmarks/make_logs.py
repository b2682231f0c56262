"""Long logs for the measurements, with the bytes that the formats' own writers make."""

from itertools import product
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
from mcap.reader import make_reader
from mcap.writer import Writer
from numpy.typing import NDArray

from tests import Array
from tests.unit.logs import writers
from tests.unit.logs.format_writers import Data, mcap_foxglove_protobuf
from tests.unit.logs.writers import IMU, JOINT_STATE

JOINTS = tuple(f"panda_joint{i + 1}" for i in range(7))
N = len(JOINTS)
T0 = 1_700_000_000_000_000_000
PERIOD_NS = 1_000_000
CHUNK = 768 * 1024
PART = 20_000  # messages of a topic made at a time


def joint_values(count: int, rng: np.random.Generator) -> Array:
    """Position, velocity and effort (count, 21) of a motion with measurement noise."""
    t = np.arange(count)[:, None] * PERIOD_NS * 1e-9
    k = np.arange(N)
    q = np.sin((0.5 + 0.1 * k) * t + k)
    values = np.hstack([q, np.cos((0.5 + 0.1 * k) * t + k), 20.0 * q])
    return values + 1e-4 * rng.normal(size=values.shape)


def template(path: Path, message: writers.Message, encoding: str = "cdr") -> bytes:
    writers.write_messages(path, [message], encoding=encoding)  # type: ignore[arg-type]
    with path.open("rb") as file:
        ((_, _, written),) = make_reader(file).iter_messages()
    path.unlink()
    return bytes(written.data)


def write_cdr(path: Path, messages: int, compression: str = "zstd") -> Path:
    """Half JointState, half Imu, at 1 kHz with jittered arrival."""
    zero = np.zeros((1, N))
    at = np.array([T0])
    (joint,) = writers.joint_messages(at, JOINTS, zero, dq=zero, effort=zero)
    (imu,) = writers.imu_messages(at, "/hand/data", np.zeros((1, 3)))
    joint_form, imu_form = template(path, joint), template(path, imu)
    rng = np.random.default_rng(1)
    with path.open("wb") as out:
        writer = Writer(
            out, chunk_size=CHUNK, compression=writers.COMPRESSIONS[compression]
        )
        writer.start(profile="ros2")
        schemas = [
            writer.register_schema(kind, "ros2msg", writers.DEFINITIONS[kind].encode())
            for kind in (JOINT_STATE, IMU)
        ]
        joints = writer.register_channel("/joint_states", "cdr", schemas[0])
        hand = writer.register_channel("/hand/data", "cdr", schemas[1])
        for first in range(0, messages // 2, PART):
            count = min(PART, messages // 2 - first)
            stamps = T0 + PERIOD_NS * np.arange(first, first + count)
            rows, others = _patched(joint_form, stamps), _patched(imu_form, stamps)
            size = 8 * N
            for k, part in enumerate(np.split(joint_values(count, rng), 3, axis=1)):
                # Before each array comes its count, and padding.
                _put_doubles(
                    rows, len(joint_form) - 3 * size - 16 + k * (size + 8), part
                )
            turn = rng.normal(size=(count, 6))
            for at, part in zip((24, 12), np.split(turn, 2, axis=1), strict=True):
                _put_doubles(others, len(imu_form) - 8 * at, part)
            arrival = stamps[:, None] + rng.integers(0, PERIOD_NS // 2, (count, 2))
            for i in range(count):
                writer.add_message(
                    joints, int(arrival[i, 0]), rows[i].tobytes(), int(stamps[i])
                )
                writer.add_message(
                    hand, int(arrival[i, 1]), others[i].tobytes(), int(stamps[i])
                )
        writer.finish()  # type: ignore[no-untyped-call]
    return path


def _patched(form: bytes, stamps: NDArray[np.int64]) -> NDArray[np.uint8]:
    rows = np.tile(np.frombuffer(form, np.uint8), (len(stamps), 1))
    rows[:, 4:8] = (stamps // 10**9).astype("<i4").view(np.uint8).reshape(-1, 4)
    rows[:, 8:12] = (stamps % 10**9).astype("<u4").view(np.uint8).reshape(-1, 4)
    return rows


def _put_doubles(rows: NDArray[np.uint8], at: int, values: Array) -> None:
    content = np.ascontiguousarray(values).view(np.uint8)
    rows[:, at : at + content.shape[1]] = content


def write_json(path: Path, messages: int) -> Path:
    d = made(messages, 2)
    more = {"dq": d.dq, "effort": d.torque, "chunk_size": CHUNK}
    return writers.write_mcap(path, d.t, d.joints, d.q, encoding="json", **more)  # type: ignore[arg-type]


def write_protobuf(path: Path, messages: int) -> Path:
    """`foxglove.JointStates`, written by its own library."""
    return mcap_foxglove_protobuf(path, made(messages, 3), chunk_size=CHUNK)


def made(messages: int, seed: int) -> Data:
    """Samples of `messages` rows, the torque in place of the current."""
    q, dq, tau = np.split(
        joint_values(messages, np.random.default_rng(seed)), 3, axis=1
    )
    return Data(np.arange(messages) * PERIOD_NS * 1e-9, JOINTS, q, dq, tau, tau)


def write_columns(path: Path, rows: int) -> Path:
    """A table of 29 columns, 2 int64 and 27 float64, in row groups of 131,072."""
    rng, number = np.random.default_rng(4), np.arange(rows)
    columns = {"t": number * PERIOD_NS * 1e-9, "sequence": number, "status": 0 * number}
    values = joint_values(rows, rng)
    kinds = product(("position", "velocity", "current"), JOINTS)
    columns |= {f"{name}.{kind}": values[:, i] for i, (kind, name) in enumerate(kinds)}
    columns |= {f"other_{i}": rng.normal(size=rows) for i in range(5)}
    pq.write_table(pa.table(columns), path, compression="zstd", row_group_size=131_072)
    return path
