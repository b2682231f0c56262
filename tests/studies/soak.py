"""Two hours of log in one go, with little memory and few files: `python -m
tests.studies.soak`.
"""

import argparse
import os
import resource
import subprocess
import sys
import tempfile
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

from tests import ROOT
from tests.studies.tables import show, table

SAMPLE = ROOT / "sample_logs" / "one_joint"
TRIAL = SAMPLE / "inertia" / "joint_1.parquet"
PAUSE_S, NOISE = 1.0, 0.01  # between two trials; of a channel's standard deviation
HEADER = ("command", "within 1 GiB", "exit code", "peak, MiB", "CPU, s")


def write_log(path: Path, hours: float) -> int:
    """Write a log of some hours; returns its rows."""
    trial, rng, begun, rows = pq.read_table(TRIAL), np.random.default_rng(0), 0.0, 0
    names = ("t", "joint_1.current")
    t, current = (trial.column(name).to_numpy() for name in names)
    with pq.ParquetWriter(path, trial.schema) as writer:
        while begun < hours * 3600.0:
            noise, block = NOISE * current.std() * rng.standard_normal(len(t)), trial
            for name, values in zip(
                names, (t - t[0] + begun, current + noise), strict=True
            ):
                block = block.set_column(
                    block.schema.names.index(name), name, pa.array(values)
                )
            writer.write_table(block)
            begun, rows = begun + float(t[-1] - t[0]) + PAUSE_S, rows + len(t)
    return rows


def lines(log: Path) -> Iterator[tuple[str, ...]]:
    out, given = log.parent, (str(log), "-r", str(SAMPLE / "robot.toml"))
    model = (*given, "-p", str(SAMPLE / "golden.json"))
    encoder = (*model, "--motion", "encoder")
    yield "inspect", *given
    yield "inertia", *encoder, "-o", str(out / "inertia.json")
    yield (
        "predict",
        *encoder,
        "-o",
        str(out / "p.json"),
        "--torques",
        str(out / "t.parquet"),
    )
    yield "diagnose", *model, "-o", str(out / "d.json")


def measured(line: Sequence[str]) -> tuple[str, ...]:
    code, said, peak, cpu = _run(line, _limit)
    enough = "too little memory" not in said
    if not enough:
        code, said, peak, cpu = _run(line, None)
    sys.stderr.write(f"{line[0]}: {enough}, {code}: {said[-300:]}\n")
    return line[0], "yes" if enough else "says no", str(code), str(peak), f"{cpu:.0f}"


def _limit() -> None:
    resource.setrlimit(resource.RLIMIT_AS, (1 << 30, 1 << 30))
    resource.setrlimit(resource.RLIMIT_NOFILE, (64, 64))


def _run(
    line: Sequence[str], limit: Callable[[], None] | None
) -> tuple[int, str, int, float]:
    """Exit code, messages, peak memory [MiB] and CPU time [s] of a command."""
    with tempfile.TemporaryFile() as messages:
        process = subprocess.Popen(
            [sys.executable, "-m", "seqid_cli", *line],
            preexec_fn=limit,
            env={**os.environ, "PYTHONPATH": str(ROOT)},
            stdout=subprocess.DEVNULL,
            stderr=messages,
        )
        _, status, used = os.wait4(process.pid, 0)
        messages.seek(0)
        said = messages.read().decode(errors="replace")
    code = os.waitstatus_to_exitcode(status)
    return code, said, used.ru_maxrss >> 10, used.ru_utime + used.ru_stime


def main() -> int:
    parser = argparse.ArgumentParser(
        prog="python -m tests.studies.soak", description=__doc__
    )
    parser.add_argument("--hours", type=float, default=2.0)
    parser.add_argument(
        "--write",
        action="store_true",
        help="put the table into docs/evidence/damage.md",
    )
    chosen = parser.parse_args()
    with tempfile.TemporaryDirectory() as work:
        log = Path(work) / "long.parquet"
        sys.stderr.write(
            f"{write_log(log, chosen.hours)} rows, {log.stat().st_size >> 20} MiB\n"
        )
        cells = [measured(line) for line in lines(log)]
    show("evidence/damage.md", "soak", table(HEADER, cells), kept=chosen.write)
    return 1 if {code for _, _, code, *_ in cells} - {"0", "1"} else 0


if __name__ == "__main__":
    sys.exit(main())
