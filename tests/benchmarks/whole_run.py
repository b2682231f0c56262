"""What identifying inertia costs: against a script and FIGAROH, and memory against
length.

FIGAROH runs in an environment of its own, whose interpreter the variable SEQID_FIGAROH
names:

    python -m venv figaroh && figaroh/bin/pip install figaroh==1.0.2
    SEQID_FIGAROH=figaroh/bin/python make bench
"""

import os
import subprocess
from argparse import Namespace
from collections.abc import Sequence
from functools import partial
from pathlib import Path
from statistics import median
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np

from seqid_cli.robot.file import load_robot
from seqid_cli.robot.regressor import inverse_dynamics
from tests.benchmarks import figaroh_case
from tests.benchmarks.measure import Told, in_turns, middle, module, told_by
from tests.plants.robots.seven_joint import RATE_HZ, motion, write_arm, write_log
from tests.studies.tables import table

SAMPLES = 100_000
NOISE = 0.05  # N m
LEFT_OUT = (
    "FIGAROH was not measured: `SEQID_FIGAROH` names no interpreter that has it "
    "(tests/benchmarks/whole_run.py says how to make one)."
)
COMPARED, LONGER, LONGEST = 200_000, 1_000_000, 2_000_000
ROUNDS = 2
CASES = {
    "straightforward": "script",
    "full_rate": "seqid, every sample",
    "decimated": "seqid, as the command runs it",
}
# cpu_s, peak MiB, found: values and standard errors, samples
Runs = list[dict[str, Any]]


def study(chosen: Namespace) -> str:
    sizes = (20_000, 30_000, 40_000) if chosen.quick else (COMPARED, LONGER, LONGEST)
    rounds = 1 if chosen.quick else ROUNDS
    with TemporaryDirectory() as name:
        folder = Path(name)
        arm = write_arm(folder)
        runs = _all_runs(folder, arm, sizes, rounds)
        other = _against_figaroh(folder, arm, quick=chosen.quick, rounds=rounds)
    script, every, thinned = (runs[case, sizes[0]] for case in CASES)
    rows = [_row(CASES[case], found, script) for (case, _), found in runs.items()]
    text = table(
        ["run", "samples", "CPU us/sample", "script over this", "peak MiB"], rows
    )
    own, full = thinned[0]["found"], every[0]["found"]
    ratio = median(own[name][1] / error for name, (_, error) in full.items())
    gaps = _gaps(thinned[0], every[0])
    return (
        f"{text}\n\nThe script and seqid with every sample differ by"
        f" {max(_gaps(script[0], every[0])):.1e} standard errors at most. Thinning"
        f" after the low-pass changes the parameters by {max(gaps):.2f} standard errors"
        f" at most ({median(gaps):.2f} in the median) and the standard errors by a"
        f" factor of {ratio:.2f} (median).\n\n{other}"
    )


def _all_runs(
    folder: Path, arm: Path, sizes: tuple[int, int, int], rounds: int
) -> dict[tuple[str, int], Runs]:
    """Run every case on every length that it can bear, all of them in turns."""
    robot = load_robot(arm)
    logs = {
        count: write_log(folder / f"{count}.parquet", robot, count) for count in sizes
    }
    compared, longer, longest = sizes
    script, every, thinned = CASES

    def run(case: str, count: int) -> dict[str, Any]:
        return told_by(module("whole_run_cases", case, arm, logs[count])) | {
            "samples": count
        }

    # The script uses what seqid with every sample wrote beside the log.
    wanted = [(thinned, compared), (every, compared), (script, compared)]
    wanted += [(every, longer), (thinned, longer)]
    runs = dict(
        zip(wanted, in_turns([partial(run, *x) for x in wanted], rounds), strict=True)
    )
    runs |= {(case, longest): [run(case, longest)] for case in (every, thinned)}
    order = sorted(runs, key=lambda key: (key[1], list(CASES).index(key[0])))
    return {key: runs[key] for key in order}


def _row(name: str, runs: Runs, reference: Runs) -> list[str]:
    us, other = (1e6 * middle(x, "cpu_s") / x[0]["samples"] for x in (runs, reference))
    cells = [f"{us:.2f}", f"{other / us:.1f}", f"{middle(runs, 'peak'):.0f}"]
    return [name, f"{runs[0]['samples']:,}", *cells]


def _gaps(run: dict[str, Any], reference: dict[str, Any]) -> list[float]:
    """Differences of the parameters, in standard errors of the reference."""
    return [
        abs(run["found"][name][0] - value) / error
        for name, (value, error) in reference["found"].items()
    ]


def _against_figaroh(
    folder: Path, robot_path: Path, *, quick: bool, rounds: int
) -> str:
    """The same arrays to both: regressor, base parameters, solution; or why there is no
    table.
    """
    other = os.environ.get("SEQID_FIGAROH", "")
    has_it = [other, "-c", "import figaroh"]
    if not other or subprocess.run(has_it, capture_output=True, check=False).returncode:
        return LEFT_OUT
    samples = SAMPLES // 20 if quick else SAMPLES
    arrays, robot = folder / "arrays.npz", load_robot(robot_path)
    q, dq, ddq = motion(np.arange(samples) / RATE_HZ)
    tau = inverse_dynamics(robot.chain, robot.gravity, robot.nominal, q, dq, ddq)
    tau += NOISE * np.random.default_rng(7).normal(size=tau.shape)
    np.savez(arrays, q=q, dq=dq, ddq=ddq, tau=tau)
    program = [
        other,
        figaroh_case.__file__,
        str(robot_path.with_name("arm.urdf")),
        str(arrays),
    ]
    own = module("whole_run_cases", "arrays", robot_path, arrays)
    theirs, told = in_turns([lambda: told_by(program), lambda: told_by(own)], rounds)
    ours: Any = [run | run["found"] for run in told]
    rows = [_beside("FIGAROH 1.0.2", theirs, theirs), _beside("seqid", ours, theirs)]
    heads = [
        "",
        "CPU s",
        "times less",
        "peak MiB",
        "above its imports and the arrays, MiB",
    ]
    gap = abs(ours[0]["rms"] / theirs[0]["rms"] - 1)
    text = table([*heads, "times less"], rows)
    return (
        f"The same {samples:,} samples of position, velocity, acceleration and torque"
        f" in memory; from them to base parameters:\n\n{text}\n\nBoth find"
        f" {ours[0]['size']:.0f} base parameters; the RMS of what they leave differs by"
        f" {gap:.0e} of itself. seqid gives standard errors as well."
    )


def _beside(name: str, runs: Sequence[Told], reference: Sequence[Told]) -> list[str]:
    cpu, peak = middle(runs, "cpu_s"), middle(runs, "peak")
    above, theirs = (
        median(run["peak"] - run["base"] for run in x) for x in (runs, reference)
    )
    times, less = middle(reference, "cpu_s") / cpu, theirs / max(above, 1.0)
    return [
        name,
        f"{cpu:.2f}",
        f"{times:.1f}",
        f"{peak:.0f}",
        f"{above:.0f}",
        f"{less:.0f}",
    ]
