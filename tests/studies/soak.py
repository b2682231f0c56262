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
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

from tests import ROOT
from tests.studies.tables import show, table

SAMPLE = ROOT / "sample_logs" / "one_joint"
TRIAL = SAMPLE / "inertia" / "joint_1.parquet"
# The stages that the other trials are of.
STAGE_TRIALS = {
    "friction": SAMPLE / "friction" / "joint_1.parquet",
    "gravity": SAMPLE / "gravity" / "joint_1.parquet",
}
PAUSE_S, NOISE = 1.0, 0.01  # between two trials; of a channel's standard deviation
HEADER = ("command", "within 1 GiB", "exit code", "peak, MiB", "CPU, s")


def with_imus(trial: pa.Table) -> pa.Table:
    """Return a trial with readings of IMUs, of another motion where it has none.

    Stages that read no IMU pass over columns as wide as those of the others.
    """
    others = pq.read_table(TRIAL)
    for name in others.column_names:
        if name not in trial.column_names:
            readings = np.resize(others.column(name).to_numpy(), len(trial))
            trial = trial.append_column(name, pa.array(readings))
    return trial


def write_log(path: Path, hours: float, source: Path = TRIAL) -> int:
    """Write a log of some hours, of a trial again and again; returns its rows."""
    trial, rng = with_imus(pq.read_table(source)), np.random.default_rng(0)
    begun, rows = 0.0, 0
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


def lines(folder: Path) -> Iterator[tuple[str, ...]]:
    """Yield what runs on the logs in a folder, each named after its trial."""
    robot = ("-r", str(SAMPLE / "robot.toml"))
    model = (*robot, "-p", str(SAMPLE / "golden.json"))
    motion = str(folder / "motion.parquet")
    out = str(folder / "out.json")

    yield "inspect", motion, *robot
    friction = str(folder / "friction.json")
    yield "friction", str(folder / "friction.parquet"), *robot, "-o", friction
    yield "gravity", str(folder / "gravity.parquet"), *robot, "-p", friction, "-o", out
    yield "diagnose", motion, *model, "-o", out
    torques = ("--torques", str(folder / "torques.parquet"))
    for source in ("encoder", "auto"):
        words = (motion, *model, "--motion", source, "-o", out)
        yield "inertia", *words
        yield "predict", *words, *torques


@dataclass(frozen=True, kw_only=True)
class Ran:
    """What a command said and took."""

    code: int
    said: str
    peak_mib: int
    cpu_s: float


def measured(line: Sequence[str]) -> tuple[str, ...]:
    """Run a command with little memory; with all of it, where that is too little."""
    ran = run_command(line, _limit)
    is_enough = "too little memory" not in ran.said
    if not is_enough:
        ran = run_command(line)
    label = line[0]
    if "--motion" in line:
        label += f" --motion {line[line.index('--motion') + 1]}"
    enough = "yes" if is_enough else "says no"
    sys.stderr.write(f"{label}: {enough}, {ran.code}: {ran.said[-300:]}\n")
    return label, enough, str(ran.code), str(ran.peak_mib), f"{ran.cpu_s:.0f}"


def _limit() -> None:
    resource.setrlimit(resource.RLIMIT_AS, (1 << 30, 1 << 30))
    resource.setrlimit(resource.RLIMIT_NOFILE, (64, 64))


def run_command(line: Sequence[str], limit: Callable[[], None] | None = None) -> Ran:
    """Run a command in a process of its own, which `limit` may limit."""
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
    return Ran(
        code=os.waitstatus_to_exitcode(status),
        said=said,
        peak_mib=used.ru_maxrss >> 10,
        cpu_s=used.ru_utime + used.ru_stime,
    )


def main() -> int:
    parser = argparse.ArgumentParser(
        prog="python -m tests.studies.soak", description=__doc__
    )
    parser.add_argument("--hours", type=float, default=2.0)
    parser.add_argument("--only", default="", help="a command")
    parser.add_argument(
        "--write",
        action="store_true",
        help="put the table into docs/evidence/damage.md",
    )
    chosen = parser.parse_args()
    with tempfile.TemporaryDirectory() as work:
        for name, trial in {**STAGE_TRIALS, "motion": TRIAL}.items():
            log = Path(work) / f"{name}.parquet"
            rows = write_log(log, chosen.hours, trial)
            size_mib = log.stat().st_size >> 20
            sys.stderr.write(f"{name}: {rows} rows, {size_mib} MiB\n")
        of_name = [line for line in lines(Path(work)) if chosen.only in line[0]]
        cells = [measured(line) for line in of_name]
    show("evidence/damage.md", "soak", table(HEADER, cells), kept=chosen.write)
    return 1 if {code for _, _, code, *_ in cells} - {"0", "1"} else 0


if __name__ == "__main__":
    sys.exit(main())
