"""URDF: the original file with other inertials and joint dynamics, or a new one of a DH robot.

URDF has no place for rotor inertia. It is written where readers look for it: as `drake:` tags in
the joint's transmission (with the gear ratio beside it, as Drake reads them), in a comment, and
beside friction as a parameter of the joint in a `ros2_control` system, which is added to a URDF
that has none.
"""

from xml.dom import minidom
from xml.dom.minidom import Comment, Document, Element, Text

import pinocchio as pin

from seqid_cli.export.model import ExportModel
from seqid_cli.export.text import plain, real, reals, remarks, rendered
from seqid_cli.export.urdf_tree import UrdfBody
from seqid_cli.model.bodies.pseudo_inertia import Body
from seqid_cli.robot.base_parameters import gear_ratios
from seqid_cli.robot.types import Array, Joint

_DRAKE = "http://drake.mit.edu"


def urdf(model: ExportModel) -> str:
    """Return the robot's URDF with other inertials, damping and friction, or a new one.

    Everything else (visuals, collisions, limits, other branches, comments) stays as it is. A body's
    inertial goes to the link behind its joint; links fixed to that one lose theirs. Links of a new
    one are named after their joints, `<joint>_link`; the base is `base_link`.
    """
    raw, bodies = (model.urdf.raw, model.links) if model.urdf else _new(model)
    document = minidom.parseString(raw)
    root = document.documentElement
    assert root is not None
    links = {element.getAttribute("name"): element for element in _children(root, "link")}
    joints = {element.getAttribute("name"): element for element in _children(root, "joint")}
    for k, body in enumerate(bodies):
        _set_inertial(document, links[body.link], model.nearest.links[k])
        for link in (links[name] for name in body.merged):
            for old in _children(link, "inertial"):
                comment = document.createComment(plain(f" seqid: part of {body.link} "))
                link.replaceChild(comment, old)
        _set_joint(document, joints[model.robot.joint_names[k]], model, k)
        _set_transmission(document, root, model, k)
    if not _children(root, "ros2_control"):
        _add_control(document, root, model)
    head = "\n".join(f"  {line}" for line in remarks(model))
    root.insertBefore(document.createComment(f"\n{head}\n"), root.firstChild)
    root.insertBefore(document.createTextNode("\n  "), root.firstChild)
    text = "\n".join(node.toxml() for node in document.childNodes)
    return f'<?xml version="1.0" encoding="utf-8"?>\n{text}\n'


def _new(model: ExportModel) -> tuple[bytes, tuple[UrdfBody, ...]]:
    """A URDF of a robot that is described by DH parameters, and its bodies."""
    joints, chain = model.robot.joints, model.robot.chain
    links = ["base_link", *(f"{joint.name}_link" for joint in joints)]
    moves = []
    for k, joint in enumerate(joints):
        turns = "revolute" if joint.position_limits else "continuous"
        kind = "prismatic" if joint.prismatic else turns
        own = {"name": joint.name, "type": kind}
        rpy = pin.rpy.matrixToRpy(chain.rotation[k])
        parts = {
            "origin": {"xyz": reals(chain.position[k]), "rpy": reals(rpy)},
            "axis": {"xyz": reals(chain.axis[k])},
            "limit": _limits(joint, kind),
            "parent": {"link": links[k]},
            "child": {"link": links[k + 1]},
        }
        moves.append({"attributes": own, "parts": parts})
    raw = rendered("arm.urdf.jinja", model, name=model.robot.name, links=links, moves=moves)
    return raw.encode(), tuple(map(UrdfBody, links[1:]))


def _limits(joint: Joint, kind: str, *, no_limit: float = 1000.0) -> dict[str, str]:
    limits = {"effort": real(no_limit), "velocity": real(joint.velocity_limit or no_limit)}
    if kind != "continuous":
        low, high = joint.position_limits or (-no_limit, no_limit)
        limits |= {"lower": real(low), "upper": real(high)}
    return limits


def _set_inertial(document: Document, link: Element, phi: Array) -> None:
    body = Body.of(phi)
    inertial = document.createElement("inertial")
    _add(document, inertial, "origin", 3, xyz=reals(body.center), rpy="0 0 0")
    _add(document, inertial, "mass", 3, value=real(body.mass))
    names = (("ixx", 0, 0), ("ixy", 0, 1), ("ixz", 0, 2), ("iyy", 1, 1), ("iyz", 1, 2))
    entries = {name: real(body.inertia[i, j]) for name, i, j in (*names, ("izz", 2, 2))}
    _add(document, inertial, "inertia", 3, **entries)
    old = _children(link, "inertial")
    if old:
        link.replaceChild(inertial, old[0])
    else:
        _place(document, link, inertial, 2)


