"""Smooth functions of quantities of the motion: their axes and their bases.

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
from math import inf, isfinite, prod
from typing import ClassVar, Literal, Self, cast, get_args

import numpy as np

from seqid_cli.effects.memory import lagged
from seqid_cli.effects.scene import Scene
from seqid_cli.effects.units import UNEXPLAINED
from seqid_cli.errors import ConfigError
from seqid_cli.model.friction_basis import tensor
from seqid_cli.params.schema import EffectOfJoint, EffectSession, Parameter
from seqid_cli.robot.types import Robot
from seqid_cli.typing import Array

Measure = Literal[
    "position",
    "velocity",
    "speed",
    "recent_speed",
    "acceleration",
    "load",
    "load_size",
    "temperature",
    "time",
    "session_time",
]
Factor = Literal["one", "direction"]
MEASURES: tuple[str, ...] = get_args(Measure)
# What does not follow from the motion around a moment.
NOT_LOCAL = {"temperature", "time", "recent_speed"}
FACTORS: tuple[str, ...] = get_args(Factor)

DEGREE = 3
# Of a term in a parameter file.
MOST_AXES = 2
MOST_KNOTS = 64


@dataclass(frozen=True)
class Axis:
    """One quantity of one joint and the functions over it.

    Attributes
    ----------
    measure : Measure
        The quantity: `speed` and `load_size` are magnitudes, `time` counts from the
        log's start and `session_time` on the clock of all logs. `recent_speed` is the
        speed after a first-order low-pass: what a motion that is just over has warmed,
        or stirred.
    joint : int
        Index of its joint; of no matter for times.
    knots : tuple of float
        Ends of the spline's pieces, ascending, in the unit of the quantity.
    seconds : float
        Time constant of the recent speed [s]; of no matter for others.
    """

    measure: Measure
    joint: int
    knots: tuple[float, ...] = ()
    seconds: float = 0.0

    @property
    def size(self) -> int:
        """Number of functions."""
        return len(self.knots) + DEGREE - 1

    def values(self, scene: Scene) -> Array | None:
        """Return the quantity (N,), None where the scene does not have it."""
        motion = scene.motion
        j = self.joint
        match self.measure:
            case "position":
                return motion.q[:, j]
            case "velocity":
                return motion.dq[:, j]
            case "speed":
                return np.abs(motion.dq[:, j])
            case "recent_speed":
                speed = np.abs(motion.dq[:, [j]])
                return lagged(speed, self.seconds, motion.rate_hz)[:, 0]
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
        """Compute the functions (N, size) of a scene; zero if it lacks the quantity."""
        x = self.values(scene)
        if x is None:
            return np.zeros((scene.samples, self.size))
        return splines(x, self.knots)


def splines(x: Array, knots: Sequence[float]) -> Array:
    """Compute cubic B-splines (N, len(knots) + 2) of x (N,).

    They are held beyond the first and the last knot.
    """
    from scipy.interpolate import BSpline

    unit_coefficients = np.eye(len(knots) + DEGREE - 1)
    held = np.clip(x, knots[0], knots[-1])
    return np.asarray(BSpline(_padded(knots), unit_coefficients, DEGREE)(held))


def greville(knots: Sequence[float]) -> Array:
    """Return the abscissae of the splines' coefficients.

    Coefficients that are linear in them make a straight line.
    """
    mean = np.full(DEGREE, 1.0 / DEGREE)
    return np.convolve(_padded(knots)[1:-1], mean, mode="valid")


def _padded(knots: Sequence[float]) -> Array:
    """Repeat the knots at both ends as often as splines that are held there need."""
    return np.pad(np.asarray(knots, dtype=np.float64), DEGREE, mode="edge")


def shape(scene: Scene, joint: int, axes: Sequence[Axis], factor: Factor) -> Array:
    """Compute the products of the axes' functions, times a factor.

    Parameters
    ----------
    scene : Scene
    joint : int
        Whose direction is the factor `direction`.
    axes : sequence of Axis
    factor : {"one", "direction"}

    Returns
    -------
    Array
        (N, K), unfiltered; K is the product of the axes' sizes, the last runs fastest.
    """
    basis = reduce(tensor, [axis.basis(scene) for axis in axes])
    if factor == "direction":
        return basis * scene.sign[:, joint, None]
    return basis


@dataclass(frozen=True, kw_only=True)
class SmoothTerm:
    """A smooth torque at one joint.

    Attributes
    ----------
    joint : int
    quantities : tuple of str
        What it depends on, as files spell it, the strongest first.
    axes : tuple of Axis
    factor : {"one", "direction"}
    coefficients : Array
        (K,) N m, one per product of the axes' functions.
    session : EffectSession, optional
        The logs that its times are of.
    """

    name: ClassVar[str] = UNEXPLAINED
    passes: ClassVar[int] = 2
    # It was fitted beside friction, gravity and inertia as they are: what it stands
    # for is in their own logs as it is in these stages.
    late: ClassVar[bool] = True

    joint: int
    quantities: tuple[str, ...]
    axes: tuple[Axis, ...]
    factor: Factor
    coefficients: Array
    session: EffectSession | None = None

    @property
    def local(self) -> bool:
        """True if its torque at a moment follows from the motion around it."""
        return not {axis.measure for axis in self.axes} & NOT_LOCAL

    def torques(self, scene: Scene) -> dict[int, Array]:
        """Compute the torque (N,) N m of its joint, unfiltered.

        The low-pass is to be applied twice.
        """
        functions = shape(scene, self.joint, self.axes, self.factor)
        return {self.joint: functions @ self.coefficients}

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
            if axis.measure == "recent_speed":
                settings[f"axis_{number}_seconds"] = axis.seconds
            for k, knot in enumerate(axis.knots):
                settings[f"axis_{number}_knot_{k}"] = float(knot)

        unit = robot.joints[self.joint].unit("N m")
        parameters = [
            Parameter(
                name=f"c_{k}", value=float(c), std_error=0.0, unit=unit, joint=name
            )
            for k, c in enumerate(self.coefficients)
        ]
        return EffectOfJoint(
            effect=UNEXPLAINED,
            joint=name,
            parameters=parameters,
            settings=settings,
            session=self.session,
            late=self.late,
        )

    @classmethod
    def from_stage(
        cls, entry: EffectOfJoint, robot: Robot, key: str = "$.stages.effects"
    ) -> Self:
        """Restore a term from a parameter file.

        Parameters
        ----------
        entry : EffectOfJoint
        robot : Robot
        key : str
            Where the entry stands in the file.

        Raises
        ------
        ConfigError
            A key is missing or contradicts another; the message names it.
        """
        settings = entry.settings
        names = robot.joint_names
        joint = names.index(_member(f"{key}.joint", entry.joint, names))
        factor = _member(f"{key}.settings.factor", settings.get("factor"), FACTORS)
        axes = tuple(
            _axis(key, f"axis_{number}", entry, robot)
            for number in range(1, MOST_AXES + 1)
            if f"axis_{number}" in settings
        )

        size = prod(axis.size for axis in axes)
        coefficients = np.array([parameter.value for parameter in entry.parameters])
        if not axes or size != len(coefficients):
            problem = f"has {len(coefficients)} coefficients, expected {size}"
            raise damaged(f"{key}.parameters", problem)
        if not np.all(np.isfinite(coefficients)):
            raise damaged(f"{key}.parameters", "has a coefficient that is not finite")
        return cls(
            joint=joint,
            quantities=tuple(str(settings.get("depends_on", "")).split()),
            axes=axes,
            factor=cast(Factor, factor),
            coefficients=coefficients,
            session=entry.session,
        )


def _axis(key: str, name: str, entry: EffectOfJoint, robot: Robot) -> Axis:
    """Restore the axis `name` of a term that stands under `key` in a parameter file."""
    settings = entry.settings
    measure = _member(f"{key}.settings.{name}", settings[name], MEASURES)
    joint_key = f"{name}_joint"
    joint_name = _member(
        f"{key}.settings.{joint_key}", settings.get(joint_key), robot.joint_names
    )

    knot_keys = (f"{name}_knot_{k}" for k in range(MOST_KNOTS + 1))
    in_file = [settings[knot] for knot in takewhile(settings.__contains__, knot_keys)]
    knots = [float(x) for x in in_file if not isinstance(x, str) and isfinite(x)]
    are_numbers = len(knots) == len(in_file)
    ascend = all(low < high for low, high in pairwise(knots))
    if not (are_numbers and ascend and 2 <= len(knots) <= MOST_KNOTS):
        problem = (
            f"must be 2 to {MOST_KNOTS} finite numbers in ascending order, is {in_file}"
        )
        raise damaged(f"{key}.settings.{name}_knot", problem)
    joint = robot.joint_names.index(joint_name)
    seconds = 0.0
    if measure == "recent_speed":
        seconds = _seconds(f"{key}.settings.{name}", settings.get(f"{name}_seconds"))
    return Axis(cast(Measure, measure), joint, tuple(knots), seconds)


def _seconds(key: str, value: object) -> float:
    """Return a time constant [s] that must be a positive number."""
    if isinstance(value, int | float) and 0.0 < value < inf:
        return float(value)
    raise damaged(f"{key}_seconds", f"must be a positive number, is {value!r}")


def _member(key: str, value: object, allowed: Sequence[str]) -> str:
    """Return a value that must be one of the texts allowed under a key."""
    if value not in allowed:
        raise damaged(key, f"must be one of {', '.join(allowed)}, is {value!r}")
    return str(value)


def damaged(key: str, problem: str) -> ConfigError:
    """Make the error of a file that has under `key` what this program never writes."""
    hint = "The file was edited or damaged: run seqid refine again, which wrote it."
    return ConfigError(f"{key}: {problem}", hint=hint)
