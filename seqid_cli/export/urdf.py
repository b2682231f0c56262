"""URDF: the original file with other inertials, or a new one of a DH robot.

Joints get damping and friction as their dynamics. URDF has no place for rotor inertia.
It is written where readers look for it: as `drake:` tags in the joint's transmission
(with the gear ratio beside it, as Drake reads them), in a comment, and beside friction
as a parameter of the joint in a `ros2_control` system, added where there is none.
"""

from collections.abc import Sequence
from xml.dom import minidom
from xml.dom.minidom import Comment, Document, Element, Text

import numpy as np
import pinocchio as pin

from seqid_cli.export.model import ExportModel
from seqid_cli.export.text import plain, real, remarks, rendered
from seqid_cli.export.urdf_tree import UrdfBody
from seqid_cli.model.bodies.pseudo_inertia import Body
from seqid_cli.robot.base_parameters import gear_ratios
from seqid_cli.robot.regressor import PER_LINK
from seqid_cli.robot.types import Robot

_DRAKE = "http://drake.mit.edu"


def urdf(model: ExportModel) -> str:
    """Return the robot's URDF with other inertials, damping and friction, or a new one.

    Everything else (visuals, collisions, limits, other branches, comments) stays as it
    is. A body's inertial goes to the link behind its joint; links fixed to that one
    lose theirs. Links of a new one are named after their joints, `<joint>_link`; the
    base is `base_link`.
    """
    if model.urdf is not None:
        raw = model.urdf.raw
        bodies = model.links
    else:
        raw = _new_urdf(model)
        bodies = _new_bodies(model.robot)
    document = minidom.parseString(raw)
    root = document.documentElement
    assert root is not None

    links = _by_name(_children(root, "link"))
    joints = _by_name(_children(root, "joint"))
    for j, body in enumerate(bodies):
        _set_inertial(document, links, model, j, body)
        _set_joint(document, joints[model.robot.joint_names[j]], model, j)
        if model.nearest.rotor[j] > 0.0:
            _set_rotor(document, root, model, j)
    if not _children(root, "ros2_control"):
        control = rendered("control.urdf.jinja", model, name=model.robot.name)
        _place(root, _parsed(control), 1)

    # The remarks come first, on lines of their own.
    lines = "\n".join(f"  {line}" for line in remarks(model))
    root.insertBefore(document.createComment(f"\n{lines}\n"), root.firstChild)
    root.insertBefore(document.createTextNode("\n  "), root.firstChild)
    text = "\n".join(node.toxml() for node in document.childNodes)
    return f'<?xml version="1.0" encoding="utf-8"?>\n{text}\n'


def _new_links(robot: Robot) -> list[str]:
    """Return the names of a new URDF's links, the base first."""
    return ["base_link", *(f"{name}_link" for name in robot.joint_names)]


def _new_urdf(model: ExportModel, *, no_limit: float = 1000.0) -> bytes:
    """Return a URDF of a robot that is described by DH parameters, without inertials.

    `no_limit` stands for limits that the robot file does not give, N m, rad/s or m: a
    URDF must have some.
    """
    robot = model.robot
    text = rendered(
        "arm.urdf.jinja",
        model,
        arm=robot,
        links=_new_links(robot),
        turns=[pin.rpy.matrixToRpy(rotation) for rotation in robot.chain.rotation],
        no_limit=no_limit,
    )
    return text.encode()


def _new_bodies(robot: Robot) -> tuple[UrdfBody, ...]:
    """Return the bodies of a new URDF: one link for each joint."""
    return tuple(
        UrdfBody(link=link, merged=(), locked_links=np.zeros(PER_LINK))
        for link in _new_links(robot)[1:]
    )


def _set_inertial(
    document: Document,
    links: dict[str, Element],
    model: ExportModel,
    joint: int,
    body: UrdfBody,
) -> None:
    """Write a body's inertial into its link, and take those of merged links away."""
    solid = Body.of(model.nearest.links[joint])
    inertial = _parsed(rendered("inertial.urdf.jinja", model, body=solid))
    _replace(links[body.link], "inertial", inertial, missing=True)
    for name in body.merged:
        remark = document.createComment(f" seqid: part of {plain(body.link)} ")
        _replace(links[name], "inertial", remark)


