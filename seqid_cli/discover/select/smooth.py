"""Smooth functions of one or two quantities: rivals of the catalogue's effects.

Splines are held beyond what more than one fold of the rows has seen, and combined so
that each bends more than the one before (eigenvectors of the second differences,
Demmler and Reinsch 1975), the constant first: not every base has an offset.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import reduce

import numpy as np
from scipy.linalg import eigh

from seqid_cli.discover.survey.rows import Rows
from seqid_cli.effects.scene import Scene
from seqid_cli.effects.smooth import (
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
STEADY = {"position", "velocity", "speed", "load", "load_size"}
# what other joints may do to a joint: where they are, and how they move
MOTION: tuple[Measure, ...] = ("position", "velocity", "acceleration")
# What may change a joint's friction, each with the quantity that it is told as: where
# the joint is, what it carries, how fast it is. Its own, or that of another joint: it
# rubs more where rails are not parallel, where a neighbour bends its bearing, or where
# one of two shafts runs inside the other.
RUBS: tuple[tuple[Measure, str], ...] = (
    ("position", "position"),
    ("load_size", "load"),
    ("speed", "velocity"),
)
SIZE = 12  # functions of one quantity, the constant among them
TENSOR_SIZE = 6  # the same per quantity of a product
# Over which a joint's speed is averaged: what motion stirs or warms and rest undoes
# again, within seconds. What lasts for minutes is a function of time in these logs.
RECENT_S = (2.0, 6.0)


@dataclass(frozen=True, eq=False, kw_only=True)
class SmoothFunction:
    """A smooth function that might be what the residual of a joint is.

    Attributes
    ----------
    joint : int
        Whose residual.
    quantities : tuple of str
        As the contract spells them, the strongest meaning first.
    label : str
        The same in words.
    axes : tuple of Axis
        The quantities that it is a function of.
    factor : {"one", "direction"}
        What the function is multiplied by (see `model.effects.smooth.shape`).
    mixing : (K, k) array
        Combinations of the splines over the axes.
    absorbed : bool
        It was there in the trials of the file's friction and gravity, which have
        absorbed a part of it (see `FileTrials`).
    """

    joint: int
    quantities: tuple[str, ...]
    label: str
    axes: tuple[Axis, ...]
    factor: Factor
    mixing: Array
    absorbed: bool = False

    @property
    def steady(self) -> bool:
        """Whether motion at constant speeds shows it, as trials of friction are."""
        return {axis.measure for axis in self.axes} <= STEADY

    @property
    def size(self) -> int:
        """Number of columns."""
        return int(self.mixing.shape[1])

    def columns(self, rows: Rows) -> Array:
        """Compute the columns (M_j, k) on the joint's rows.

        Functions of what is slow beside the low-pass pass it as they are: only the
        direction has steps. Low-passed one by one, they cost as much as all effects.
        """
        joint = self.joint
        scenes = rows.scenes
        if not {axis.measure for axis in self.axes} <= SLOW:
            per_scene = (
                {joint: shape(scene, joint, self.axes, self.factor)} for scene in scenes
            )
            return rows.columns(per_scene, passes=2)[joint] @ self.mixing

        of_axes = []
        for axis in self.axes:
            values = _values_of(axis, scenes)
            of_axes.append(splines(rows.of(joint, values), axis.knots))
        basis = reduce(tensor, of_axes)
        if self.factor == "direction":
            sign = [
                scene.motion.filtered(scene.sign[:, [joint]], times=2)
                for scene in scenes
            ]
            basis = basis * rows.of(joint, sign)
        return rows.whitened(joint, basis @ self.mixing)

    def steady_columns(self, scene: Scene) -> dict[int, Array]:
        """Compute columns (N, k) at constant speeds: samples are places, not times."""
        functions = shape(scene, self.joint, self.axes, self.factor)
        return {self.joint: functions @ self.mixing}

    def torques(self, scene: Scene, c: Array) -> dict[int, Array]:
        """Return the low-passed torque (N,) N m of coefficients c (k,), by joint."""
        torque = shape(scene, self.joint, self.axes, self.factor) @ (self.mixing @ c)
        return {self.joint: scene.motion.filtered(torque, times=2)}

    def fitted(self, c: Array) -> SmoothTerm:
        """Return the term of coefficients c (k,)."""
        return SmoothTerm(
            joint=self.joint,
            quantities=self.quantities,
            axes=self.axes,
            factor=self.factor,
            coefficients=self.mixing @ c,
        )


@dataclass(frozen=True)
class _Question:
    """A function of one quantity that is to be looked for, for one joint's torque."""

    measure: Measure
    owner: int  # the joint whose quantity it is
    quantities: tuple[str, ...]
    label: str
    seconds: float = 0.0  # of a recent speed


