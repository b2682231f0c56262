"""Smooth functions of what a motion says: the axes that they are drawn over and their bases.

An axis takes one number per sample from a scene and spreads it over a few functions:
cubic B-splines between knots, held at the ends. A shape is the product of one or two
axes, times a factor (1, the direction). A smooth term is a torque that no effect of the
catalogue explains, as it stands in a parameter file,

    tau = f(scene) sum_k c_k B_k(x_1, x_2);

it predicts and says nothing of a cause.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import reduce
from itertools import pairwise, takewhile
from math import isfinite, prod
from typing import ClassVar, Literal, Self, cast, get_args

import numpy as np
from scipy.interpolate import BSpline

from seqid_cli.errors import ConfigError
from seqid_cli.model.effects.scene import Scene
from seqid_cli.model.effects.units import UNEXPLAINED
from seqid_cli.model.friction_basis import tensor
from seqid_cli.params.schema import EffectOfJoint, EffectSession, Parameter
from seqid_cli.robot.types import Robot
from seqid_cli.typing import Array

Measure = Literal[
    "position",
    "velocity",
    "speed",
    "acceleration",
    "load",
    "load_size",
    "temperature",
    "time",
    "session_time",
]
Factor = Literal["one", "direction"]
MEASURES: tuple[str, ...] = get_args(Measure)
FACTORS: tuple[str, ...] = get_args(Factor)

DEGREE = 3
MOST_AXES, MOST_KNOTS = 2, 64


@dataclass(frozen=True)
class Axis:
    """One quantity of one joint and the functions over it.

    `measure` says what is taken: `speed` and `load_size` are magnitudes, `time` counts
    from the log's start and `session_time` on the clock of all logs. `joint` is whose
    it is (of no matter for times), `knots` are the ends of the spline's pieces,
    ascending, in the measure's unit.
    """

    measure: Measure
    joint: int
    knots: tuple[float, ...] = ()

    @property
    def size(self) -> int:
        """Number of functions."""
        return len(self.knots) + DEGREE - 1

    def values(self, scene: Scene) -> Array | None:
        """Return the quantity (N,), None where the scene does not have it."""
        motion, j = scene.motion, self.joint
        match self.measure:
            case "position":
                return motion.q[:, j]
            case "velocity":
                return motion.dq[:, j]
            case "speed":
                return np.abs(motion.dq[:, j])
            case "acceleration":
                return motion.ddq[:, j]
            case "load":
                return scene.load[:, j]
            case "load_size":
                return np.abs(scene.load[:, j])
            case "temperature":
                return None if scene.temperature is None else scene.temperature[:, j]
            case "time":
                return motion.t - float(motion.t[0])
            case "session_time":
                return scene.time if scene.shared_clock else None

    def basis(self, scene: Scene) -> Array:
        """Compute the functions (N, size) of a scene; zero where it lacks the quantity."""
        x = self.values(scene)
        return (
            np.zeros((scene.samples, self.size))
            if x is None
            else splines(x, self.knots)
        )


def splines(x: Array, knots: Sequence[float]) -> Array:
    """Cubic B-splines (N, len(knots) + 2) of x (N,), held beyond the first and the last knot."""
    each, held = np.eye(len(knots) + DEGREE - 1), np.clip(x, knots[0], knots[-1])
    return np.asarray(BSpline(_padded(knots), each, DEGREE)(held))


def greville(knots: Sequence[float]) -> Array:
    """Abscissae of the splines' coefficients: coefficients linear in them make a straight line."""
    return np.convolve(
        _padded(knots)[1:-1], np.full(DEGREE, 1.0 / DEGREE), mode="valid"
    )


def _padded(knots: Sequence[float]) -> Array:
    """The knots with both ends as often as splines that are held there take them."""
    return np.pad(np.asarray(knots, dtype=np.float64), DEGREE, mode="edge")


def shape(scene: Scene, joint: int, axes: Sequence[Axis], factor: Factor) -> Array:
    """Products (N, K) of the axes' functions times the factor, `one` or the joint's `direction`.

    Unfiltered; K is the product of the axes' sizes, of which the last one runs fastest.
    """
    basis = reduce(tensor, [axis.basis(scene) for axis in axes])
    return basis * scene.sign[:, joint, None] if factor == "direction" else basis


