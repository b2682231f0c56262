"""A C99 header or numpy module that needs nothing else: dynamics and an observer.

The joint torque is that of recursive Newton-Euler, with the numbers inlined; the
observer is one of momentum. Unlike model files they keep the whole friction surface,
the coupling of rotors and every effect (`export.laws`).
"""

import re
from dataclasses import dataclass
from typing import Self

import numpy as np

from seqid_cli.export.composition import BaseModel, lags_of
from seqid_cli.export.laws import code_of, late_lines
from seqid_cli.export.model import ExportModel
from seqid_cli.export.syntax import Syntax, c99, python
from seqid_cli.export.text import plain, rendered
from seqid_cli.model.friction import FrictionSurface
from seqid_cli.position_families import FAMILIES
from seqid_cli.robot.base_parameters import gear_ratios
from seqid_cli.typing import Array

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
    content = _content(model, c99(identifier(model.robot.name)))
    return rendered("arm.h.jinja", model, snippets=_position_snippets(), **content)


def numpy_module(model: ExportModel) -> str:
    """Return the same as a Python module that needs numpy only."""
    content = _content(model, python())
    return rendered("arm.py.jinja", model, snippets=_position_snippets(), **content)


def _position_snippets() -> dict[str, str]:
    """Return the text of every family over position, by kind and name."""
    snippets = {}
    for family in FAMILIES:
        snippets[f"c_function/{family.name}"] = family.c_function
        snippets[f"c_columns/{family.name}"] = family.c_columns
        snippets[f"python_columns/{family.name}"] = family.python_columns
    return snippets


def _content(model: ExportModel, syntax: Syntax) -> dict[str, object]:
    """Return what the templates of both languages are filled in with."""
    robot = model.robot
    base = BaseModel.of_model(model.base)
    code = code_of(model.effects, model.base, base, syntax)
    coupling = _coupling(model) + code.rotor
    warmth = [_Warmth.of(surface) for surface in model.base.surfaces]
    lines = "".join([*code.instant, *code.session])

    return {
        "name": identifier(robot.name),
        "joints": [
            (plain(joint.name), joint.unit("rad, N m")) for joint in robot.joints
        ],
        "n": robot.n,
        "chain": robot.chain,
        "families": FAMILIES,
        "slides": [int(slides) for slides in robot.chain.prismatic],
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
        "kelvin": [warm.per_kelvin for warm in warmth],
        "celsius": [warm.celsius for warm in warmth],
        "warm": [
            (j, warm.per_kelvin, warm.celsius)
            for j, warm in enumerate(warmth)
            if warm.per_kelvin != 0.0
        ],
        "late": late_lines(base, syntax),
        "lags": " and ".join(lags_of(model.effects, base)),
    }


def _coupling(model: ExportModel) -> Array:
    """Return gear ratio times rotor inertia (n,) kg m^2 where rotors turn the links."""
    robot = model.robot
    if model.coupling != "gyroscopic":
        return np.zeros(robot.n)
    turned = gear_ratios(robot) * model.nearest.rotor
    return np.where(robot.chain.prismatic, 0.0, turned)


@dataclass(frozen=True)
class _Warmth:
    """Change of a joint's friction per kelvin, as a share, from a temperature on."""

    per_kelvin: float
    celsius: float

    @classmethod
    def of(cls, surface: FrictionSurface | None) -> Self:
        """Return the warmth of a surface; none where its temperature is not known."""
        if surface is None or surface.temperature is None:
            return cls(per_kelvin=0.0, celsius=0.0)
        return cls(per_kelvin=surface.per_kelvin, celsius=surface.temperature)


def _surface(surface: FrictionSurface) -> dict[str, object]:
    """Return what the templates say of a joint's friction."""
    scaling = surface.scaling
    rows, columns = surface.positive.shape
    speed = np.array(scaling.speed)
    backward = surface.negative if surface.directional else surface.positive
    return {
        "rows": rows,
        "columns": columns,
        "scaling": scaling,
        "mean": scaling.over_position.mean(surface.orders[0]),
        "fade": scaling.over_position.fade_width,
        "slope": np.resize(np.maximum(surface.slopes, 0.0), 2),
        "scaled": np.log(speed) if scaling.logarithmic else speed,
        "sign_width": surface.sign_width,
        "forward": surface.positive.ravel(),
        "backward": backward.ravel(),
    }


def identifier(name: str) -> str:
    """Return a robot's name as a C identifier in small letters."""
    words = re.sub(r"[^a-z0-9]+", "_", name.lower()).strip("_") or "arm"
    if words[0].isdigit() or words in _KEYWORDS:
        return f"arm_{words}"
    return words
