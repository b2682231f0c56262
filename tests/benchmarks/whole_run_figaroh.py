"""The same arrays to FIGAROH and to seqid: regressor, base parameters, solution.

FIGAROH runs in an environment of its own, whose interpreter the variable SEQID_FIGAROH names:

    python -m venv figaroh && figaroh/bin/pip install figaroh==1.0.2
    SEQID_FIGAROH=figaroh/bin/python make bench

As a program, `python -m tests.benchmarks.whole_run_figaroh URDF ARRAYS` is seqid's side of it.
"""

import json
import os
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path
from statistics import median

import numpy as np

from seqid_cli.robot.file import load_robot
from seqid_cli.robot.regressor import inverse_dynamics
from tests.benchmarks import figaroh_case
from tests.benchmarks.measure import module, told_by
from tests.plants.robots.seven_joint import RATE_HZ, motion
from tests.studies.tables import table

INTERPRETER = "SEQID_FIGAROH"
SAMPLES = 100_000
NOISE = 0.05  # N m
ROWS = 2048  # samples that seqid works on at a time
LEFT_OUT = (
    "FIGAROH was not measured: `SEQID_FIGAROH` names no interpreter that has it "
    "(tests/benchmarks/whole_run_figaroh.py says how to make one)."
)
Result = dict[str, float]


def study(folder: Path, robot_path: Path, *, quick: bool, rounds: int) -> str:
    """Return the table, or why there is none."""
    other = os.environ.get(INTERPRETER, "")
    if not other or not _has_figaroh(other):
        return LEFT_OUT
    samples = SAMPLES // 20 if quick else SAMPLES
    arrays = write_arrays(folder / "arrays.npz", robot_path, samples)
    urdf = robot_path.with_name("arm.urdf")
    theirs: list[Result] = []
    ours: list[Result] = []
    for _ in range(rounds):
        theirs.append(told_by([other, figaroh_case.__file__, str(urdf), str(arrays)]))
        ours.append(told_by(module("whole_run_figaroh", robot_path, arrays)))
    rows = [_row("FIGAROH 1.0.2", theirs, theirs), _row("seqid", ours, theirs)]
    heads = ["", "CPU s", "times less", "peak MiB", "above its imports and the arrays, MiB"]
    gap = abs(ours[0]["rms"] / theirs[0]["rms"] - 1)
    text = table([*heads, "times less"], rows)
    return (
        f"The same {samples:,} samples of position, velocity, acceleration and torque in memory; "
        f"from them to base parameters:\n\n{text}\n\n"
        f"Both find {ours[0]['size']:.0f} base parameters; the RMS of what they leave differs by "
        f"{gap:.0e} of itself. seqid gives standard errors as well."
    )


def write_arrays(path: Path, robot_path: Path, samples: int) -> Path:
    """Write motion and noisy torque (N, 7) as arrays."""
    robot = load_robot(robot_path)
    assert robot.nominal is not None
    q, dq, ddq = motion(np.arange(samples) / RATE_HZ)
    tau = inverse_dynamics(robot.chain, robot.gravity, robot.nominal, q, dq, ddq)
    tau += NOISE * np.random.default_rng(7).normal(size=tau.shape)
    np.savez(path, q=q, dq=dq, ddq=ddq, tau=tau)
    return path


def _has_figaroh(interpreter: str) -> bool:
    command = [interpreter, "-c", "import figaroh"]
    try:
        return subprocess.run(command, capture_output=True, check=False).returncode == 0
    except OSError:
        return False


def _row(name: str, runs: Sequence[Result], reference: Sequence[Result]) -> list[str]:
    cpu, peak = (median(run[key] for run in runs) for key in ("cpu_s", "peak"))
    above, theirs = (median(run["peak"] - run["base"] for run in x) for x in (runs, reference))
    times = median(run["cpu_s"] for run in reference) / cpu
    less = theirs / max(above, 1.0)
    return [name, f"{cpu:.2f}", f"{times:.1f}", f"{peak:.0f}", f"{above:.0f}", f"{less:.0f}"]


def main(arguments: Sequence[str]) -> int:
    """Identify as the inertia stage does and print what it took."""
    from seqid_cli.identify.regression.least_squares import Accumulator, solve
    from seqid_cli.robot.base_parameters import base_regressor, free_basis

    robot = load_robot(Path(arguments[0]))
    with np.load(arguments[1]) as arrays:
        q, dq, ddq, tau = (arrays[name] for name in ("q", "dq", "ddq", "tau"))
    cpu, base = figaroh_case.usage()[0], figaroh_case.held_mib()
    basis = free_basis(robot)
    joints = [Accumulator(basis.size) for _ in range(robot.n)]
    room = np.zeros((robot.n, basis.size, ROWS))
    for start in range(0, len(q), ROWS):
        part = slice(start, min(start + ROWS, len(q)))
        out = room[:, :, : part.stop - start]
        H = base_regressor(robot, basis, q[part], dq[part], ddq[part], out=out)
        for j, joint in enumerate(joints):
            joint.add(H[:, j], tau[part, j])
    solution = solve(joints)
    rms = [joint.residual_rms(solution.theta) for joint in joints]
    after, peak = figaroh_case.usage()
    result = {
        "cpu_s": after - cpu,
        "peak": peak,
        "base": base,
        "size": basis.size,
        "rms": float(np.sqrt(np.mean(np.square(rms)))),
    }
    sys.stdout.write(json.dumps(result) + "\n")
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
