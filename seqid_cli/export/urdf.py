"""URDF: the original file with other inertials and joint dynamics, or a new one of a DH robot.

URDF has no place for rotor inertia. It is written where readers look for it: as
`drake:` tags in the joint's transmission (with the gear ratio beside it, as Drake reads
them), in a comment, and beside friction as a parameter of the joint in a `ros2_control`
system, added where there is none.
"""

from xml.dom import minidom
from xml.dom.minidom import Comment, Document, Element, Text

import pinocchio as pin

from seqid_cli.export.model import ExportModel
from seqid_cli.export.text import plain, real, remarks, rendered
from seqid_cli.export.urdf_tree import UrdfBody
from seqid_cli.model.bodies.pseudo_inertia import Body
from seqid_cli.robot.base_parameters import gear_ratios

_DRAKE = "http://drake.mit.edu"


def urdf(model: ExportModel) -> str:
    """Return the robot's URDF with other inertials, damping and friction, or a new one.

    Everything else (visuals, collisions, limits, other branches, comments) stays as it
    is. A body's inertial goes to the link behind its joint; links fixed to that one
    lose theirs. Links of a new one are named after their joints, `<joint>_link`; the
    base is `base_link`.
    """
    raw, bodies = (model.urdf.raw, model.links) if model.urdf else _new(model)
    document = minidom.parseString(raw)
    root = document.documentElement
    assert root is not None
    links = {
        element.getAttribute("name"): element for element in _children(root, "link")
    }
    joints = {
        element.getAttribute("name"): element for element in _children(root, "joint")
    }
    for k, body in enumerate(bodies):
        own = rendered(
            "inertial.urdf.jinja", model, body=Body.of(model.nearest.links[k])
        )
        _replace(links[body.link], "inertial", _parsed(own), missing=True)
        for name in body.merged:
            part = document.createComment(f" seqid: part of {plain(body.link)} ")
            _replace(links[name], "inertial", part)
        _set_joint(document, joints[model.robot.joint_names[k]], model, k)
        if model.nearest.rotor[k] > 0.0:
            _set_rotor(document, root, model, k)
    if not _children(root, "ros2_control"):
        _place(
            root,
            _parsed(rendered("control.urdf.jinja", model, name=model.robot.name)),
            1,
        )
    head = "\n".join(f"  {line}" for line in remarks(model))
    root.insertBefore(document.createComment(f"\n{head}\n"), root.firstChild)
    root.insertBefore(document.createTextNode("\n  "), root.firstChild)
    text = "\n".join(node.toxml() for node in document.childNodes)
    return f'<?xml version="1.0" encoding="utf-8"?>\n{text}\n'


def _new(
    model: ExportModel, *, no_limit: float = 1000.0
) -> tuple[bytes, tuple[UrdfBody, ...]]:
    """A URDF of a robot that is described by DH parameters, and its bodies."""
    links = ["base_link", *(f"{joint.name}_link" for joint in model.robot.joints)]
    turns = [pin.rpy.matrixToRpy(rotation) for rotation in model.robot.chain.rotation]
    own = {"arm": model.robot, "links": links, "turns": turns, "no_limit": no_limit}
    return rendered("arm.urdf.jinja", model, **own).encode(), tuple(
        map(UrdfBody, links[1:])
    )


def _set_joint(document: Document, joint: Element, model: ExportModel, k: int) -> None:
    """Write friction as the joint's dynamics, and its armature in a comment."""
    fit = model.friction[k]
    if fit is not None:
        if not _children(joint, "dynamics"):
            _place(joint, document.createElement("dynamics"), 2)
        dynamics = _children(joint, "dynamics")[0]
        dynamics.setAttribute("damping", real(fit.viscous))
        dynamics.setAttribute("friction", real(fit.coulomb))
    if model.armature[k] > 0.0:
        text = f" seqid: armature {real(model.armature[k])}, not in the inertials "
        _place(joint, document.createComment(text), 2)


def _set_rotor(document: Document, root: Element, model: ExportModel, k: int) -> None:
    """Write rotor inertia and gear ratio into the only actuator of the joint's own transmission."""
    name, ratio = model.robot.joint_names[k], abs(float(gear_ratios(model.robot)[k]))
    own = [
        _children(transmission, "actuator")
        for transmission in _children(root, "transmission")
        if [joint.getAttribute("name") for joint in _children(transmission, "joint")]
        == [name]
    ]
    actuator = next((actuators[0] for actuators in own if len(actuators) == 1), None)
    if actuator is None:
        made = _parsed(
            rendered("transmission.urdf.jinja", model, joint=name, ratio=ratio)
        )
        _place(root, made, 1)
        actuator = _children(made, "actuator")[0]
    root.setAttribute("xmlns:drake", _DRAKE)
    for tag, value in (
        ("rotor_inertia", model.nearest.rotor[k]),
        ("gear_ratio", ratio),
    ):
        element = document.createElement(f"drake:{tag}")
        element.setAttribute("value", real(value))
        _replace(actuator, f"drake:{tag}", element, missing=True)


def _parsed(text: str) -> Element:
    root = minidom.parseString(text).documentElement
    assert root is not None
    return root


def _children(parent: Element, tag: str) -> list[Element]:
    return [
        node
        for node in parent.childNodes
        if isinstance(node, Element) and node.tagName == tag
    ]


def _replace(
    parent: Element, tag: str, node: Element | Comment, *, missing: bool = False
) -> None:
    """Put a node in the place of the elements of this name, or where they are `missing`."""
    old = _children(parent, tag)
    for element in old[1:]:
        parent.removeChild(element)
    if old:
        parent.replaceChild(node, old[0])
    elif missing:
        _place(parent, node, 3 if ":" in tag else 2)


def _place(parent: Element, node: Element | Comment, depth: int) -> None:
    """Append a node on a line of its own, where the parent is empty or its children have theirs."""
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
