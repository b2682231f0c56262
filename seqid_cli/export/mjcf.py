"""MJCF: the arm as MuJoCo simulates it, with rotor inertia as armature.

Bodies are nested like the chain, in the joints' own frames; links behind joints that were not
identified are part of the body that carries them, locked at zero. Capsules along the links show the
arm; they have no mass and touch nothing.
"""

from __future__ import annotations

from xml.etree import ElementTree
from xml.etree.ElementTree import Element, SubElement

import numpy as np

from seqid_cli.export.model import ExportModel
from seqid_cli.export.text import real, reals, remarks
from seqid_cli.model.bodies.pseudo_inertia import Body
from seqid_cli.robot.types import Array


def mjcf_of_chain(model: ExportModel) -> str:
    """Return the arm as an MJCF document."""
    root = Element("mujoco", model=model.robot.name)
    text = "\n".join(f"    {line}" for line in remarks(model))
    root.append(ElementTree.Comment(f"\n{text}\n  "))
    SubElement(root, "compiler", angle="radian", autolimits="true", inertiafromgeom="false")
    SubElement(root, "option", gravity=reals(model.robot.gravity), integrator="implicitfast")
    parent = SubElement(root, "worldbody")
    for k in range(model.robot.n):
        parent = _body(parent, model, k)
    actuators = SubElement(root, "actuator")
    for name in model.robot.joint_names:
        SubElement(actuators, "motor", name=f"{name}_motor", joint=name)
    ElementTree.indent(root)
    return ElementTree.tostring(root, encoding="unicode") + "\n"


def _body(parent: Element, model: ExportModel, k: int, *, min_length: float = 1e-3) -> Element:
    chain, joint = model.robot.chain, model.robot.joints[k]
    axes = np.concatenate([chain.rotation[k][:, 0], chain.rotation[k][:, 1]])
    body = SubElement(
        parent, "body", name=f"{joint.name}_link", pos=reals(chain.position[k]), xyaxes=reals(axes)
    )
    _inertial(body, model.bodies[k])
    body.append(Element("joint", _joint(model, k)))
    if k + 1 < chain.n and float(np.linalg.norm(chain.position[k + 1])) > min_length:
        _capsule(body, chain.position[k + 1])
    return body


def _inertial(body: Element, phi: Array) -> None:
    solid = Body.of(phi)
    index = ((0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2))
    full = reals(float(solid.inertia[i, j]) for i, j in index)
    SubElement(body, "inertial", pos=reals(solid.center), mass=real(solid.mass), fullinertia=full)


def _joint(model: ExportModel, k: int) -> dict[str, str]:
    joint, fit = model.robot.joints[k], model.friction[k]
    values: dict[str, str] = {
        "name": joint.name,
        "type": "slide" if joint.prismatic else "hinge",
        "axis": reals(model.robot.chain.axis[k]),
        "armature": real(model.armature[k]),
    }
    if fit is not None:
        values |= {"damping": real(fit.viscous), "frictionloss": real(fit.coulomb)}
    if joint.position_limits is not None:
        values["range"] = reals(joint.position_limits)
    return values


def _capsule(body: Element, reach: Array, *, thickness: float = 0.1) -> None:
    SubElement(
        body,
        "geom",
        type="capsule",
        fromto=reals([0.0, 0.0, 0.0, *reach]),
        size=real(thickness * float(np.linalg.norm(reach))),
        contype="0",
        conaffinity="0",
        mass="0",
    )
