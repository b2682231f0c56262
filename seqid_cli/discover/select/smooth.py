"""Smooth functions of one or two quantities: rivals of the catalogue's effects.

Splines are held beyond what more than one fold of the rows has seen, and combined so
that each bends more than the one before (eigenvectors of the second differences,
Demmler and Reinsch 1975), the constant first: not every base has an offset.
"""

from dataclasses import dataclass
from functools import reduce

import numpy as np
from scipy.linalg import eigh

from seqid_cli.discover.survey.rows import Rows
from seqid_cli.model.effects.scene import Scene
from seqid_cli.model.effects.smooth import (
    Axis,
    Factor,
    Measure,
    SmoothTerm,
    greville,
    shape,
    splines,
)
from seqid_cli.model.friction_basis import tensor
from seqid_cli.typing import Array, Index

# share of the rows beyond the first knot (and the last), whatever fold is left out
EDGE = 0.01
STILL = 1e-9  # range of a quantity, relative to its size, below which it has not moved
RIDGE = 1e-6  # of the splines' mean square: for pieces that hold no rows
SLOW = {"position", "velocity", "temperature", "time", "session_time"}
SIZE = 12  # functions of one quantity, the constant among them
TENSOR_SIZE = 6  # the same per quantity of a product


@dataclass(frozen=True, eq=False)
class SmoothFunction:
    """A smooth function that might be what the residual of a joint is."""

    joint: int
    # as the contract spells them, the strongest meaning first
    quantities: tuple[str, ...]
    label: str  # the same in words
    # functions of these and `factor` (see `model.effects.smooth.shape`)
    axes: tuple[Axis, ...]
    factor: Factor
    mixing: Array  # (K, k) combinations of them

    @property
    def size(self) -> int:
        """Number of columns."""
        return int(self.mixing.shape[1])

    def columns(self, rows: Rows) -> Array:
        """Compute the columns (M, k) on the joint's rows.

        Functions of what is slow beside the low-pass pass it as they are: only the
        direction has steps. Low-passed one by one, they cost as much as all effects.
        """
        j, scenes = self.joint, rows.scenes
        if not {axis.measure for axis in self.axes} <= SLOW:
            whole = ({j: shape(scene, j, self.axes, self.factor)} for scene in scenes)
            return rows.columns(whole, passes=2)[j] @ self.mixing
        values = [
            [v for x in scenes if (v := axis.values(x)) is not None]
            for axis in self.axes
        ]
        every = zip(values, self.axes, strict=True)
        basis = reduce(
            tensor, [splines(rows.of(j, v), axis.knots) for v, axis in every]
        )
        if self.factor == "direction":
            sign = [s.motion.filtered(s.sign[:, [j]], times=2) for s in scenes]
            basis = basis * rows.of(j, sign)
        return rows.whitened(j, basis @ self.mixing)

    def torques(self, scene: Scene, c: Array) -> dict[int, Array]:
        """Torque (N,) N m of coefficients c (k,) by joint, low-passed."""
        torque = shape(scene, self.joint, self.axes, self.factor) @ (self.mixing @ c)
        return {self.joint: scene.motion.filtered(torque, times=2)}

    def fitted(self, c: Array) -> SmoothTerm:
        """Return the term of coefficients c (k,)."""
        return SmoothTerm(
            self.joint, self.quantities, self.axes, self.factor, self.mixing @ c
        )


def smooth_functions(rows: Rows, joint: int) -> list[SmoothFunction]:
    """Return functions of everything measured, of one quantity each, for a joint's torque."""
    own: tuple[Measure, ...] = (
        "position",
        "velocity",
        "acceleration",
        "load",
        "temperature",
    )
    every: list[tuple[Measure, int, tuple[str, ...], str]]
    every = [(measure, joint, (measure,), measure) for measure in own]
    sided: tuple[Measure, ...] = ("position", "load_size", "speed", "temperature")
    names = ("position", "load", "velocity", "temperature")
    for measure, name in zip(sided, names, strict=True):
        every.append((measure, joint, (name, "direction"), f"{name} x direction"))
    for k, name in enumerate(rows.scenes[0].robot.joint_names):
        if k != joint:
            other = f"other_joint:{name}"
            every += [(m, k, (other,), f"{m} of {name}") for m in own[:3]]
            # rubs more where another joint stands, as rails do that are not parallel
            label = f"position of {name} x direction"
            every.append(("position", k, (other, "direction"), label))
    clocks: list[tuple[Measure, str]] = [("time", "time since the log's start")]
    clocks += [("session_time", "time of all logs")] if len(rows.scenes) > 1 else []
    for measure, label in clocks:
        every.append((measure, joint, ("time",), label))
        every.append((measure, joint, ("time", "direction"), f"{label} x direction"))
    return [found for one in every if (found := _smooth(rows, joint, *one)) is not None]


