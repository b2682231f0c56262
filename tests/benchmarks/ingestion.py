"""What reading a log costs: CPU time against the usual readers, and memory against length.

Every measurement is a process of its own; the cases of a comparison take turns, so that all of
them meet the same machine. CPU time is user and system time without imports, the median of the
rounds; peak memory is that of the whole process.
"""

from __future__ import annotations

import json
import subprocess
import sys
from dataclasses import dataclass
from pathlib import Path
from statistics import median
from tempfile import TemporaryDirectory

from tests.benchmarks.make_logs import write_cdr, write_columns, write_json, write_protobuf
from tests.studies.tables import table

ROUNDS = 3


@dataclass(frozen=True)
class Measured:
    """Medians of one case."""

    us: float  # CPU per message or row
    peak: float  # MiB


@dataclass(frozen=True)
class Subject:
    """A case on a file of so many messages or rows."""

    case: str
    path: Path
    count: int


def measure(subjects: list[Subject], rounds: int) -> list[Measured]:
    """Measure the subjects in turn."""
    runs: list[list[dict[str, float]]] = [[] for _ in subjects]
    for _ in range(rounds):
        for results, subject in zip(runs, subjects, strict=True):
            results.append(_run(subject))
    return [
        Measured(
            1e6 * median(run["cpu_s"] for run in results) / subject.count,
            median(run["peak"] for run in results),
        )
        for results, subject in zip(runs, subjects, strict=True)
    ]


def _run(subject: Subject) -> dict[str, float]:
    command = [
        sys.executable,
        "-m",
        "tests.benchmarks.ingestion_cases",
        subject.case,
        str(subject.path),
    ]
    done = subprocess.run(command, capture_output=True, check=True, text=True)
    result: dict[str, float] = json.loads(done.stdout)
    if subject.case != "decompress" and result["count"] != subject.count:
        raise RuntimeError(f"{subject.case} read {result['count']} of {subject.count}")
    return result


def study(*, quick: bool = False) -> str:
    """Return the tables."""
    size, rounds = (20_000, 1) if quick else (1_000_000, ROUNDS)
    with TemporaryDirectory() as name:
        folder = Path(name)
        return "\n\n".join(
            [
                _cdr(folder, size, rounds),
                _others(folder, size // 4, rounds),
                _parquet(folder, size // 2, rounds),
            ]
        )


def _cdr(folder: Path, size: int, rounds: int) -> str:
    long = write_cdr(folder / "long.mcap", size)
    short = write_cdr(folder / "short.mcap", size // 10)
    subjects = [
        Subject("decompress", long, size),
        Subject("seqid_blocks", long, size),
        Subject("seqid", long, size),
        Subject("rosbags", short, size // 10),
        Subject("mcap_ros2", short, size // 10),
        Subject("seqid_blocks", short, size // 10),
        Subject("seqid", short, size // 10),
    ]
    unpacked, blocks, whole, bags, official, short_blocks, short_whole = measure(subjects, rounds)
    rows = [
        ["read and unpack only", *_cells(unpacked, blocks, size)],
        ["seqid, by blocks", *_cells(blocks, blocks, size)],
        ["seqid, whole log", *_cells(whole, blocks, size)],
        ["rosbags AnyReader", *_cells(bags, blocks, size // 10)],
        ["mcap + mcap-ros2-support", *_cells(official, blocks, size // 10)],
        ["seqid, by blocks", *_cells(short_blocks, blocks, size // 10)],
        ["seqid, whole log", *_cells(short_whole, blocks, size // 10)],
    ]
    return "JointState (7 joints) and Imu as CDR, zstd, chunks of 768 KiB:\n\n" + table(
        ["reader", "messages", "CPU us/message", "times blocks", "peak MiB"], rows
    )


def _others(folder: Path, size: int, rounds: int) -> str:
    text = write_json(folder / "json.mcap", size)
    protobuf = write_protobuf(folder / "protobuf.mcap", size)
    subjects = [
        Subject("seqid_blocks", text, size),
        Subject("json_loads", text, size),
        Subject("seqid_blocks", protobuf, size),
        Subject("mcap_protobuf", protobuf, size),
    ]
    ours, loads, ours_too, official = measure(subjects, rounds)
    rows = [
        ["JSON: seqid, by blocks", *_cells(ours, ours, size)],
        ["JSON: mcap + json.loads", *_cells(loads, ours, size)],
        ["protobuf: seqid, by blocks", *_cells(ours_too, ours_too, size)],
        ["protobuf: mcap + mcap-protobuf-support", *_cells(official, ours_too, size)],
    ]
    return "JointState as JSON, foxglove.JointStates as protobuf (7 joints, zstd):\n\n" + table(
        ["reader", "messages", "CPU us/message", "times blocks", "peak MiB"], rows
    )


def _parquet(folder: Path, size: int, rounds: int) -> str:
    path = write_columns(folder / "table.parquet", size)
    short = write_columns(folder / "short.parquet", size // 2)
    subjects = [
        Subject("parquet_blocks", path, size),
        Subject("iter_batches", path, size),
        Subject("parquet_blocks", short, size // 2),
    ]
    ours, theirs, half = measure(subjects, rounds)
    rows = [
        ["seqid, by blocks", *_cells(ours, ours, size)],
        ["pyarrow iter_batches", *_cells(theirs, ours, size)],
        ["seqid, by blocks", *_cells(half, ours, size // 2)],
    ]
    return "Parquet, 14 of 29 columns, zstd, row groups of 131,072:\n\n" + table(
        ["reader", "rows", "CPU us/row", "times blocks", "peak MiB"], rows
    )


def _cells(measured: Measured, reference: Measured, count: int) -> list[str]:
    ratio = measured.us / reference.us
    return [f"{count:,}", f"{measured.us:.2f}", f"{ratio:.2f}", f"{measured.peak:.0f}"]
