"""Whole runs, one case per process: `python -m tests.benchmarks.whole_run_cases CASE
ROBOT LOG`.
"""

import json
import sys
from collections.abc import Callable
from functools import partial
from pathlib import Path

import numpy as np

from tests import Array
from tests.benchmarks.figaroh_case import held_mib
from tests.benchmarks.measure import tell
from tests.plants.robots.seven_joint import JOINTS, RATE_HZ, SIGN_WIDTH, known_friction

# Central differences; with those of second order (np.gradient) inertias are 1e-5 off.
FIRST = RATE_HZ * np.array(
    [1 / 280, -4 / 105, 1 / 5, -4 / 5, 0, 4 / 5, -1 / 5, 4 / 105, -1 / 280]
)
SECOND = (
    RATE_HZ**2 * np.array([-9, 128, -1008, 8064, -14350, 8064, -1008, 128, -9]) / 5040
)
ROWS = 2048  # samples of arrays that are worked on at a time
Found = dict[str, tuple[float, float]]  # value and standard error (0: not told)


def seqid(
    robot_path: Path, log: Path, samples_per_cutoff: float = 10.0
) -> Callable[[], Found]:
    """The inertia stage as the command runs it."""
    from seqid_cli.identify.options import InertiaOptions
    from seqid_cli.identify.rigid.inertia import identify_inertia
    from seqid_cli.logs.long import open_long
    from seqid_cli.motion.options import MotionOptions
    from seqid_cli.robot.file import load_robot

    robot = load_robot(robot_path)
    motion = MotionOptions(samples_per_cutoff=samples_per_cutoff)
    options = InertiaOptions(source="encoder", motion=motion)

    def run() -> Found:
        opened = open_long(log, robot)
        if opened is None:
            raise RuntimeError(f"{log} cannot be passed over")
        stage = identify_inertia(
            [opened], robot, known_friction(), options=options
        ).inertia
        settings = {"cutoff_hz": stage.cutoff_hz, "sigma": list(stage.rmse.values())}
        log.with_suffix(".json").write_text(json.dumps(settings), encoding="utf-8")
        return {p.name: (p.value, p.std_error) for p in stage.parameters}

    return run


def straightforward(robot_path: Path, log: Path) -> Callable[[], Found]:
    """What one writes in an afternoon: read all, filter, Pinocchio sample by sample,
    lstsq.
    """
    import pinocchio as pin
    import pyarrow.parquet as pq
    from scipy.ndimage import binary_dilation, correlate1d
    from scipy.signal import butter, sosfiltfilt

    from seqid_cli.model.friction import friction_torque
    from seqid_cli.model.torque import friction_surfaces
    from seqid_cli.robot.base_parameters import free_basis
    from seqid_cli.robot.file import load_robot

    robot = load_robot(robot_path)
    basis = free_basis(robot)
    surfaces = friction_surfaces(known_friction(), robot)
    model = pin.buildModelFromUrdf(str(robot_path.with_name("arm.urdf")))
    settings = json.loads(log.with_suffix(".json").read_text(encoding="utf-8"))
    sos = butter(4, settings["cutoff_hz"], fs=RATE_HZ, output="sos")
    settling = int(np.ceil(0.6 * RATE_HZ / settings["cutoff_hz"])) + 4

    def smooth(values: Array) -> Array:
        return np.asarray(sosfiltfilt(sos, values, axis=0, padlen=6 * settling))

    def run() -> Found:
        table = pq.read_table(log)
        q, tau = (
            np.column_stack([table[f"{name}.{kind}"].to_numpy() for name in JOINTS])
            for kind in ("position", "torque")
        )
        q, tau = smooth(q), smooth(smooth(tau))
        wide = np.pad(q, ((4, 4), (0, 0)), mode="reflect", reflect_type="odd")
        dq, ddq = (correlate1d(wide, taps, axis=0)[4:-4] for taps in (FIRST, SECOND))
        tau -= smooth(smooth(friction_torque(surfaces, q, dq)))
        n, kept = model.nv, np.flatnonzero(basis.representative.any(axis=1))
        data = model.createData()
        W = np.empty((len(q), n, len(kept)))
        for i in range(len(q)):
            W[i] = pin.computeJointTorqueRegressor(model, data, q[i], dq[i], ddq[i])[
                :, kept
            ]
        for j in range(n):
            W[:, j] = smooth(W[:, j])
        near = int(0.25 * RATE_HZ / settings["cutoff_hz"])
        still = np.abs(dq) < 2 * SIGN_WIDTH
        slides = ~binary_dilation(still, np.ones((2 * near + 1, 1), dtype=bool))
        slides[: 2 * settling] = slides[-2 * settling :] = False
        sigma = np.broadcast_to(settings["sigma"], q.shape)[slides]
        W = W[slides] / sigma[:, None]
        theta = np.linalg.lstsq(W, tau[slides] / sigma, rcond=None)[0]
        phi = np.zeros(basis.expression.shape[1])
        phi[kept] = theta
        values = (basis.expression @ phi).tolist()
        return {name: (v, 0.0) for name, v in zip(basis.names, values, strict=True)}

    return run


def arrays(robot_path: Path, path: Path) -> Callable[[], dict[str, float]]:
    """Given motion and torque to base parameters,
    as the inertia stage solves for them.
    """
    from seqid_cli.identify.regression.least_squares import Accumulator, solve
    from seqid_cli.robot.base_parameters import base_regressor, free_basis
    from seqid_cli.robot.file import load_robot

    robot = load_robot(robot_path)
    with np.load(path) as given:
        q, dq, ddq, tau = (given[name] for name in ("q", "dq", "ddq", "tau"))

    def run() -> dict[str, float]:
        base, basis = held_mib(), free_basis(robot)
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
        return {
            "base": base,
            "size": basis.size,
            "rms": float(np.sqrt(np.mean(np.square(rms)))),
        }

    return run


CASES = {
    "decimated": seqid,
    "full_rate": partial(seqid, samples_per_cutoff=np.inf),  # every sample
    "straightforward": straightforward,
    "arrays": arrays,
}

if __name__ == "__main__":
    name, robot_file, *log_file = sys.argv[1:]
    tell(CASES[name](Path(robot_file), Path(*log_file)))
