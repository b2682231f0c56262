"""What reading a log costs: CPU time against the usual readers, and memory against length.

Every measurement is a process of its own; the cases of a comparison take turns, so that all of
them meet the same machine. CPU time is user and system time without imports, the median of the
rounds; peak memory is that of the whole process.
"""

from dataclasses import dataclass
from pathlib import Path
from statistics import median
from tempfile import TemporaryDirectory

from tests.benchmarks.make_logs import write_cdr, write_columns, write_json, write_protobuf
from tests.benchmarks.measure import module, told_by
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
            result = told_by(module("ingestion_cases", subject.case, subject.path))
            if subject.case != "decompress" and result["count"] != subject.count:
                raise RuntimeError(f"{subject.case} read {result['count']} of {subject.count}")
            results.append(result)
    return [
        Measured(
            1e6 * median(run["cpu_s"] for run in results) / subject.count,
            median(run["peak"] for run in results),
        )
        for results, subject in zip(runs, subjects, strict=True)
    ]


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


HEADER = ["reader", "messages", "CPU us/message", "times blocks", "peak MiB"]
Comparison = list[tuple[str, Subject, int]]  # its row's name, and the row that it is compared with


def _compared(title: str, header: list[str], subjects: Comparison, rounds: int) -> str:
    found = measure([subject for _, subject, _ in subjects], rounds)
    rows = []
    for (name, subject, other), own in zip(subjects, found, strict=True):
        ratio = own.us / found[other].us
        cells = [f"{subject.count:,}", f"{own.us:.2f}", f"{ratio:.2f}", f"{own.peak:.0f}"]
        rows.append([name, *cells])
    return f"{title}:\n\n{table(header, rows)}"


def _cdr(folder: Path, size: int, rounds: int) -> str:
    few = size // 10
    long, short = write_cdr(folder / "long.mcap", size), write_cdr(folder / "short.mcap", few)
    subjects = [
        ("read and unpack only", Subject("decompress", long, size), 1),
        ("seqid, by blocks", Subject("seqid_blocks", long, size), 1),
        ("seqid, whole log", Subject("seqid", long, size), 1),
        ("rosbags AnyReader", Subject("rosbags", short, few), 1),
        ("mcap + mcap-ros2-support", Subject("mcap_ros2", short, few), 1),
        ("seqid, by blocks", Subject("seqid_blocks", short, few), 1),
        ("seqid, whole log", Subject("seqid", short, few), 1),
    ]
    title = "JointState (7 joints) and Imu as CDR, zstd, chunks of 768 KiB"
    return _compared(title, HEADER, subjects, rounds)


def _others(folder: Path, size: int, rounds: int) -> str:
    text = write_json(folder / "json.mcap", size)
    protobuf = write_protobuf(folder / "protobuf.mcap", size)
    subjects = [
        ("JSON: seqid, by blocks", Subject("seqid_blocks", text, size), 0),
        ("JSON: mcap + json.loads", Subject("json_loads", text, size), 0),
        ("protobuf: seqid, by blocks", Subject("seqid_blocks", protobuf, size), 2),
        ("protobuf: mcap + mcap-protobuf-support", Subject("mcap_protobuf", protobuf, size), 2),
    ]
    title = "JointState as JSON, foxglove.JointStates as protobuf (7 joints, zstd)"
    return _compared(title, HEADER, subjects, rounds)


def _parquet(folder: Path, size: int, rounds: int) -> str:
    path = write_columns(folder / "table.parquet", size)
    short = write_columns(folder / "short.parquet", size // 2)
    subjects = [
        ("seqid, by blocks", Subject("parquet_blocks", path, size), 0),
        ("pyarrow iter_batches", Subject("iter_batches", path, size), 0),
        ("seqid, by blocks", Subject("parquet_blocks", short, size // 2), 0),
    ]
    title = "Parquet, 14 of 29 columns, zstd, row groups of 131,072"
    header = ["reader", "rows", "CPU us/row", "times blocks", "peak MiB"]
    return _compared(title, header, subjects, rounds)
