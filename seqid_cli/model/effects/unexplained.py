"""A smooth torque that no effect of the catalogue explains, as it stands in a parameter file.

    tau = f(scene) sum_k c_k B_k(x_1, x_2)

x are one or two quantities (a position, a speed, a load, the time ...), B_k the products of cubic
B-splines over them, held beyond the ends of what was recorded, f is 1, the direction of motion or
the load. It predicts and says nothing of a cause.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import isfinite, prod
from typing import ClassVar, cast

import numpy as np

from seqid_cli.errors import ConfigError
from seqid_cli.model.effects.scene import Scene
from seqid_cli.model.effects.smooth import FACTORS, MEASURES, Axis, Factor, Measure, shape
from seqid_cli.model.effects.units import UNEXPLAINED
from seqid_cli.params.schema import EffectOfJoint, Parameter
from seqid_cli.robot.types import Robot
from seqid_cli.typing import Array

NAME = UNEXPLAINED
MOST_AXES = 2
MOST_KNOTS = 64


@dataclass(frozen=True)
class SmoothTerm:
    """A smooth torque at one joint.

    Attributes
    ----------
    joint : int
        Index of the joint.
    quantities : tuple of str
        What it depends on, as the contract spells it, the strongest first.
    axes : tuple of Axis
    factor : str
        `one`, `direction` or `load`.
    coefficients : (K,) array
        N m (1 with the factor `load`), one per product of the axes' functions.
    """

    name: ClassVar[str] = NAME
    passes: ClassVar[int] = 2

    joint: int
    quantities: tuple[str, ...]
    axes: tuple[Axis, ...]
    factor: Factor
    coefficients: Array

    def torque(self, scene: Scene) -> Array:
        """Torque (N,) N m at the joint, unfiltered; the low-pass is to be applied twice."""
        return shape(scene, self.joint, self.axes, self.factor) @ self.coefficients

    def to_stage(self, robot: Robot) -> EffectOfJoint:
        """Write the term down; its coefficients have no errors."""
        name = robot.joint_names[self.joint]
        settings: dict[str, str | float | int | bool] = {
            "depends_on": " ".join(self.quantities),
            "factor": self.factor,
        }
        for number, axis in enumerate(self.axes, start=1):
            settings[f"axis_{number}"] = axis.measure
            settings[f"axis_{number}_joint"] = robot.joint_names[axis.joint]
            for k, knot in enumerate(axis.knots):
                settings[f"axis_{number}_knot_{k}"] = float(knot)
        unit = robot.joints[self.joint].unit("N m")
        parameters = [
            Parameter(name=f"c_{k}", value=float(c), std_error=0.0, unit=unit, joint=name)
            for k, c in enumerate(self.coefficients)
        ]
        return EffectOfJoint(effect=NAME, joint=name, parameters=parameters, settings=settings)

    @classmethod
    def from_stage(cls, entry: EffectOfJoint, robot: Robot) -> SmoothTerm:
        """Restore a term from a parameter file.

        Raises
        ------
        ConfigError
            If a key is missing or contradicts another; the message names it.
        """
        joint = _joint(robot, "joint", entry.joint)
        settings = entry.settings
        axes = tuple(
            _axis(entry, robot, number)
            for number in range(1, MOST_AXES + 1)
            if f"axis_{number}" in settings
        )
        factor = _choice(entry, "factor", FACTORS)
        size = prod(axis.size for axis in axes)
        if not axes or size != len(entry.parameters):
            raise _damaged(
                entry.joint, "parameters", f"{len(entry.parameters)} coefficients, expected {size}"
            )
        values = np.array([parameter.value for parameter in entry.parameters])
        if not np.all(np.isfinite(values)):
            raise _damaged(entry.joint, "parameters", "a coefficient that is not finite")
        quantities = tuple(str(settings.get("depends_on", "")).split())
        return cls(joint, quantities, axes, cast(Factor, factor), values)


def _axis(entry: EffectOfJoint, robot: Robot, number: int) -> Axis:
    key = f"axis_{number}"
    measure = cast(Measure, _choice(entry, key, MEASURES))
    owner = entry.settings.get(f"{key}_joint")
    joint = _joint(robot, f"{key}_joint", owner if isinstance(owner, str) else None)
    return Axis(measure, joint, _knots(entry, key))


def _knots(entry: EffectOfJoint, key: str) -> tuple[float, ...]:
    found: list[float] = []
    while (name := f"{key}_knot_{len(found)}") in entry.settings:
        value = entry.settings[name]
        if isinstance(value, str) or not isfinite(value) or len(found) == MOST_KNOTS:
            raise _damaged(
                entry.joint, name, f"{value!r}, expected at most {MOST_KNOTS} finite numbers"
            )
        if found and not value > found[-1]:
            raise _damaged(entry.joint, name, f"{value!r}, not above the knot before it")
        found.append(float(value))
    if len(found) < 2:
        raise _damaged(entry.joint, f"{key}_knot_0", f"{len(found)} knots, expected 2 or more")
    return tuple(found)


def _choice(entry: EffectOfJoint, key: str, allowed: tuple[str, ...]) -> str:
    value = entry.settings.get(key)
    if value not in allowed:
        raise _damaged(entry.joint, key, f"{value!r}, expected one of {', '.join(allowed)}")
    return str(value)


def _joint(robot: Robot, key: str, name: str | None) -> int:
    if name not in robot.joint_names:
        raise _damaged(name, key, f"{name!r}, expected one of {', '.join(robot.joint_names)}")
    return robot.joint_names.index(name)


def _damaged(joint: str | None, key: str, problem: str) -> ConfigError:
    return ConfigError(
        f"stages.effects: the unexplained term of joint {joint} has under {key}: {problem}",
        hint="write the parameter file anew with seqid refine",
    )
