"""A ROS 2 parameter file, for a controller node that computes its own dynamics."""

from __future__ import annotations

import numpy as np

from seqid_cli.export.model import ExportModel
from seqid_cli.export.text import rendered
from seqid_cli.export.urdf_tree import root_link
from seqid_cli.model.bodies.pseudo_inertia import Body


def ros2_parameters(model: ExportModel) -> str:
    """Return the arm's parameters for any node (`/**`), a group per joint.

    Inertias are about the centre of mass in the axes of the joint's frame, as (ixx, ixy, ixz, iyy,
    iyz, izz); `armature` is the rotor's inertia as the joint feels it. ROS 2's
    inverse_dynamics_solver reads the exported URDF from its root link to its tip.
    """
    root, tip = "base_link", f"{model.robot.joint_names[-1]}_link"
    if model.urdf is not None:
        root, tip = root_link(model.urdf.root), model.links[-1].link
    return rendered(
        "arm.yaml.jinja",
        model,
        root=root,
        tip=tip,
        bodies=[Body.of(phi) for phi in model.bodies],
        friction=model.friction,
        armature=model.armature,
        upper=np.triu_indices(3),
    )
