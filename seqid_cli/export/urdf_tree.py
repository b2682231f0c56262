"""The links of a URDF that make up each body of the arm, from its XML.

A body is the link behind an identified joint and all links up to the next identified joint. Links
fixed to it are merged into it. Links behind another joint (a gripper's finger) were locked at zero
during identification, but move where the file is loaded: they keep their own inertials.
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from xml.etree import ElementTree

import numpy as np
import pinocchio as pin

from seqid_cli.errors import ConfigError
from seqid_cli.model.bodies.pseudo_inertia import Body, pseudo_inertia, standard_of
from seqid_cli.robot.types import Array
from seqid_cli.robot.urdf.text import link_of


@dataclass(frozen=True)
class UrdfBody:
    """The links that one identified joint moves: `merged` are fixed to `link`.

    `kept` (10,) are the standard parameters, in the frame of `link`, of all links behind joints
    that are not identified; zero where there are none, `loose` names those links.
    """

    link: str
    merged: tuple[str, ...]
    loose: tuple[str, ...]
    kept: Array


def bodies_of_urdf(root: ElementTree.Element, joints: Sequence[str]) -> tuple[UrdfBody, ...]:
    """Find the body of each of the identified `joints`.

    `root`: the URDF, already known to be usable. `joints`: names of identified joints, in chain
    order. Raises ConfigError: a number in it cannot be read.
    """
    children: dict[str, list[ElementTree.Element]] = {}
    for joint in root.findall("joint"):
        children.setdefault(link_of(joint, "parent"), []).append(joint)
    first = {joint.get("name"): link_of(joint, "child") for joint in root.findall("joint")}
    found = []
    try:
        inertials = {link.get("name", ""): _inertial(link) for link in root.findall("link")}
        for link in (first[name] for name in joints):
            merged: list[str] = []
            loose: list[str] = []
            kept = np.zeros((4, 4))
            for name, placement, moves in _below(link, children, frozenset(joints)):
                (loose if moves else merged).append(name)
                inertial = inertials.get(name)
                if moves and inertial is not None:
                    kept += placement @ inertial @ placement.T
            found.append(UrdfBody(link, tuple(merged), tuple(loose), standard_of(kept)))
    except ValueError as problem:
        message = f"a number in the URDF cannot be read: {problem}"
        raise ConfigError(message, hint="Correct it in the URDF.") from None
    return tuple(found)


def root_link(root: ElementTree.Element) -> str:
    """Return the link of a URDF that no joint moves; gravity is given in its axes."""
    moved = {link_of(joint, "child") for joint in root.findall("joint")}
    return next(n for link in root.findall("link") if (n := link.get("name", "")) not in moved)


def _below(
    link: str, children: Mapping[str, Sequence[ElementTree.Element]], joints: frozenset[str]
) -> Iterator[tuple[str, Array, bool]]:
    """Yield links below `link` up to the next identified joint: name, placement, whether loose."""
    pending = [(link, np.eye(4), False)]
    while pending:
        parent, placement, moves = pending.pop()
        for joint in children.get(parent, ()):
            if joint.get("name", "") in joints:
                continue
            child = link_of(joint, "child")
            where = placement @ _origin(joint)
            loose = moves or joint.get("type") != "fixed"
            yield child, where, loose
            pending.append((child, where, loose))


def _inertial(link: ElementTree.Element) -> Array | None:
    """Return the pseudo-inertia (4, 4) of a link in its own frame; None without an inertial."""
    inertial = link.find("inertial")
    mass = None if inertial is None else inertial.find("mass")
    entries = None if inertial is None else inertial.find("inertia")
    if inertial is None or mass is None or entries is None:
        return None
    values = [float(entries.get(name, "0")) for name in ("ixx", "ixy", "ixz", "iyy", "iyz", "izz")]
    xx, xy, xz, yy, yz, zz = values
    inertia = np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
    J = pseudo_inertia(Body(float(mass.get("value", "0")), np.zeros(3), inertia).standard)
    T = _origin(inertial)
    placed: Array = T @ J @ T.T
    return placed


def _origin(element: ElementTree.Element) -> Array:
    """Return the placement (4, 4) of an element's <origin>."""
    origin = element.find("origin")
    T = np.eye(4)
    if origin is not None:
        place, angles = (
            [float(word) for word in origin.get(key, "0 0 0").split()] for key in ("xyz", "rpy")
        )
        T[:3, 3] = place
        T[:3, :3] = pin.rpy.rpyToMatrix(*angles)
    return T
