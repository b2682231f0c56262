"""A self-contained C99 header or numpy module: inverse dynamics and a momentum observer.

The joint torque is that of recursive Newton-Euler, with the numbers inlined. Unlike model files
they keep the whole friction surface and the coupling of rotors.
"""

import re

import numpy as np

from seqid_cli.export.model import ExportModel
from seqid_cli.export.text import plain, rendered
from seqid_cli.model.friction import FrictionSurface
from seqid_cli.model.friction_basis import FADE
from seqid_cli.robot.base_parameters import gear_ratios

_NO_LIMIT = 1e300  # N m: no alarm from a joint whose error is not known
_KEYWORDS = frozenset({"auto", "double", "float", "int", "long", "short", "static", "void"})


def c_header(model: ExportModel) -> str:
    """Return the header; its functions and macros start with the robot's name."""
    return rendered("arm.h.jinja", model, **_content(model))


def numpy_module(model: ExportModel) -> str:
    """Return the same as a Python module that needs numpy only."""
    return rendered("arm.py.jinja", model, **_content(model))


def _content(model: ExportModel) -> dict[str, object]:
    robot, chain = model.robot, model.robot.chain
    coupled = model.coupling == "gyroscopic" and model.nearest.rotor.any()
    coupling = np.where(chain.prismatic, 0.0, gear_ratios(robot) * model.nearest.rotor)
    return {
        "name": identifier(robot.name),
        "joints": [(plain(joint.name), joint.unit("rad, N m")) for joint in robot.joints],
        "n": robot.n,
        "chain": chain,
        "slides": [int(slides) for slides in chain.prismatic],
        "phi": model.bodies,
        "armature": model.armature,
        "coupling": coupling if coupled else None,
        "springs": model.springs if model.springs.any() else None,
        "surfaces": [None if surface is None else _surface(surface) for surface in model.surfaces],
        "observer": model.observer,
        "limit": np.nan_to_num(model.observer.limit, posinf=_NO_LIMIT),
    }


def _surface(surface: FrictionSurface) -> dict[str, object]:
    scaling, (rows, columns) = surface.scaling, surface.positive.shape
    speed, (low, high) = np.array(scaling.speed), scaling.position
    return {
        "rows": rows,
        "columns": columns,
        "scaling": scaling,
        "mean": scaling.over_position.mean(surface.orders[0]),
        "fade": FADE * (high - low),
        "slope": np.resize(np.maximum(surface.slopes, 0.0), 2),
        "scaled": np.log(speed) if scaling.logarithmic else speed,
        "sign_width": surface.sign_width,
        "forward": surface.positive.ravel(),
        "backward": (surface.negative if surface.directional else surface.positive).ravel(),
    }


def identifier(name: str) -> str:
    """Return a robot's name as a C identifier in small letters."""
    found = re.sub(r"[^a-z0-9]+", "_", name.lower()).strip("_") or "arm"
    return f"arm_{found}" if found[0].isdigit() or found in _KEYWORDS else found