def _set_joint(
    document: Document, element: Element, model: ExportModel, joint: int
) -> None:
    """Write friction as the joint's dynamics, and its armature in a comment."""
    fit = model.friction[joint]
    if fit is not None:
        if not _children(element, "dynamics"):
            _place(element, document.createElement("dynamics"), 2)
        dynamics = _children(element, "dynamics")[0]
        dynamics.setAttribute("damping", real(fit.viscous))
        dynamics.setAttribute("friction", real(fit.coulomb))

    armature = model.armature[joint]
    if armature > 0.0:
        remark = f" seqid: armature {real(armature)}, not in the inertials "
        _place(element, document.createComment(remark), 2)


def _set_rotor(
    document: Document, root: Element, model: ExportModel, joint: int
) -> None:
    """Write rotor inertia and gear ratio into the actuator of the joint's transmission.

    That is the only actuator of the only transmission that moves this joint alone: in
    another one the ratio of several motors would be meant.
    """
    name = model.robot.joint_names[joint]
    ratio = abs(float(gear_ratios(model.robot)[joint]))
    actuator = _own_actuator(_children(root, "transmission"), name)
    if actuator is None:
        text = rendered("transmission.urdf.jinja", model, joint=name, ratio=ratio)
        transmission = _parsed(text)
        _place(root, transmission, 1)
        actuator = _children(transmission, "actuator")[0]

    root.setAttribute("xmlns:drake", _DRAKE)
    values = {"rotor_inertia": model.nearest.rotor[joint], "gear_ratio": ratio}
    for tag, value in values.items():
        element = document.createElement(f"drake:{tag}")
        element.setAttribute("value", real(value))
        _replace(actuator, f"drake:{tag}", element, missing=True)


def _own_actuator(transmissions: Sequence[Element], joint: str) -> Element | None:
    """Return the only actuator that moves a joint alone; None without such a one."""
    for transmission in transmissions:
        joints = _children(transmission, "joint")
        actuators = _children(transmission, "actuator")
        names = [element.getAttribute("name") for element in joints]
        if names == [joint] and len(actuators) == 1:
            return actuators[0]
    return None


def _by_name(elements: Sequence[Element]) -> dict[str, Element]:
    """Return elements by their `name`."""
    return {element.getAttribute("name"): element for element in elements}


def _parsed(text: str) -> Element:
    """Return the element that a text holds."""
    root = minidom.parseString(text).documentElement
    assert root is not None
    return root


def _children(parent: Element, tag: str) -> list[Element]:
    """Return the elements of a name that stand in another."""
    return [
        node
        for node in parent.childNodes
        if isinstance(node, Element) and node.tagName == tag
    ]


def _replace(
    parent: Element, tag: str, node: Element | Comment, *, missing: bool = False
) -> None:
    """Put a node in the place of the elements of a name.

    Where there is none, it is added if `missing`.
    """
    old = _children(parent, tag)
    for element in old[1:]:
        parent.removeChild(element)
    if old:
        parent.replaceChild(node, old[0])
    elif missing:
        # Elements of a namespace are those of a transmission's actuator.
        _place(parent, node, 3 if ":" in tag else 2)


def _place(parent: Element, node: Element | Comment, depth: int) -> None:
    """Append a node on a line of its own, indented by `depth`.

    Where the children of a parent stand on one line, so does the node.
    """
    document = parent.ownerDocument
    assert document is not None
    if parent.lastChild is None:
        parent.appendChild(document.createTextNode("\n" + "  " * (depth - 1)))
    last = parent.lastChild
    if isinstance(last, Text) and last.data.isspace():
        parent.insertBefore(document.createTextNode("\n" + "  " * depth), last)
        parent.insertBefore(node, last)
    else:
        parent.appendChild(node)
