"""What reading a log costs: CPU time against the usual readers, and memory against
length.
"""

from argparse import Namespace
from collections.abc import Sequence
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory

from tests.benchmarks.make_logs import (
    write_cdr,
    write_columns,
    write_json,
    write_protobuf,
)
from tests.benchmarks.measure import Told, in_turns, middle, module, told_by
from tests.studies.tables import table

ROUNDS = 3
# row's name, case, file, count, row to compare with
Subject = tuple[str, str, Path, int, int]


def study(chosen: Namespace) -> str:
    size, rounds = (20_000, 1) if chosen.quick else (1_000_000, ROUNDS)
    with TemporaryDirectory() as name:
        folder = Path(name)
        few, some, half = size // 10, size // 4, size // 2
        long, short = (
            write_cdr(folder / "long.mcap", size),
            write_cdr(folder / "short.mcap", few),
        )
        text = write_json(folder / "json.mcap", some)
        protobuf = write_protobuf(folder / "protobuf.mcap", some)
        columns = write_columns(folder / "table.parquet", half)
        fewer = write_columns(folder / "short.parquet", half // 2)
        cdr: list[Subject] = [
            ("read and unpack only", "decompress", long, size, 1),
            ("seqid, by blocks", "seqid_blocks", long, size, 1),
            ("seqid, whole log", "seqid", long, size, 1),
            ("rosbags AnyReader", "rosbags", short, few, 1),
            ("mcap + mcap-ros2-support", "mcap_ros2", short, few, 1),
            ("seqid, by blocks", "seqid_blocks", short, few, 1),
            ("seqid, whole log", "seqid", short, few, 1),
        ]
        others: list[Subject] = [
            ("JSON: seqid, by blocks", "seqid_blocks", text, some, 0),
            ("JSON: mcap + json.loads", "json_loads", text, some, 0),
            ("protobuf: seqid, by blocks", "seqid_blocks", protobuf, some, 2),
            (
                "protobuf: mcap + mcap-protobuf-support",
                "mcap_protobuf",
                protobuf,
                some,
                2,
            ),
        ]
        tables: list[Subject] = [
            ("seqid, by blocks", "parquet_blocks", columns, half, 0),
            ("pyarrow iter_batches", "iter_batches", columns, half, 0),
            ("seqid, by blocks", "parquet_blocks", fewer, half // 2, 0),
        ]
        parts = {
            "JointState (7 joints) and Imu as CDR, zstd, chunks of 768 KiB": cdr,
            "JointState as JSON, foxglove.JointStates as protobuf (7 joints, zstd)": (
                others
            ),
            "Parquet, 14 of 29 columns, zstd, row groups of 131,072": tables,
        }
        return "\n\n".join(_compared(*part, rounds) for part in parts.items())


def _told(case: str, path: Path, count: int) -> Told:
    result = told_by(module("ingestion_cases", case, path))
    if case != "decompress" and result["found"] != count:
        raise RuntimeError(f"{case} read {result['found']} of {count}")
    return {"us": 1e6 * result["cpu_s"] / count, "peak": result["peak"]}


def _compared(title: str, subjects: Sequence[Subject], rounds: int) -> str:
    unit = "row" if title.startswith("Parquet") else "message"
    jobs = [partial(_told, case, path, count) for _, case, path, count, _ in subjects]
    found = in_turns(jobs, rounds)
    rows = []
    for (name, _, _, count, other), own in zip(subjects, found, strict=True):
        us, than = middle(own, "us"), middle(found[other], "us")
        peak = f"{middle(own, 'peak'):.0f}"
        rows.append([name, f"{count:,}", f"{us:.2f}", f"{us / than:.2f}", peak])
    header = ["reader", f"{unit}s", f"CPU us/{unit}", "times blocks", "peak MiB"]
    return f"{title}:\n\n{table(header, rows)}"