@dataclass(frozen=True)
class SmoothTerm:
    """A smooth torque at one joint.

    `quantities` are what it depends on, as the contract spells it, the strongest first.
    `coefficients` (K,) N m, one per product of the axes' functions, times a factor:
    `one` or the `direction`. `session` says which logs its times are of.
    """

    name: ClassVar[str] = UNEXPLAINED
    passes: ClassVar[int] = 2

    joint: int
    quantities: tuple[str, ...]
    axes: tuple[Axis, ...]
    factor: Factor
    coefficients: Array
    session: EffectSession | None = None

    @property
    def local(self) -> bool:
        """Whether its torque at a moment follows from the motion around it."""
        return not {axis.measure for axis in self.axes} & {"temperature", "time"}

    def torques(self, scene: Scene) -> dict[int, Array]:
        """Torque (N,) N m of its joint, unfiltered; the low-pass is to be applied twice."""
        return {
            self.joint: (
                shape(scene, self.joint, self.axes, self.factor) @ self.coefficients
            )
        }

    def to_stage(self, robot: Robot) -> EffectOfJoint:
        """Write the term down; its coefficients have no errors."""
        name = robot.joint_names[self.joint]
        settings: dict[str, str | float | int | bool]
        settings = {"depends_on": " ".join(self.quantities), "factor": self.factor}
        for number, axis in enumerate(self.axes, start=1):
            settings[f"axis_{number}"] = axis.measure
            settings[f"axis_{number}_joint"] = robot.joint_names[axis.joint]
            for k, knot in enumerate(axis.knots):
                settings[f"axis_{number}_knot_{k}"] = float(knot)
        unit = robot.joints[self.joint].unit("N m")
        terms = [
            Parameter(
                name=f"c_{k}", value=float(c), std_error=0.0, unit=unit, joint=name
            )
            for k, c in enumerate(self.coefficients)
        ]
        return EffectOfJoint(
            effect=UNEXPLAINED, joint=name, parameters=terms, settings=settings
        )

    @classmethod
    def from_stage(
        cls, entry: EffectOfJoint, robot: Robot, key: str = "$.stages.effects"
    ) -> Self:
        """Restore a term from a parameter file, in which its entry stands under `key`.

        Raises ConfigError if a key is missing or contradicts another; the message names
        it.
        """
        settings, names = entry.settings, robot.joint_names

        def one_of(name: str, value: object, known: Sequence[str]) -> str:
            if value not in known:
                raise damaged(
                    f"{key}.{name}", f"must be one of {', '.join(known)}, is {value!r}"
                )
            return str(value)

        def axis(name: str) -> Axis:
            measure = one_of(f"settings.{name}", settings[name], MEASURES)
            owner = one_of(
                f"settings.{name}_joint", settings.get(f"{name}_joint"), names
            )
            every = (f"{name}_knot_{k}" for k in range(MOST_KNOTS + 1))
            found = [settings[knot] for knot in takewhile(settings.__contains__, every)]
            numbers = [
                float(x) for x in found if not isinstance(x, str) and isfinite(x)
            ]
            ascending = all(low < high for low, high in pairwise(numbers))
            if not (2 <= len(numbers) == len(found) <= MOST_KNOTS and ascending):
                what = (
                    f"must be 2 to {MOST_KNOTS} finite numbers in ascending order, is"
                    f" {found}"
                )
                raise damaged(f"{key}.settings.{name}_knot", what)
            return Axis(cast(Measure, measure), names.index(owner), tuple(numbers))

        joint = names.index(one_of("joint", entry.joint, names))
        factor = one_of("settings.factor", settings.get("factor"), FACTORS)
        known = (f"axis_{number}" for number in range(1, MOST_AXES + 1))
        axes = tuple(axis(name) for name in known if name in settings)
        size = prod(axis.size for axis in axes)
        values = np.array([parameter.value for parameter in entry.parameters])
        if not axes or size != len(values):
            raise damaged(
                f"{key}.parameters", f"has {len(values)} coefficients, expected {size}"
            )
        if not np.all(np.isfinite(values)):
            raise damaged(f"{key}.parameters", "has a coefficient that is not finite")
        quantities = tuple(str(settings.get("depends_on", "")).split())
        return cls(joint, quantities, axes, cast(Factor, factor), values, entry.session)


def damaged(key: str, what: str) -> ConfigError:
    """What a parameter file says under `key` is nothing that this program wrote."""
    hint = "The file was edited or damaged: run seqid refine again, which wrote it."
    return ConfigError(f"{key}: {what}", hint=hint)
