"""A self-contained C99 header or numpy module: inverse dynamics and a momentum observer.

The joint torque is that of recursive Newton-Euler, with the numbers inlined. Unlike model files
they keep the whole friction surface and the coupling of rotors.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Sequence
from typing import TYPE_CHECKING

import numpy as np

from seqid_cli.export.text import real, rendered
from seqid_cli.model.friction_basis import FADE
from seqid_cli.robot.base_parameters import gear_ratios
from seqid_cli.robot.types import Array

if TYPE_CHECKING:
    from seqid_cli.export.model import ExportModel
    from seqid_cli.model.friction import FrictionSurface

_NO_LIMIT = 1e300  # N m: no alarm from a joint whose error is not known
_KEYWORDS = frozenset({"auto", "double", "float", "int", "long", "short", "static", "void"})


def c_header(model: ExportModel) -> str:
    """Return the header; its functions and macros start with the robot's name."""
    return rendered("arm.h.jinja", model, **_content(model))


def numpy_module(model: ExportModel) -> str:
    """Return the same as a Python module that needs numpy only."""
    return rendered("arm.py.jinja", model, **_content(model))


def _content(model: ExportModel) -> dict[str, object]:
    chain, robot = model.robot.chain, model.robot
    surfaces = [_surface(surface) for surface in model.surfaces]
    observer = model.observer
    return {
        "name": identifier(robot.name),
        "joints": [
            {
                "name": joint.name.encode("ascii", "replace").decode().replace("?", "."),
                "unit": joint.unit("rad, N m"),
            }
            for joint in robot.joints
        ],
        "n": robot.n,
        "gravity": _row(robot.gravity),
        "rotation": [_row(R.ravel()) for R in chain.rotation],
        "position": [_row(p) for p in chain.position],
        "axis": [_row(axis) for axis in chain.axis],
        "prismatic": ", ".join("1" if slides else "0" for slides in chain.prismatic),
        "phi": [_row(phi) for phi in model.bodies],
        "armature": _row(model.armature),
        "coupled": model.coupling == "gyroscopic" and bool(model.nearest.rotor.any()),
        "coupling": _row(np.where(chain.prismatic, 0.0, gear_ratios(robot) * model.nearest.rotor)),
        "springs": [_row(row) for row in model.effects.springs]
        if model.effects.springs.any()
        else [],
        "surfaces": surfaces,
        "gain": real(observer.gain),
        "limit": _row(np.nan_to_num(observer.limit, posinf=_NO_LIMIT)),
        "stiction": _row(observer.stiction),
        "slow": _row(observer.slow),
    }


def _surface(surface: FrictionSurface | None) -> dict[str, object] | None:
    if surface is None:
        return None
    rows, columns = surface.positive.shape
    scaling = surface.scaling
    backward = surface.negative if surface.directional else surface.positive
    speed = np.array(scaling.speed)
    return {
        "rows": rows,
        "columns": columns,
        "position": _row(scaling.position),
        "periodic": scaling.periodic,
        "mean": _row(scaling.over_position.mean(surface.orders[0])),
        "fade": real(FADE * (scaling.position[1] - scaling.position[0])),
        "slope": _row(surface.slopes_beyond),
        "speed": _row(speed),
        "scaled": _row(np.log(speed) if scaling.logarithmic else speed),
        "logarithmic": int(scaling.logarithmic),
        "sign_width": real(surface.sign_width),
        "forward": _lines(surface.positive),
        "backward": _lines(backward),
    }


def identifier(name: str) -> str:
    """Return a robot's name as a C identifier in small letters."""
    found = re.sub(r"[^a-z0-9]+", "_", name.lower()).strip("_") or "arm"
    return f"arm_{found}" if found[0].isdigit() or found in _KEYWORDS else found


def _row(values: Iterable[float]) -> str:
    return ", ".join(real(value) for value in values)


def _lines(matrix: Array, per_line: int = 4) -> Sequence[str]:
    flat = matrix.ravel()
    return [_row(flat[k : k + per_line]) for k in range(0, len(flat), per_line)]
