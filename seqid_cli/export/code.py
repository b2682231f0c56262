"""A self-contained C99 header or numpy module: inverse dynamics and a momentum observer.

The joint torque is that of recursive Newton-Euler, with the numbers inlined. Unlike
model files they keep the whole friction surface, the coupling of rotors and every
effect (`export.laws`).
"""

import re

import numpy as np

from seqid_cli.export.composition import BaseModel, lags_of
from seqid_cli.export.laws import code_of, late_lines
from seqid_cli.export.model import ExportModel
from seqid_cli.export.syntax import Syntax, c99, python
from seqid_cli.export.text import plain, rendered
from seqid_cli.model.friction import FrictionSurface
from seqid_cli.model.friction_basis import FADE
from seqid_cli.robot.base_parameters import gear_ratios

_NO_LIMIT = 1e300  # N m: no alarm from a joint whose error is not known
# Of a deviation, over which the torque is differentiated along it. Central differences
# err by its square, a millionth, and by the rounding of torque over it, 1e-13.
DEVIATION_SHARE = 1e-3
_KEYWORDS = frozenset(
    {"auto", "double", "float", "int", "long", "short", "static", "void"}
)


def c_header(model: ExportModel) -> str:
    """Return the header; its functions and macros start with the robot's name.

    Raises ConfigError if an effect declares no law that code can be written from.
    """
    return rendered(
        "arm.h.jinja", model, **_content(model, c99(identifier(model.robot.name)))
    )


def numpy_module(model: ExportModel) -> str:
    """Return the same as a Python module that needs numpy only."""
    return rendered("arm.py.jinja", model, **_content(model, python()))


def _content(model: ExportModel, syntax: Syntax) -> dict[str, object]:
    robot, chain = model.robot, model.robot.chain
    base = BaseModel.of_model(model.base)
    code = code_of(model.effects, model.base, base, syntax)
    turning = model.coupling == "gyroscopic"
    coupling = np.where(
        chain.prismatic, 0.0, turning * gear_ratios(robot) * model.nearest.rotor
    )
    coupling = coupling + code.rotor
    surfaces = model.base.surfaces
    kelvin = np.array([0.0 if own is None else own.per_kelvin for own in surfaces])
    celsius = [None if own is None else own.temperature for own in surfaces]
    known = np.array([degrees is not None for degrees in celsius])
    kelvin = np.where(known, kelvin, 0.0)
    lines = "".join([*code.instant, *code.session])
    return {
        "name": identifier(robot.name),
        "joints": [
            (plain(joint.name), joint.unit("rad, N m")) for joint in robot.joints
        ],
        "n": robot.n,
        "chain": chain,
        "slides": [int(slides) for slides in chain.prismatic],
        "phi": model.bodies,
        "armature": model.armature,
        "coupling": coupling if coupling.any() else None,
        "surfaces": [
            None if surface is None else _surface(surface) for surface in model.surfaces
        ],
        "observer": model.observer,
        "limit": np.nan_to_num(model.observer.limit, posinf=_NO_LIMIT),
        "base": base,
        "code": code,
        "deviation_share": DEVIATION_SHARE,
        "instant": bool(code.instant or code.waves),
        "signs": "_seqid_sign(" in lines,
        "units": np.eye(robot.n),
        "kelvin": kelvin,
        "celsius": [degrees or 0.0 for degrees in celsius],
        "warm": [
            (j, kelvin[j], celsius[j]) for j in range(robot.n) if kelvin[j] != 0.0
        ],
        "late": late_lines(base, syntax),
        "lags": " and ".join(lags_of(model.effects, base)),
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
        "backward": (
            (surface.negative if surface.directional else surface.positive).ravel()
        ),
    }


def identifier(name: str) -> str:
    """Return a robot's name as a C identifier in small letters."""
    found = re.sub(r"[^a-z0-9]+", "_", name.lower()).strip("_") or "arm"
    return f"arm_{found}" if found[0].isdigit() or found in _KEYWORDS else found