def smooth_functions(rows: Rows, joint: int) -> list[SmoothFunction]:
    """Return functions of everything measured, of one quantity each.

    Parameters
    ----------
    rows : Rows
        The rows of all data sets.
    joint : int
        Whose torque they might explain.
    """
    questions = [
        *_questions_of_own_motion(joint),
        *_questions_of_other_joints(rows, joint),
        *_questions_of_time(rows, joint),
    ]
    functions = []
    for question in questions:
        function = _smooth_function(rows, joint, question)
        if function is not None:
            functions.append(function)
    return functions


def _questions_of_own_motion(joint: int) -> Iterator[_Question]:
    """Yield what a joint's own motion and load may explain, one-sided and two-sided."""
    measures: tuple[Measure, ...] = (*MOTION, "load", "temperature")
    for measure in measures:
        yield _Question(measure, joint, (measure,), measure)

    sided: tuple[tuple[Measure, str], ...] = (*RUBS, ("temperature", "temperature"))
    for measure, name in sided:
        yield _Question(measure, joint, (name, "direction"), f"{name} x direction")

    for seconds in RECENT_S:
        label = f"speed of the last {seconds:g} s"
        for quantities in (("velocity", "time"), ("velocity", "time", "direction")):
            is_sided = "direction" in quantities
            sided_label = f"{label} x direction" if is_sided else label
            yield _Question("recent_speed", joint, quantities, sided_label, seconds)


def _questions_of_other_joints(rows: Rows, joint: int) -> Iterator[_Question]:
    """Yield what the motion of other joints may explain."""
    for other, name in enumerate(rows.scenes[0].robot.joint_names):
        if other == joint:
            continue
        quantity = f"other_joint:{name}"
        for measure in MOTION:
            yield _Question(measure, other, (quantity,), f"{measure} of {name}")
        for measure, named in RUBS:
            label = f"{named} of {name} x direction"
            yield _Question(measure, other, (quantity, "direction"), label)


def _questions_of_time(rows: Rows, joint: int) -> Iterator[_Question]:
    """Yield what time may explain: that of each log, and that of several logs."""
    clocks: list[tuple[Measure, str]] = [("time", "time since the log's start")]
    if len(rows.scenes) > 1:
        clocks.append(("session_time", "time of all logs"))
    for measure, label in clocks:
        yield _Question(measure, joint, ("time",), label)
        yield _Question(measure, joint, ("time", "direction"), f"{label} x direction")


def _smooth_function(
    rows: Rows, joint: int, question: _Question
) -> SmoothFunction | None:
    """Return a function of one quantity; None where that is not known or constant."""
    of_quantity = Axis(question.measure, question.owner, seconds=question.seconds)
    axis, x = _axis(rows, joint, of_quantity, SIZE - 1)
    if axis is None:
        return None
    combinations = smoothest(splines(x, axis.knots), greville(axis.knots))
    return SmoothFunction(
        joint=joint,
        quantities=question.quantities,
        label=question.label,
        axes=(axis,),
        factor="direction" if "direction" in question.quantities else "one",
        mixing=combinations[:, :SIZE],
    )


def _values_of(axis: Axis, scenes: Sequence[Scene]) -> list[Array]:
    """Return a quantity (N,) of the data sets that have it."""
    values = [axis.values(scene) for scene in scenes]
    return [of_scene for of_scene in values if of_scene is not None]


