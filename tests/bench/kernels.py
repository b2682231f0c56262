"""What the numerical kernels cost against the library calls that one would use instead.

The two of a comparison take turns in one process; CPU time is the median of the turns.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from pathlib import Path
from statistics import median
from tempfile import TemporaryDirectory

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray
from scipy.signal import butter, sosfiltfilt

from seqid_cli.identify.least_squares import Accumulator, triangular
from seqid_cli.motion.block_filter import REACH, BlockLowpass
from seqid_cli.robot.base import base_regressor, free_basis
from seqid_cli.robot.file import load_robot
from seqid_cli.robot.regressor import torque_regressor
from tests.bench.arm import write_arm
from tests.study.tables import table

Array = NDArray[np.float64]
Job = Callable[[], object]

HEAD = ["", "CPU", "unit", "faster", "largest difference"]
CHUNK = 65_536


def study(*, quick: bool = False) -> str:
    """Return the tables."""
    rounds = 1 if quick else 9
    parts = [_filter(rounds, quick=quick), _regressor(rounds), _least_squares(rounds, quick=quick)]
    return table(HEAD, [row for part in parts for row in part])


def _cpu(jobs: list[Job], rounds: int) -> list[float]:
    """CPU seconds of jobs that take turns."""
    spent: list[list[float]] = [[] for _ in jobs]
    for _ in range(rounds):
        for job, times in zip(jobs, spent, strict=True):
            before = time.process_time()
            job()
            times.append(time.process_time() - before)
    return [median(times) for times in spent]


def _filter(rounds: int, *, quick: bool) -> list[list[str]]:
    """Zero-phase low-pass of 14 channels, whole or in chunks."""
    samples = CHUNK if quick else 8 * CHUNK
    rows = np.cumsum(np.random.default_rng(0).normal(size=(14, samples)), axis=1)
    sos, lowpass = butter(4, 20.0, fs=1000.0, output="sos"), BlockLowpass(20.0, 1000.0)
    reach = lowpass.memory + REACH

    def whole() -> Array:
        return np.asarray(sosfiltfilt(sos, rows, padtype="odd", padlen=6 * lowpass.settling))

    def chunks() -> Array:
        out = np.empty_like(rows)
        for start in range(0, samples, CHUNK):
            low = max(0, start - reach)
            part = rows[:, low : start + CHUNK + reach].copy()
            lowpass.filter_rows(part)
            out[:, start : start + CHUNK] = part[:, start - low : start - low + CHUNK]
        return out

    theirs, ours = _cpu([whole, chunks], rounds)
    error = float(np.abs(whole() - chunks()).max() / np.abs(rows).max())
    per = 1e9 / rows.size
    return [
        ["low-pass: sosfiltfilt on all", f"{theirs * per:.1f}", "ns/value", "1.0", ""],
        _result("low-pass: in chunks", ours * per, "ns/value", theirs / ours, error),
    ]


def _regressor(rounds: int) -> list[list[str]]:
    """Torque regressor of seven joints."""
    rng = np.random.default_rng(1)
    with TemporaryDirectory() as name:
        robot = load_robot(write_arm(Path(name)))
        model = pin.buildModelFromUrdf(str(Path(name) / "arm.urdf"))
    data, basis = model.createData(), free_basis(robot)
    q, dq, ddq = (rng.normal(size=(8192, 7)) for _ in range(3))

    def loop() -> Array:
        out = np.empty((len(q), 7, 70))
        for i in range(len(q)):
            out[i] = pin.computeJointTorqueRegressor(model, data, q[i], dq[i], ddq[i])
        return out

    def batch() -> Array:
        return torque_regressor(robot.chain, robot.gravity, q, dq, ddq)

    def needed() -> Array:
        return base_regressor(robot, basis, q, dq, ddq)

    def selected() -> Array:
        return np.asarray(loop()[:, :, basis.columns])

    theirs, ours, theirs_needed, ours_needed = _cpu([loop, batch, selected, needed], rounds)
    error = float(np.abs(loop() - batch()).max() / np.abs(batch()).max())
    per = 1e6 / len(q)
    return [
        ["regressor: Pinocchio, sample by sample", f"{theirs * per:.2f}", "us/sample", "1.0", ""],
        _result("regressor: batched", ours * per, "us/sample", theirs / ours, error),
        _result(
            "regressor: batched, base columns",
            ours_needed * per,
            "us/sample",
            theirs_needed / ours_needed,
            None,
        ),
    ]


def _least_squares(rounds: int, *, quick: bool) -> list[list[str]]:
    """64 columns, 7 rows per sample, those of a joint without the links before it."""
    samples, width = (2_000 if quick else 20_000), 64
    rng = np.random.default_rng(2)
    spread = np.logspace(0, -7, width)
    mixing = np.linalg.qr(rng.normal(size=(width, width)))[0]
    dense = rng.normal(size=(7 * samples // 4, width)) * spread @ mixing
    theta = rng.normal(size=width)
    right = dense @ theta
    rows = rng.normal(size=(7, samples, width))
    for j in range(7):
        rows[j, :, : 9 * j] = 0.0
    y = np.einsum("jnp,p->jn", rows, theta)
    stacked = rows.reshape(-1, width)

    def theirs_job() -> Array:
        return np.asarray(np.linalg.lstsq(stacked, y.ravel(), rcond=None)[0])

    def ours_job() -> Array:
        joints = [Accumulator(width) for _ in range(7)]
        for start in range(0, samples, 1000):
            part = slice(start, start + 1000)
            for j, joint in enumerate(joints):
                joint.add(rows[j, part], y[j, part])
        return triangular(np.vstack([joint.total for joint in joints]))

    theirs, ours = _cpu([theirs_job, ours_job], max(1, rounds // 3))
    R = triangular(np.column_stack([dense, right]))
    solved = np.linalg.solve(R[:-1, :-1], R[:-1, -1])
    reference = np.linalg.lstsq(dense, right, rcond=None)[0]
    errors = [float(np.linalg.norm(x - theta) / np.linalg.norm(theta)) for x in (solved, reference)]
    per = 1e6 / samples
    name = "least squares: R factors"
    return [
        ["least squares: lstsq", f"{theirs * per:.1f}", "us/sample", "1.0", ""],
        _result(name, ours * per, "us/sample", theirs / ours, None),
        [f"{name}, condition 1e7", "", "", "", f"{errors[0]:.1e} (lstsq {errors[1]:.1e})"],
    ]


def _result(name: str, cpu: float, unit: str, faster: float, error: float | None) -> list[str]:
    shown = "" if error is None else f"{error:.1e}"
    return [name, f"{cpu:.2f}", unit, f"{faster:.1f}", shown]
