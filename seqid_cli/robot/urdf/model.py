"""URDF to chain and nominal inertials. Arms as Pinocchio has them.

Pinocchio refuses revolute and prismatic joints without a complete <limit>, which plays no part in
the dynamics and which hand-made files lack, and links with the name of a joint, which URDF allows;
both are repaired before it reads.
"""

import contextlib
import copy
import os
from collections.abc import Iterator
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pinocchio as pin

from seqid_cli.errors import ConfigError
from seqid_cli.robot.kinematics import tidy_axis, tidy_position, tidy_rotation
from seqid_cli.robot.types import Array, Chain
from seqid_cli.robot.urdf.text import UrdfText

WIDE = "1e9"


def chain_from_urdf(
    urdf: UrdfText, names: tuple[str, ...], source: Path
) -> tuple[Chain, Array | None]:
    """Build the chain of the joints `names`, all other joints locked at zero and merged.

    Quarter turns and zeros that it rounds are exact (see `tidy_rotation`). Raises ConfigError, of
    the robot file `source`: the URDF is inconsistent, or `names` is not a serial chain in this
    order.
    """
    whole = whole_model(urdf)
    others = [k for k in range(1, whole.njoints) if whole.names[k] not in names]
    # A continuous joint is (cos, sin) in the configuration, so its zero is not 0.0: neutral knows.
    model = pin.buildReducedModel(whole, others, pin.neutral(whole))
    _check_chain(model, names, urdf, source)
    nominal = np.array([inertia.toDynamicParameters() for inertia in model.inertias[1:]])
    joints = [urdf.joints[name] for name in names]
    chain = Chain(
        rotation=np.array([tidy_rotation(M.rotation) for M in model.jointPlacements[1:]]),
        position=np.array([tidy_position(M.translation) for M in model.jointPlacements[1:]]),
        axis=np.array([tidy_axis(np.array(joint.axis)) for joint in joints]),
        prismatic=np.array([joint.kind == "prismatic" for joint in joints]),
    )
    return chain, nominal if urdf.root.find("link/inertial") is not None else None


def whole_model(urdf: UrdfText) -> pin.Model:
    """Read all links and joints of a URDF; raises ConfigError where it is inconsistent."""
    try:
        with _unheard():
            return pin.buildModelFromXML(readable(urdf))
    except (ValueError, RuntimeError) as problem:
        reason = str(problem).strip().splitlines()[0] if str(problem).strip() else "no reason given"
        hint = "Check it with `check_urdf` (liburdfdom-tools)."
        message = f"not a usable URDF: {reason}"
        raise ConfigError(message, where=str(urdf.path), hint=hint) from None


def readable(urdf: UrdfText) -> str:
    """Give joints that lack part of their <limit> a wide one; rename links named like a joint."""
    root = copy.deepcopy(urdf.root)
    for joint in root.findall("joint"):
        if joint.get("type") in ("revolute", "prismatic"):
            limit, wide = joint.find("limit"), {"effort": WIDE, "velocity": WIDE}
            if limit is None:
                limit = ElementTree.SubElement(joint, "limit")
                wide |= {"lower": f"-{WIDE}", "upper": WIDE}
            limit.attrib.update({**wide, **limit.attrib})
    for tag, key in (("link", "name"), ("joint/parent", "link"), ("joint/child", "link")):
        for element in root.findall(tag):
            if element.get(key) in urdf.joints:
                element.set(key, f"{element.get(key)}/link")
    return ElementTree.tostring(root, encoding="unicode")


@contextlib.contextmanager
def _unheard() -> Iterator[None]:
    """Drop what the library itself writes to the screen: names in it may steer a terminal."""
    try:
        screen = os.dup(2)
    except OSError:  # it is closed
        yield
        return
    with Path(os.devnull).open("w") as nowhere:
        os.dup2(nowhere.fileno(), 2)
    try:
        yield
    finally:
        os.dup2(screen, 2)
        os.close(screen)


def _check_chain(model: pin.Model, names: tuple[str, ...], urdf: UrdfText, source: Path) -> None:
    """Raise unless joint k of `names` is the child of joint k - 1."""
    parent = {model.names[k]: model.names[model.parents[k]] for k in range(1, model.njoints)}
    order: list[str] = []
    before = str(model.names[0])
    while children := [name for name, of in parent.items() if of == before]:
        if len(children) > 1:
            apart = " and ".join(map(repr, children))
            message = f"joints {apart} are on different branches of {urdf.path.name}"
            hint = "Name the joints of one serial chain only; the others are locked at zero."
            raise ConfigError(message, where=str(source), hint=hint)
        before = children[0]
        order.append(before)
    if tuple(order) != names:
        message = f"the [[joint]] tables are not in chain order: {', '.join(names)}"
        hint = f"The order in {urdf.path.name} is: {', '.join(order)}."
        raise ConfigError(message, where=str(source), hint=hint)
