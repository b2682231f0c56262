"""Exciting trajectories by FIGAROH's optimiser, with the same limits and in the same time.

Runs in an environment of its own, which `make peers` fills, as `python planned_peer.py URDF OUT`.
Segments of all joints from rest to rest with FIGAROH's own defaults: five way points 2 s apart,
cubic splines, IPOPT on the condition of the base regressor. No shapes are loaded: nothing collides.
"""

from __future__ import annotations

import argparse
import logging
import time
from pathlib import Path

import numpy as np
import pinocchio as pin
from figaroh.optimal.base_optimal_trajectory import (
    BaseOptimalTrajectory,
    BaseTrajectoryIPOPTProblem,
)
from figaroh.optimal.config import create_config
from pinocchio.robot_wrapper import RobotWrapper

SOFT = 0.025  # of both ends: 95 % of every limit
PARAMETERS = {
    "is_joint_torques": True,
    "is_external_wrench": False,
    "has_friction": False,
    "has_actuator_inertia": True,
    "has_joint_offset": False,
}


class Trajectory(BaseOptimalTrajectory):
    """FIGAROH's generator, told its settings directly; what it has is saved after each segment."""

    def __init__(self, urdf: Path, out: Path, lock: list[str], settings: dict[str, object]) -> None:
        full = pin.buildModelFromUrdf(str(urdf))
        still = [full.getJointId(name) for name in lock]
        self.model = pin.buildReducedModel(full, still, pin.neutral(full))
        self.robot, self.urdf, self.out = RobotWrapper(self.model), urdf, out
        self.robot.geom_model = None
        self.active_joints = list(self.model.names[1:])
        self.logger = logging.getLogger("figaroh")
        self.trajectory_config = create_config(settings)
        self.identif_config = {**PARAMETERS, "act_idxv": range(self.model.nv)}
        self.results = {key: [] for key in ("T_F", "P_F", "V_F", "A_F", "iteration_data")}

    def create_ipopt_problem(self, *arguments: object) -> BaseTrajectoryIPOPTProblem:
        """The problem of one segment, as it comes."""
        return BaseTrajectoryIPOPTProblem(self, *arguments)

    def _solve_segment(self, *arguments: object) -> bool:
        solved = super()._solve_segment(*arguments)
        runs = self.results["iteration_data"]
        if runs:
            np.savez(
                self.out,
                urdf=self.urdf.read_text(encoding="utf-8"),
                joints=self.active_joints,
                q=self.results["P_F"],
                dq=self.results["V_F"],
                ddq=self.results["A_F"],
                rate=self.trajectory_config["freq"],
                cpu=time.process_time(),
                condition=runs[-1]["obj_values"][-1],
                iterations=[len(run["obj_values"]) for run in runs],
            )
        return bool(solved)


def main() -> None:
    """Write the motions into OUT.npz."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("urdf", type=Path)
    parser.add_argument("out", type=Path)
    parser.add_argument("--lock", nargs="*", default=[])
    parser.add_argument("--segments", type=int, default=7)
    parser.add_argument("--iterations", type=int, default=200)
    parser.add_argument("--rate", type=int, default=25, help="Hz, of the samples it works on")
    given = parser.parse_args()
    np.random.seed(0)  # the generator that FIGAROH draws from
    settings = {
        "trajectory": {"frequency": given.rate},
        "problem": {"soft_lim": SOFT, "max_iterations": given.iterations, "segment_attempts": 5},
    }
    made = Trajectory(given.urdf, given.out, given.lock, settings)
    made.initialize()
    made.solve(given.segments)


if __name__ == "__main__":
    main()
