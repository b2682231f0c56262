"""What the numerical kernels cost against the library calls that one would use
instead.
"""

import time
from argparse import Namespace
from collections.abc import Callable
from functools import partial
from pathlib import Path
from statistics import median
from tempfile import TemporaryDirectory

import numpy as np
import pinocchio as pin

from seqid_cli.identify.regression.least_squares import Accumulator, triangular
from seqid_cli.imu.smoother.smooth import smoothed_motion
from seqid_cli.robot.base_parameters import base_regressor, free_basis
from seqid_cli.robot.file import load_robot
from seqid_cli.robot.regressor import torque_regressor
from tests import Array
from tests.benchmarks.measure import in_turns
from tests.plants.fused import Rig, case
from tests.plants.robots.seven_joint import write_arm
from tests.studies.tables import table

Job = Callable[[], object]


def study(chosen: Namespace) -> str:
    rounds = 1 if chosen.quick else 9
    rows = [*_regressor(rounds), *_least_squares(rounds, quick=chosen.quick)]
    return table(["", "CPU", "unit", "faster", "largest difference"], rows)


def _spent(job: Job) -> float:
    before = time.process_time()
    job()
    return time.process_time() - before


def _cpu(jobs: list[Job], rounds: int) -> list[float]:
    return [
        median(own) for own in in_turns([partial(_spent, job) for job in jobs], rounds)
    ]


def _regressor(rounds: int) -> list[list[str]]:
    rng = np.random.default_rng(1)
    with TemporaryDirectory() as name:
        robot = load_robot(write_arm(Path(name)))
        model = pin.buildModelFromUrdf(f"{name}/arm.urdf")
    data, basis = model.createData(), free_basis(robot)
    q, dq, ddq = (rng.normal(size=(8192, 7)) for _ in range(3))

    def loop() -> Array:
        out = np.empty((len(q), 7, 70))
        for i in range(len(q)):
            out[i] = pin.computeJointTorqueRegressor(model, data, q[i], dq[i], ddq[i])
        return out

    columns = np.flatnonzero(basis.representative.any(axis=1))
    batch = partial(torque_regressor, robot.chain, robot.gravity, q, dq, ddq)
    needed = partial(base_regressor, robot, basis, q, dq, ddq)
    one, chosen, every, base = _cpu(
        [loop, lambda: loop()[:, :, columns], batch, needed], rounds
    )
    per, unit = 1e6 / len(q), "us/sample"
    error = float(np.abs(loop() - batch()).max() / np.abs(batch()).max())
    return [
        ["regressor: Pinocchio, sample by sample", f"{one * per:.2f}", unit, "1.0", ""],
        _result("regressor: batched", every * per, unit, one / every, error),
        _result(
            "regressor: batched, base columns", base * per, unit, chosen / base, None
        ),
    ]


def _least_squares(rounds: int, *, quick: bool) -> list[list[str]]:
    """64 columns, 7 rows per sample, those of a joint without the links before it."""
    samples, width = (2_000 if quick else 20_000), 64
    rng = np.random.default_rng(2)
    theta = rng.normal(size=width)
    columns = rng.normal(size=(7, width, samples))  # as the regressor comes
    loaded = np.arange(width) >= 9 * np.arange(7)[:, None]
    columns[~loaded] = 0.0
    rows = columns.transpose(0, 2, 1)
    y = np.einsum("jnp,p->jn", rows, theta) + 0.1 * rng.normal(size=(7, samples))
    stacked = np.ascontiguousarray(rows).reshape(-1, width)

    def ours_job() -> Array:
        joints = [_accumulated(*own) for own in zip(rows, y, strict=True)]
        return triangular(np.vstack([joint.total for joint in joints]))

    jobs = [lambda: np.linalg.lstsq(stacked, y.ravel(), rcond=None), ours_job]
    theirs, ours = _cpu(jobs, max(1, rounds // 3))
    per, name = 1e6 / samples, "least squares: R factors"
    found = [
        ["least squares: lstsq", f"{theirs * per:.1f}", "us/sample", "1.0", ""],
        _result(name, ours * per, "us/sample", theirs / ours, None),
    ]
    for power in (3, 7):
        spread = np.logspace(0, -power, width)
        mixing = np.linalg.qr(rng.normal(size=(width, width)))[0]
        dense = rng.normal(size=(7 * samples // 4, width)) * spread @ mixing
        R = _accumulated(dense, dense @ theta).total
        solved = np.linalg.solve(R[:-1, :-1], R[:-1, -1])
        reference = np.linalg.lstsq(dense, dense @ theta, rcond=None)[0]
        errors = [
            np.linalg.norm(x - theta) / np.linalg.norm(theta)
            for x in (solved, reference)
        ]
        told = "{:.1e} (lstsq {:.1e})".format(*errors)
        found.append([f"{name}, condition 1e{power}", "", "", "", told])
    return found


def _accumulated(H: Array, y: Array) -> Accumulator:
    joint = Accumulator(H.shape[1])
    for start in range(0, len(y), 1000):
        joint.add(H[start : start + 1000], y[start : start + 1000])
    return joint


def _result(
    name: str, cpu: float, unit: str, faster: float, error: float | None
) -> list[str]:
    shown = "" if error is None else f"{error:.1e}"
    return [name, f"{cpu:.2f}", unit, f"{faster:.1f}", shown]


def smoother(chosen: Namespace) -> str:
    seconds, repeats = (4.0, 1) if chosen.quick else (40.0, 3)
    rigs = {
        "one joint, one array": Rig(1, 2400, seconds=seconds),
        "six joints, two arrays": Rig(6, 2**17, seconds=seconds),
        "six joints, two gyro IMUs": Rig(6, 2**17, gyro=True, seconds=seconds),
    }
    rows = []
    for label, rig in rigs.items():
        c = case(rig)
        job = partial(smoothed_motion, c.recording, c.robot, c.stage)
        cpu, span = (
            min(_spent(job) for _ in range(repeats)),
            float(np.ptp(c.recording.t)),
        )
        rows.append([label, f"{span:.0f}", f"{cpu:.2f}", f"{span / cpu:.0f}"])
    return table(
        ["rig, 1 kHz", "log, s", "CPU, s", "times faster than real time"], rows
    )
