"""A ROS 2 parameter file, for a controller node that computes its own dynamics."""

from __future__ import annotations

import json
from collections.abc import Iterable

from seqid_cli.export.model import ExportModel
from seqid_cli.export.text import real, remarks
from seqid_cli.model.bodies.pseudo_inertia import Body


def ros2_parameters(model: ExportModel, root: str, tip: str) -> str:
    """Return the arm's parameters for any node (`/**`), a group per joint.

    Inertias are about the centre of mass in the axes of the joint's frame, as (ixx, ixy, ixz, iyy,
    iyz, izz); `armature` is the rotor's inertia as the joint feels it. `root` and `tip` are links
    of the exported URDF, for inverse_dynamics_solver.
    """
    lines = [f"# {line}" for line in remarks(model)]
    lines += ["/**:", "  ros__parameters:"]
    names = ", ".join(json.dumps(name) for name in model.robot.joint_names)
    lines += [f"    joints: [{names}]", f"    gravity: {_list(model.robot.gravity)}"]
    lines += [f"    {line}" for line in _solver(model, root, tip)]
    for k, name in enumerate(model.robot.joint_names):
        lines += [f"    {json.dumps(name)}:", *(f"      {line}" for line in _joint(model, k))]
    return "\n".join(lines) + "\n"


def _solver(model: ExportModel, root: str, tip: str) -> list[str]:
    """Parameters of ROS 2's inverse_dynamics_solver, whose KDL solver reads the exported URDF."""
    return [
        "inverse_dynamics_solver_plugin_name: kdl_inverse_dynamics_solver/InverseDynamicsSolverKDL",
        "kdl:  # robot_description is the exported URDF; armature and friction come on top",
        f"  root: {json.dumps(root)}",
        f"  tip: {json.dumps(tip)}",
        f"  gravity: {_list(model.robot.gravity)}",
    ]


def _joint(model: ExportModel, k: int) -> list[str]:
    body = Body.of(model.bodies[k])
    index = ((0, 0), (0, 1), (0, 2), (1, 1), (1, 2), (2, 2))
    lines = [
        f"mass: {real(body.mass)}",
        f"center_of_mass: {_list(body.center)}",
        f"inertia: {_list(float(body.inertia[i, j]) for i, j in index)}",
        f"armature: {real(model.armature[k])}",
    ]
    fit = model.friction[k]
    if fit is not None:
        lines += [
            "friction:",
            f"  coulomb: {real(fit.coulomb)}",
            f"  viscous: {real(fit.viscous)}",
            f"  offset: {real(fit.offset)}",
            f"  rms_misfit: {real(fit.rms_misfit)}",
        ]
    return lines


def _list(values: Iterable[float]) -> str:
    return "[" + ", ".join(real(value) for value in values) + "]"
