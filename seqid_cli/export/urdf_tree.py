"""The links of a URDF that make up each body of the arm.

A body is the link behind an identified joint and all links up to the next identified
joint. Links fixed to it are merged into it. Links behind another joint (a gripper's
finger) were locked at zero during identification, but move where the file is loaded:
they keep their own inertials.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import pinocchio as pin

from seqid_cli.robot.regressor import PER_LINK
from seqid_cli.robot.types import Array
from seqid_cli.robot.urdf import UrdfText, link_of
from seqid_cli.robot.urdf_model import whole_model


@dataclass(frozen=True, kw_only=True)
class UrdfBody:
    """The links that one identified joint moves.

    Attributes
    ----------
    link : str
        The link behind the joint, which carries the body's inertial.
    merged : tuple of str
        Links that are fixed to it.
    locked_links : (10,) array
        Standard parameters, in the frame of `link`, of all links behind joints that are
        not identified.
    """

    link: str
    merged: tuple[str, ...]
    locked_links: Array


def bodies_of_urdf(urdf: UrdfText, joints: Sequence[str]) -> tuple[UrdfBody, ...]:
    """Find the body of each identified joint.

    Parameters
    ----------
    urdf : UrdfText
        The URDF of the robot.
    joints : sequence of str
        Names of the identified joints, from the base on.

    Returns
    -------
    tuple of UrdfBody
        One for each joint.

    Raises
    ------
    ConfigError
        The URDF is inconsistent.
    """
    model = whole_model(urdf)
    data = model.createData()
    pin.forwardKinematics(model, data, pin.neutral(model))

    child_by_joint = {}
    parent_by_weld = {}
    for joint in urdf.root.findall("joint"):
        child = link_of(joint, "child")
        child_by_joint[joint.get("name")] = child
        if joint.get("type") == "fixed":
            parent_by_weld[child] = link_of(joint, "parent")

    return tuple(
        UrdfBody(
            link=child_by_joint[name],
            merged=_welded_to(child_by_joint[name], parent_by_weld),
            locked_links=_locked_links(model, data, name, joints),
        )
        for name in joints
    )


def _welded_to(link: str, parent_by_weld: Mapping[str, str]) -> tuple[str, ...]:
    """Return the links that are fixed to a link, directly or by others."""
    welded = [link]
    # The list grows while it is gone through, until nothing is fixed to any of them.
    for carrier in welded:
        welded += [
            child for child, parent in parent_by_weld.items() if parent == carrier
        ]
    return tuple(welded[1:])


def _locked_links(
    model: pin.Model, data: pin.Data, name: str, joints: Sequence[str]
) -> Array:
    """Return the links behind joints that are not identified, in the frame of a joint.

    Parameters
    ----------
    model, data : pin.Model, pin.Data
        The whole URDF, and the places of its joints at zero.
    name : str
        The joint whose body they are part of.
    joints : sequence of str
        Names of all identified joints.

    Returns
    -------
    (10,) array
        Standard parameters of all of them together.
    """
    joint = model.getJointId(name)
    behind = [joint]
    # The list grows by the joints that are not identified, up to those that are.
    for k in behind:
        behind += [
            child for child in model.children[k] if model.names[child] not in joints
        ]

    phi = np.zeros(PER_LINK)
    for k in behind[1:]:
        to_joint = data.oMi[joint].actInv(data.oMi[k])
        phi += to_joint.act(model.inertias[k]).toDynamicParameters()
    return phi


def root_link(urdf: UrdfText) -> str:
    """Return the link of a URDF that no joint moves; gravity is given in its axes."""
    moved = {link_of(joint, "child") for joint in urdf.root.findall("joint")}
    names = (link.get("name", "") for link in urdf.root.findall("link"))
    return next(name for name in names if name not in moved)