def _smooth(
    rows: Rows,
    joint: int,
    measure: Measure,
    owner: int,
    quantities: tuple[str, ...],
    label: str,
) -> SmoothFunction | None:
    """A function of one quantity; none where that is not known or constant."""
    axis, x = _axis(rows, joint, measure, owner, SIZE - 1)
    if axis is None:
        return None
    factor: Factor = "direction" if "direction" in quantities else "one"
    mixing = smoothest(splines(x, axis.knots), greville(axis.knots))[:, :SIZE]
    return SmoothFunction(joint, quantities, label, (axis,), factor, mixing)


def _axis(
    rows: Rows, joint: int, measure: Measure, owner: int, size: int
) -> tuple[Axis | None, Array]:
    """Axis with `size` + 1 splines over the joint's rows, and the quantity there."""
    bare = Axis(measure, owner)
    known = [v for scene in rows.scenes if (v := bare.values(scene)) is not None]
    if len(known) < len(rows.scenes):
        return None, np.zeros(0)
    x = rows.of(joint, known)
    knots = knots_of(x, rows.fold[rows.blocks_of(joint)], size - 1)
    return (None if knots is None else Axis(measure, owner, knots)), x


def smooth_products(rows: Rows, j: int) -> list[SmoothFunction]:
    """Return functions of a joint's and another's position, and of both velocities."""
    names, found = rows.scenes[0].robot.joint_names, []
    measures: tuple[Measure, ...] = ("position", "velocity")
    for measure in measures:
        own, x = _axis(rows, j, measure, j, TENSOR_SIZE - 1)
        for k in range(rows.n):
            other, z = _axis(rows, j, measure, k, TENSOR_SIZE - 1)
            if k == j or own is None or other is None:
                continue
            U = smoothest(splines(x, own.knots), greville(own.knots))
            V = smoothest(splines(z, other.knots), greville(other.knots))
            told = (
                (measure, f"other_joint:{names[k]}"),
                f"{measure} and that of {names[k]}",
            )
            mixing = np.asarray(np.kron(U[:, :TENSOR_SIZE], V[:, :TENSOR_SIZE]))
            found.append(SmoothFunction(j, *told, (own, other), "one", mixing))
    return found


def knots_of(x: Array, fold: Index, count: int) -> tuple[float, ...] | None:
    """Knots half way between equal steps and equal shares of x (M,); None if x hardly varies.

    Equal shares alone would crowd at rest and turning points, equal steps leave pieces
    empty. The outer knots are such that without any one `fold` (M,) some rows still lie
    beyond them: what one fold alone has seen cannot be judged by leaving it out.
    """
    if len(x) < 10 * count:
        return None
    left = [x[fold != f] for f in np.unique(fold)]
    edges = np.array(
        [np.quantile(rest, (EDGE, 1.0 - EDGE)) for rest in left if len(rest)]
    )
    if not len(edges):
        return None
    low, high = float(edges[:, 0].max()), float(edges[:, 1].min())
    if high - low <= STILL * max(1.0, float(np.max(np.abs(x)))):
        return None
    shares = np.quantile(x[(x >= low) & (x <= high)], np.linspace(0.0, 1.0, count))
    return tuple((0.5 * (shares + np.linspace(low, high, count))).tolist())


def smoothest(basis: Array, abscissae: Array) -> Array:
    """Combinations (K, K) of splines at rows (M, K), orthonormal over these, smoothest first.

    The splines sum to one; `abscissae` (K,) are Greville's. One combination per column:
    the constant, nearly the straight line, and so on.
    """
    K = basis.shape[1]
    G = basis.T @ basis / len(basis)
    G[np.diag_indices(K)] += RIDGE * np.trace(G) / K
    one = np.ones(K)
    null = np.linalg.qr(np.column_stack([G @ one, np.eye(K)[:, : K - 1]]))[0][:, 1:]
    first = np.diff(np.eye(K), axis=0) / np.diff(abscissae)[:, None]
    bend = np.ptp(abscissae) * np.diff(first, axis=0) @ null  # second differences
    _, vectors = eigh(bend.T @ bend, null.T @ G @ null)
    return np.column_stack([one / np.sqrt(one @ G @ one), null @ vectors])
