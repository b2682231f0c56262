"""MJCF: the arm as MuJoCo simulates it, with rotor inertia as armature.

Bodies are nested like the chain, in the joints' own frames; links behind joints that were not
identified are part of the body that carries them, locked at zero. A spring is the joint's
stiffness (where it is not linear, several numbers, which needs MuJoCo 4), backlash a joint of its
own between two stiff stops. Capsules along the links show the arm, without mass or contact.
"""

import numpy as np

from seqid_cli.export.model import ExportModel
from seqid_cli.export.text import rendered
from seqid_cli.model.bodies.pseudo_inertia import Body
from seqid_cli.typing import Array

_FULL = ([0, 1, 2, 0, 0, 1], [0, 1, 2, 1, 2, 2])  # entries of an inertia in MuJoCo's order


def mjcf(
    model: ExportModel, *, share: float = 0.01, min_length: float = 1e-3, thickness: float = 0.1
) -> str:
    """Return the arm as an MJCF document.

    `share`: of the motor's armature that a link gets which plays; only relative acceleration feels
    it. Links of `min_length` m are drawn, `thickness` of their length thick.
    """
    reach = np.vstack([model.robot.chain.position[1 : model.robot.n], np.zeros(3)])
    lengths = np.linalg.norm(reach, axis=1)
    return rendered(
        "arm.xml.jinja",
        model,
        arm=model.robot,
        chain=model.robot.chain,
        bodies=list(map(Body.of, model.bodies)),
        full=_FULL,
        reach=reach,
        thick=np.where(lengths > min_length, thickness * lengths, 0.0),
        springs=list(map(_spring, model.springs)),
        gaps=np.where(model.armature > 0.0, model.gaps, 0.0),
        share=share,
    )


def _spring(coefficients: Array) -> tuple[Array, float] | None:
    """Stiffness by powers of the way from where a spring is slack, and that position."""
    if not coefficients.any():
        return None
    torque = np.polynomial.Polynomial(coefficients)
    roots = torque.trim().roots()
    slack = float(min(roots, key=lambda root: (abs(root.imag), abs(root))).real)
    moved = torque(np.polynomial.Polynomial([slack, 1.0])).trim()
    return np.asarray(moved.coef[1:], dtype=np.float64), slack
