"""The links of a URDF that make up each body of the arm.

A body is the link behind an identified joint and all links up to the next identified
joint. Links fixed to it are merged into it. Links behind another joint (a gripper's
finger) were locked at zero during identification, but move where the file is loaded:
they keep their own inertials.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
import pinocchio as pin

from seqid_cli.robot.regressor import PER_LINK
from seqid_cli.robot.types import Array
from seqid_cli.robot.urdf import UrdfText, link_of
from seqid_cli.robot.urdf_model import whole_model


@dataclass(frozen=True)
class UrdfBody:
    """The links that one identified joint moves."""

    link: str
    merged: tuple[str, ...] = ()  # fixed to it
    # (10,) standard parameters, in its frame, of all links behind joints that are not
    # identified.
    kept: Array = field(default_factory=lambda: np.zeros(PER_LINK))


def bodies_of_urdf(urdf: UrdfText, joints: Sequence[str]) -> tuple[UrdfBody, ...]:
    """Find the body of each identified joint; raises ConfigError where the URDF is inconsistent."""
    model = whole_model(urdf)
    data = model.createData()
    pin.forwardKinematics(model, data, pin.neutral(model))
    elements = urdf.root.findall("joint")
    welds = (x for x in elements if x.get("type") == "fixed")
    fixed = {link_of(x, "child"): link_of(x, "parent") for x in welds}
    found = []
    for name in joints:
        first = next(link_of(x, "child") for x in elements if x.get("name") == name)
        merged = [first]
        for link in merged:  # grows until nothing is fixed to any of them
            merged += [child for child, parent in fixed.items() if parent == link]
        at, kept = model.getJointId(name), np.zeros(PER_LINK)
        # grows by the joints that are not identified, up to those that are
        behind = [at]
        for k in behind:
            behind += [j for j in model.children[k] if model.names[j] not in joints]
        for k in behind[1:]:
            kept += (
                data.oMi[at]
                .actInv(data.oMi[k])
                .act(model.inertias[k])
                .toDynamicParameters()
            )
        found.append(UrdfBody(first, tuple(merged[1:]), kept))
    return tuple(found)


def root_link(urdf: UrdfText) -> str:
    """Return the link of a URDF that no joint moves; gravity is given in its axes."""
    moved = {link_of(joint, "child") for joint in urdf.root.findall("joint")}
    names = (link.get("name", "") for link in urdf.root.findall("link"))
    return next(name for name in names if name not in moved)
