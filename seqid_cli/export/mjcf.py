"""MJCF: the arm as MuJoCo simulates it, with rotor inertia as armature.

Bodies are nested like the chain, in the joints' own frames; links behind joints that were not
identified are part of the body that carries them, locked at zero. A spring is the joint's
stiffness (where it is not linear, several numbers, which needs MuJoCo 4), backlash a joint of its
own. Capsules along the links show the arm; they have no mass and touch nothing.
"""

import numpy as np

from seqid_cli.export.model import ExportModel
from seqid_cli.export.text import real, reals, rendered
from seqid_cli.model.bodies.pseudo_inertia import Body

_FULL = ([0, 1, 2, 0, 0, 1], [0, 1, 2, 1, 2, 2])  # entries of an inertia in MuJoCo's order


def mjcf(model: ExportModel) -> str:
    """Return the arm as an MJCF document."""
    bodies = [_body(model, k) for k in range(model.robot.n)]
    return rendered("arm.xml.jinja", model, name=model.robot.name, bodies=bodies)


def _body(
    model: ExportModel, k: int, *, min_length: float = 1e-3, thickness: float = 0.1
) -> dict[str, object]:
    """The attributes of a body's elements; the next body lies in it."""
    chain, solid = model.robot.chain, Body.of(model.bodies[k])
    reach = chain.position[k + 1] if k + 1 < chain.n else np.zeros(3)
    length = float(np.linalg.norm(reach))
    plays = model.gaps[k] > 0.0 and model.armature[k] > 0.0
    return {
        "place": {
            "name": f"{model.robot.joint_names[k]}_link",
            "pos": reals(chain.position[k]),
            "xyaxes": reals(chain.rotation[k][:, :2].T.ravel()),
        },
        "inertial": {
            "pos": reals(solid.center),
            "mass": real(solid.mass),
            "fullinertia": reals(solid.inertia[_FULL]),
        },
        "joints": [_joint(model, k), *([_gap(model, k)] if plays else [])],
        "capsule": {"fromto": reals([0.0, 0.0, 0.0, *reach]), "size": real(thickness * length)}
        if length > min_length
        else None,
    }


def _joint(model: ExportModel, k: int) -> dict[str, str]:
    joint, fit = model.robot.joints[k], model.friction[k]
    values: dict[str, str] = {
        "name": joint.name,
        **_axis(model, k),
        "armature": real(model.armature[k]),
    }
    if fit is not None:
        values |= {"damping": real(fit.viscous), "frictionloss": real(fit.coulomb)}
    if joint.position_limits is not None:
        values["range"] = reals(joint.position_limits)
    if model.springs[k].any():  # stiffness by powers of the way from where the spring is slack
        torque = np.polynomial.Polynomial(model.springs[k])
        roots = torque.trim().roots()
        slack = float(min(roots, key=lambda root: (abs(root.imag), abs(root))).real)
        moved = torque(np.polynomial.Polynomial([slack, 1.0])).trim().coef
        values |= {"stiffness": reals(moved[1:]), "springref": real(slack)}
    return values


def _gap(model: ExportModel, k: int, *, share: float = 0.01) -> dict[str, str]:
    """Backlash: the link's joint behind the motor's, free between two stiff stops.

    It gets a `share` of the motor's armature, which only relative acceleration feels.
    """
    half = 0.5 * model.gaps[k]
    return {
        "name": f"{model.robot.joint_names[k]}_backlash",
        **_axis(model, k),
        "armature": real(share * model.armature[k]),
        "range": reals([-half, half]),
        "solreflimit": "0.004 1",
        "solimplimit": "0.99 0.999 0.0001",
    }


def _axis(model: ExportModel, k: int) -> dict[str, str]:
    kind = "slide" if model.robot.joints[k].prismatic else "hinge"
    return {"type": kind, "axis": reals(model.robot.chain.axis[k])}