def _set_joint(document: Document, joint: Element, model: ExportModel, k: int) -> None:
    fit = model.friction[k]
    if fit is not None:
        there = _children(joint, "dynamics")
        dynamics = there[0] if there else _add(document, joint, "dynamics", 2)
        dynamics.setAttribute("damping", real(fit.viscous))
        dynamics.setAttribute("friction", real(fit.coulomb))
    if model.armature[k] > 0.0:
        text = f" seqid: armature {real(model.armature[k])}, not in the inertials "
        _place(document, joint, document.createComment(plain(text)), 2)


def _set_transmission(document: Document, root: Element, model: ExportModel, k: int) -> None:
    """Write rotor inertia and gear ratio into the joint's transmission, made if missing."""
    if model.nearest.rotor[k] <= 0.0:
        return
    name, ratio = model.robot.joint_names[k], abs(float(gear_ratios(model.robot)[k]))
    actuator = _actuator(document, root, name, ratio)
    root.setAttribute("xmlns:drake", _DRAKE)
    for tag, value in (("rotor_inertia", model.nearest.rotor[k]), ("gear_ratio", ratio)):
        for old in _children(actuator, f"drake:{tag}"):
            actuator.removeChild(old)
        _add(document, actuator, f"drake:{tag}", 3, value=real(value))


def _actuator(document: Document, root: Element, joint: str, ratio: float) -> Element:
    """The only actuator of the joint's own transmission, made if missing."""
    for transmission in _children(root, "transmission"):
        names = [element.getAttribute("name") for element in _children(transmission, "joint")]
        actuators = _children(transmission, "actuator")
        if names == [joint] and len(actuators) == 1:
            return actuators[0]
    transmission = document.createElement("transmission")
    transmission.setAttribute("name", f"{joint}_transmission")
    _text_in(document, transmission, "type", "transmission_interface/SimpleTransmission", 2)
    of = _add(document, transmission, "joint", 2, name=joint)
    _text_in(document, of, "hardwareInterface", "hardware_interface/EffortJointInterface", 3)
    actuator = _add(document, transmission, "actuator", 2, name=f"{joint}_motor")
    _text_in(document, actuator, "mechanicalReduction", real(ratio), 3)
    _place(document, root, transmission, 1)
    return actuator


def _add_control(document: Document, root: Element, model: ExportModel) -> None:
    """Add a ros2_control system: effort commands, the identified drive as parameters."""
    system = _add(document, root, "ros2_control", 1, name=model.robot.name, type="system")
    hardware = _add(document, system, "hardware", 2)
    _text_in(document, hardware, "plugin", "mock_components/GenericSystem", 3)
    for k, joint in enumerate(model.robot.joints):
        element = _add(document, system, "joint", 2, name=joint.name)
        _add(document, element, "command_interface", 3, name="effort")
        for name in ("position", "velocity", "effort"):
            _add(document, element, "state_interface", 3, name=name)
        drive, fit = {"armature": model.armature[k]}, model.friction[k]
        if fit is not None:
            drive |= {"coulomb": fit.coulomb, "viscous": fit.viscous}
        for name, value in drive.items():
            _text_in(document, element, "param", real(value), 3).setAttribute("name", name)


def _text_in(document: Document, parent: Element, tag: str, text: str, depth: int = 0) -> Element:
    element = _add(document, parent, tag, depth)
    element.appendChild(document.createTextNode(text))
    return element


def _children(parent: Element, tag: str) -> list[Element]:
    return [node for node in parent.childNodes if isinstance(node, Element) and node.tagName == tag]


def _add(
    document: Document, parent: Element, tag: str, depth: int = 0, /, **attributes: str
) -> Element:
    element = document.createElement(tag)
    for name, value in attributes.items():
        element.setAttribute(name, value)
    _place(document, parent, element, depth)
    return element


def _place(document: Document, parent: Element, node: Element | Comment, depth: int) -> None:
    """Append a node on a line of its own, where the parent is empty or its children have theirs."""
    if depth and parent.lastChild is None:
        parent.appendChild(document.createTextNode("\n" + "  " * (depth - 1)))
    last = parent.lastChild
    if depth and isinstance(last, Text) and last.data.isspace():
        parent.insertBefore(document.createTextNode("\n" + "  " * depth), last)
        parent.insertBefore(node, last)
    else:
        parent.appendChild(node)