def _axis(
    rows: Rows, joint: int, without_knots: Axis, size: int
) -> tuple[Axis | None, Array]:
    """Return an axis with `size` + 1 splines over the joint's rows, and the quantity.

    The axis is None where some data set lacks the quantity, or it hardly varies.
    """
    values = _values_of(without_knots, rows.scenes)
    if len(values) < len(rows.scenes):
        return None, np.zeros(0)
    x = rows.of(joint, values)
    knots = knots_of(x, rows.fold[rows.blocks_of(joint)], size - 1)
    if knots is None:
        return None, x
    return replace(without_knots, knots=knots), x


def smooth_products(rows: Rows, j: int) -> list[SmoothFunction]:
    """Return functions of a joint's and another's position, and of both velocities."""
    names = rows.scenes[0].robot.joint_names
    measures: tuple[Measure, ...] = ("position", "velocity")
    functions = []
    for measure in measures:
        axis, x = _axis(rows, j, Axis(measure, j), TENSOR_SIZE - 1)
        if axis is None:
            continue
        U = smoothest(splines(x, axis.knots), greville(axis.knots))
        for k in range(rows.n):
            if k == j:
                continue
            other_axis, z = _axis(rows, j, Axis(measure, k), TENSOR_SIZE - 1)
            if other_axis is None:
                continue
            V = smoothest(splines(z, other_axis.knots), greville(other_axis.knots))
            functions.append(
                SmoothFunction(
                    joint=j,
                    quantities=(measure, f"other_joint:{names[k]}"),
                    label=f"{measure} and that of {names[k]}",
                    axes=(axis, other_axis),
                    factor="one",
                    mixing=np.asarray(np.kron(U[:, :TENSOR_SIZE], V[:, :TENSOR_SIZE])),
                )
            )
    return functions


def knots_of(x: Array, fold: Index, count: int) -> tuple[float, ...] | None:
    """Choose knots half way between equal steps and equal shares of a quantity.

    Equal shares alone would crowd at rest and turning points, equal steps leave pieces
    empty. The outer knots are such that without any one fold some rows still lie beyond
    them: what one fold alone has seen cannot be judged by leaving it out.

    Parameters
    ----------
    x : (M_j,) array
        The quantity at a joint's rows.
    fold : (M_j,) index array
        The fold of each row.
    count : int
        Number of knots.

    Returns
    -------
    tuple of float, or None
        None if x hardly varies.
    """
    if len(x) < 10 * count:
        return None
    ends = []
    for number in np.unique(fold):
        elsewhere = x[fold != number]
        if len(elsewhere):
            ends.append(np.quantile(elsewhere, (EDGE, 1.0 - EDGE)))
    if not ends:
        return None

    by_end = np.array(ends)
    low = float(by_end[:, 0].max())
    high = float(by_end[:, 1].min())
    if high - low <= STILL * max(1.0, float(np.max(np.abs(x)))):
        return None
    between = x[(x >= low) & (x <= high)]
    equal_shares = np.quantile(between, np.linspace(0.0, 1.0, count))
    equal_steps = np.linspace(low, high, count)
    return tuple((0.5 * (equal_shares + equal_steps)).tolist())


def smoothest(basis: Array, abscissae: Array) -> Array:
    """Combine splines so that each combination bends more than the one before.

    The splines sum to one. With G their mean products, combinations orthogonal to the
    constant are the eigenvectors of the second differences against G.

    Parameters
    ----------
    basis : (M, K) array
        Splines at rows.
    abscissae : (K,) array
        Greville's, in the quantity's unit.

    Returns
    -------
    (K, K) array
        One combination per column, orthonormal over the rows: the constant, nearly the
        straight line, and so on.
    """
    K = basis.shape[1]
    G = basis.T @ basis / len(basis)
    G[np.diag_indices(K)] += RIDGE * np.trace(G) / K

    constant = np.ones(K)
    directions = np.column_stack([G @ constant, np.eye(K)[:, : K - 1]])
    varying = np.linalg.qr(directions)[0][:, 1:]

    slopes = np.diff(np.eye(K), axis=0) / np.diff(abscissae)[:, None]
    bend = np.ptp(abscissae) * np.diff(slopes, axis=0) @ varying
    _, vectors = eigh(bend.T @ bend, varying.T @ G @ varying)
    unit_constant = constant / np.sqrt(constant @ G @ constant)
    return np.column_stack([unit_constant, varying @ vectors])
