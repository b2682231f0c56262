"""What identifying inertia costs: against a straightforward script, and memory against length."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from statistics import median
from tempfile import TemporaryDirectory
from typing import Any

from seqid_cli.robot.file import load_robot
from tests.benchmarks import whole_run_figaroh
from tests.benchmarks.measure import module, told_by
from tests.plants.robots.seven_joint import write_arm, write_log
from tests.studies.tables import table

COMPARED, LONGER, LONGEST = 200_000, 1_000_000, 2_000_000
ROUNDS = 2
CASES = {
    "straightforward": "script",
    "full_rate": "seqid, every sample",
    "decimated": "seqid, as the command runs it",
}


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
    sizes = (20_000, 30_000, 40_000) if quick else (COMPARED, LONGER, LONGEST)
    rounds = 1 if quick else ROUNDS
    with TemporaryDirectory() as name:
        folder = Path(name)
        arm = write_arm(folder)
        runs = _all_runs(folder, arm, sizes, rounds)
        other = whole_run_figaroh.study(folder, arm, quick=quick, rounds=rounds)
    script, every, thinned = (runs[case, sizes[0]] for case in CASES)
    rows = [_row(CASES[case], found, script) for (case, _), found in runs.items()]
    text = table(["run", "samples", "CPU us/sample", "script over this", "peak MiB"], rows)
    ratio = _error_ratio(thinned[0], every[0])
    gaps = _gaps(thinned[0], every[0])
    return (
        f"{text}\n\n"
        f"The script and seqid with every sample differ by "
        f"{max(_gaps(script[0], every[0])):.1e} standard errors at most. Thinning after the "
        f"low-pass changes the parameters by {max(gaps):.2f} standard errors at most "
        f"({median(gaps):.2f} in the median) and the standard errors by a factor of {ratio:.2f} "
        f"(median).\n\n{other}"
    )


def _all_runs(
    folder: Path, arm: Path, sizes: tuple[int, int, int], rounds: int
) -> dict[tuple[str, int], list[Run]]:
    """Run every case on every length that it can bear, all of them in turns."""
    robot = load_robot(arm)
    logs = {count: write_log(folder / f"{count}.parquet", robot, count) for count in sizes}
    compared, longer, longest = sizes
    script, every, thinned = CASES
    # The script uses what seqid with every sample wrote beside the log.
    wanted = [(thinned, compared), (every, compared), (script, compared)]
    wanted += [(every, longer), (thinned, longer)]
    runs: dict[tuple[str, int], list[Run]] = {}
    for _ in range(rounds):
        for case, count in wanted:
            runs.setdefault((case, count), []).append(_run(case, arm, logs[count], count))
    for case in (every, thinned):
        runs[case, longest] = [_run(case, arm, logs[longest], longest)]
    order = sorted(runs, key=lambda key: (key[1], list(CASES).index(key[0])))
    return {key: runs[key] for key in order}


def _run(case: str, arm: Path, log: Path, samples: int) -> Run:
    found: dict[str, Any] = told_by(module("whole_run_cases", case, arm, log))
    return Run(samples, found["cpu_s"], found["peak"], found["values"])


def _row(name: str, runs: Sequence[Run], reference: Sequence[Run]) -> list[str]:
    us = median(run.us for run in runs)
    ratio = median(run.us for run in reference) / us
    peak = median(run.peak for run in runs)
    return [name, f"{runs[0].samples:,}", f"{us:.2f}", f"{ratio:.1f}", f"{peak:.0f}"]


def _gaps(run: Run, reference: Run) -> list[float]:
    """Differences of the parameters, in standard errors of the reference."""
    return [
        abs(run.values[name][0] - value) / error
        for name, (value, error) in reference.values.items()
    ]


def _error_ratio(run: Run, reference: Run) -> float:
    return median(run.values[name][1] / error for name, (_, error) in reference.values.items())
