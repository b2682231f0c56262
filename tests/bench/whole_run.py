"""What identifying inertia costs: against a straightforward script, and memory against length."""

from __future__ import annotations

import json
import subprocess
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from statistics import median
from tempfile import TemporaryDirectory

from seqid_cli.robot.file import load_robot
from tests.bench.arm import write_arm, write_log
from tests.study.tables import table

COMPARED, LONGER, LONGEST = 200_000, 1_000_000, 3_000_000
ROUNDS = 2


@dataclass(frozen=True)
class Run:
    """One run of a case on a log of so many samples."""

    samples: int
    cpu_s: float
    peak: float  # MiB
    values: dict[str, tuple[float, float]]

    @property
    def us(self) -> float:
        """CPU time per sample."""
        return 1e6 * self.cpu_s / self.samples


def study(*, quick: bool = False) -> str:
    """Return the tables."""
    compared, longer, longest = (20_000, 30_000, 40_000) if quick else (COMPARED, LONGER, LONGEST)
    rounds = 1 if quick else ROUNDS
    with TemporaryDirectory() as name:
        folder = Path(name)
        arm = write_arm(folder)
        logs = {
            count: write_log(folder / f"{count}.parquet", load_robot(arm), count)
            for count in (compared, longer, longest)
        }
        ours = _runs("decimated", arm, logs[compared], compared, rounds)
        every = _runs("full_rate", arm, logs[compared], compared, rounds)
        naive = _runs("straightforward", arm, logs[compared], compared, 1)
        long = _runs("decimated", arm, logs[longer], longer, rounds)
        long_every = _runs("full_rate", arm, logs[longer], longer, 1)
        longest_run = _runs("decimated", arm, logs[longest], longest, 1)
    rows = [
        _row("script", naive, naive),
        _row("seqid, every sample", every, naive),
        _row("seqid, as the command runs it", ours, naive),
        _row("seqid, every sample", long_every, naive),
        _row("seqid, as the command runs it", long, naive),
        _row("seqid, as the command runs it", longest_run, naive),
    ]
    text = table(["run", "samples", "CPU us/sample", "script over this", "peak MiB"], rows)
    gap = _gap(naive[0], every[0])
    thinned = _gap(ours[0], every[0])
    ratio = _error_ratio(ours[0], every[0])
    return (
        f"{text}\n\n"
        f"The script and seqid with every sample differ by {gap:.1e} standard errors at most. "
        f"Thinning after the low-pass changes the parameters by {thinned:.1e} standard errors at "
        f"most and the standard errors by a factor of {ratio:.2f} (median)."
    )


def _runs(case: str, arm: Path, log: Path, samples: int, rounds: int) -> list[Run]:
    command = [sys.executable, "-m", "tests.bench.whole_run_cases", case, str(arm), str(log)]
    runs = []
    for _ in range(rounds):
        done = subprocess.run(command, capture_output=True, check=True, text=True)
        found = json.loads(done.stdout)
        runs.append(Run(samples, found["cpu_s"], found["peak"], found["values"]))
    return runs


def _row(name: str, runs: Sequence[Run], reference: Sequence[Run]) -> list[str]:
    us = median(run.us for run in runs)
    ratio = median(run.us for run in reference) / us
    peak = median(run.peak for run in runs)
    return [name, f"{runs[0].samples:,}", f"{us:.2f}", f"{ratio:.1f}", f"{peak:.0f}"]


def _gap(run: Run, reference: Run) -> float:
    """Largest difference of a parameter, in standard errors of the reference."""
    return max(
        abs(run.values[name][0] - value) / error
        for name, (value, error) in reference.values.items()
    )


def _error_ratio(run: Run, reference: Run) -> float:
    return median(run.values[name][1] / error for name, (_, error) in reference.values.items())
