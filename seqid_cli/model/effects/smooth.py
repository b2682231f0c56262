"""Smooth functions of what a motion says: the axes that they are drawn over and their bases.

An axis takes one number per sample from a scene and spreads it over a few functions: cubic
B-splines between knots, held at the ends. A shape is the product of one or two axes, times a
factor (1, the direction).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import reduce
from typing import Literal, get_args

import numpy as np
from scipy.interpolate import BSpline

from seqid_cli.model.effects.scene import Scene
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


@dataclass(frozen=True)
class Axis:
    """One quantity of one joint and the functions over it.

    Attributes
    ----------
    measure : str
        What is taken; `speed` and `load_size` are magnitudes, `time` counts from the log's start
        and `session_time` on the clock of all logs.
    joint : int
        Whose it is (of no matter for times).
    knots : tuple of float
        Ends of the spline's pieces, ascending, in the measure's unit.
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
        if x is None:
            return np.zeros((scene.samples, self.size))
        return splines(x, self.knots)


def splines(x: Array, knots: Sequence[float]) -> Array:
    """Cubic B-splines (N, len(knots) + 2) of x (N,), held beyond the first and the last knot."""
    inner = np.asarray(knots, dtype=np.float64)
    full = np.concatenate([np.repeat(inner[0], DEGREE), inner, np.repeat(inner[-1], DEGREE)])
    held = np.clip(x, inner[0], inner[-1])
    each = np.eye(len(inner) + DEGREE - 1)
    basis: Array = BSpline(full, each, DEGREE)(held)
    return basis


def greville(knots: Sequence[float]) -> Array:
    """Abscissae of the splines' coefficients: coefficients linear in them make a straight line."""
    inner = np.asarray(knots, dtype=np.float64)
    full = np.concatenate([np.repeat(inner[0], DEGREE), inner, np.repeat(inner[-1], DEGREE)])
    return np.array([full[i + 1 : i + 1 + DEGREE].mean() for i in range(len(inner) + DEGREE - 1)])


def shape(scene: Scene, joint: int, axes: Sequence[Axis], factor: Factor) -> Array:
    """Compute the products of the axes' functions times the factor.

    Parameters
    ----------
    scene : Scene
    joint : int
        Whose direction is the factor.
    axes : sequence of Axis
    factor : str
        `one` or `direction`.

    Returns
    -------
    (N, product of the axes' sizes) array
        Unfiltered; the last axis runs fastest.
    """
    basis = reduce(row_product, [axis.basis(scene) for axis in axes])
    if factor == "direction":
        return basis * scene.sign[:, joint, None]
    return basis


def row_product(A: Array, B: Array) -> Array:
    """Products (N, a b) of the functions A (N, a) and B (N, b); those of B run fastest."""
    product: Array = (A[:, :, None] * B[:, None, :]).reshape(len(A), -1)
    return product
