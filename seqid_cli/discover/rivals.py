"""Smooth functions of one or two quantities: rivals of the catalogue's effects.

Where such a function foretells the residual better than any physical effect does, the residual
depends on that quantity in a way that the catalogue does not know.

The functions are made safe by construction. Splines are held beyond what more than one fold of the
rows has seen, and out of them only the smoothest combinations are taken: those that bend least for
their size (eigenvectors of the second differences, Demmler and Reinsch 1975), few, more or all,
each of unit RMS over the rows. The fewest are tried over the whole range as well: a cube shows at
its ends. A constant is left out, for the base has it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from seqid_cli.discover.rows import Rows
from seqid_cli.discover.smoothest import EDGE, knots_of, smoothest
from seqid_cli.discover.system import System, Trial
from seqid_cli.model.effects.scene import Scene
from seqid_cli.model.effects.smooth import Axis, Factor, Measure, greville, shape, splines
from seqid_cli.model.effects.spectral_lines import Signal, strongest_lines
from seqid_cli.model.effects.unexplained import SmoothTerm

Array = NDArray[np.float64]
Single = NDArray[np.float32]

SIZES = (4, 7, 11)  # functions of one quantity, without the constant
TENSOR_SIZES = (3, 4, 6)  # functions per quantity of a product, with it
ORDERS = 12  # of the motor's turn
LINES = 2
SLOWEST_LINE_HZ = 0.3
CURVE_POINTS = 41
ALIKE = 2.5  # rows of low-passed signals that count as one
BATCH = 250  # columns that are tried at once


@dataclass(frozen=True)
class Line:
    """A wave at one frequency of time, its phase free in each of `logs` logs."""

    frequency_hz: float
    logs: int

    def basis(self, scene: Scene) -> Array:
        """Compute sine and cosine (N, 2 logs), zero but in the scene's own log's columns."""
        angle = 2 * np.pi * self.frequency_hz * scene.motion.t
        wave = np.zeros((scene.samples, 2 * self.logs))
        wave[:, 2 * scene.log : 2 * scene.log + 2] = np.stack([np.sin(angle), np.cos(angle)], 1)
        return wave


@dataclass(frozen=True)
class Shape:
    """The functions that a rival is made of, before any are chosen: see `smooth.shape`."""

    joint: int
    axes: tuple[Axis, ...]
    factor: Factor = "one"

    def basis(self, scene: Scene) -> Array:
        """Compute the functions (N, K), unfiltered."""
        return shape(scene, self.joint, self.axes, self.factor)


@dataclass(frozen=True, eq=False)
class Rival:
    """A smooth function that might be what the residual of a joint is.

    Attributes
    ----------
    joint : int
        Whose torque.
    quantities : tuple of str
        What it depends on, as the contract spells it, the strongest meaning first.
    label : str
        The same in words.
    source : Shape or Line
        Its functions.
    mixing : (K, k) array
        The combinations of them that are its columns.
    """

    joint: int
    quantities: tuple[str, ...]
    label: str
    source: Shape | Line
    mixing: Array

    @property
    def size(self) -> int:
        """Number of columns."""
        return int(self.mixing.shape[1])

    @property
    def bending(self) -> Array:
        """How much each column (k,) bends: its place among the smoothest; waves are all alike."""
        if isinstance(self.source, Line) or not all(axis.knots for axis in self.source.axes):
            return np.ones(self.size)
        place = np.arange(1.0, self.size + 1.0)
        return np.sqrt(place) if len(self.source.axes) > 1 else place

    @property
    def single(self) -> bool:
        """Whether one quantity is all."""
        return len(self.quantities) == 1

    def columns(self, scene: Scene) -> dict[int, Array]:
        """Compute the columns (N, k) at the rival's joint, unfiltered, for two passes."""
        return {self.joint: self.source.basis(scene) @ self.mixing}

    def term(self, coefficients: Array) -> SmoothTerm | None:
        """Return the torque of coefficients (k,), None where other logs cannot know it."""
        if isinstance(self.source, Line):
            return None
        c = self.mixing @ coefficients
        return SmoothTerm(self.joint, self.quantities, self.source.axes, self.source.factor, c)

    def curve(self, coefficients: Array) -> tuple[Array, Array] | None:
        """Torque [N m] over the rival's one quantity; None where it has two, or waves."""
        if isinstance(self.source, Line) or len(self.source.axes) > 1:
            return None
        axis = self.source.axes[0]
        if not axis.knots:
            return None
        x = np.linspace(axis.knots[0], axis.knots[-1], CURVE_POINTS)
        return x, splines(x, axis.knots) @ (self.mixing @ coefficients)


def rivals(rows: Rows, joint: int, residual: Array) -> list[Rival]:
    """Return all rivals at a joint, products after single quantities.

    Parameters
    ----------
    rows : Rows
        The knots are drawn from the rows of all scenes that count for the joint.
    joint : int
    residual : (M_joint,) array
        What is left at those rows; only its spectrum is looked at, for lines in time.
    """
    return [*lasting(rows, joint), *_lines(rows, joint, residual)]


def lasting(rows: Rows, joint: int) -> list[Rival]:
    """Return the rivals that do not depend on the residual."""
    found = [*_of_joint(rows, joint), *_of_others(rows, joint), *_of_time(rows, joint)]
    return [*found, *_motor_angle(rows, joint), *_products(rows, joint)]


def _of_joint(rows: Rows, j: int) -> list[Rival]:
    return [
        *_smooth(rows, j, ("position",), "position", "position"),
        *_smooth(rows, j, ("velocity",), "velocity", "velocity"),
        *_smooth(rows, j, ("acceleration",), "acceleration", "acceleration"),
        *_smooth(rows, j, ("load",), "load", "load"),
        *_smooth(rows, j, ("temperature",), "temperature", "temperature"),
        *_smooth(rows, j, ("position", "direction"), "position", "position x direction"),
        *_smooth(rows, j, ("load", "direction"), "load_size", "load x direction"),
        *_smooth(rows, j, ("velocity", "direction"), "speed", "speed x direction"),
        *_smooth(rows, j, ("temperature", "direction"), "temperature", "temperature x direction"),
    ]


def _of_others(rows: Rows, j: int) -> list[Rival]:
    names = rows.scenes[0].robot.joint_names
    measures: tuple[Measure, ...] = ("position", "velocity", "acceleration")
    found = []
    for k in range(rows.n):
        for measure in measures if k != j else ():
            quantities = (f"other_joint:{names[k]}",)
            found += _smooth(rows, j, quantities, measure, f"{measure} of {names[k]}", owner=k)
        if k != j:  # rubs more where another joint stands, as rails do that are not parallel
            both = (f"other_joint:{names[k]}", "direction")
            label = f"position of {names[k]} x direction"
            found += _smooth(rows, j, both, "position", label, owner=k)
    return found


def _of_time(rows: Rows, j: int) -> list[Rival]:
    found = [
        *_smooth(rows, j, ("time",), "time", "time since the log's start"),
        *_smooth(rows, j, ("time", "direction"), "time", "time x direction"),
    ]
    if len(rows.scenes) > 1:
        found += _smooth(rows, j, ("time",), "session_time", "time of all logs")
        found += _smooth(rows, j, ("time", "direction"), "session_time", "time x direction")
    return found


def _smooth(
    rows: Rows,
    joint: int,
    quantities: tuple[str, ...],
    measure: Measure,
    label: str,
    *,
    owner: int | None = None,
) -> list[Rival]:
    """Rivals of one quantity, few functions to many; none where it is not known or constant."""
    at = joint if owner is None else owner
    factor: Factor = "direction" if "direction" in quantities else "one"
    first = 0 if measure == "speed" else 1
    found = []
    for edge, sizes, count in ((EDGE, SIZES, SIZES[-1]), (0.0, SIZES[:1], SIZES[1])):
        axis, x = _axis(rows, joint, measure, at, count, edge)
        if axis is None:
            continue
        mixing = smoothest(splines(x, axis.knots), greville(axis.knots))
        source = Shape(joint, (axis,), factor)
        found += [
            Rival(joint, quantities, label, source, mixing[:, first : 1 + size]) for size in sizes
        ]
    return found


def _axis(
    rows: Rows, joint: int, measure: Measure, owner: int, size: int, edge: float = EDGE
) -> tuple[Axis | None, Array]:
    """Axis with `size` + 1 splines over the joint's rows, and the quantity there."""
    bare = Axis(measure, owner)
    values = [bare.values(scene) for scene in rows.scenes]
    known = [v for v in values if v is not None]
    if len(known) < len(values):
        return None, np.zeros(0)
    x = rows.of(joint, known)
    knots = knots_of(x, rows.folds_of(joint), size - 1, edge)
    if knots is None:
        return None, x
    return Axis(measure, owner, knots), x


def _motor_angle(rows: Rows, j: int) -> list[Rival]:
    """Waves of the motor's turn: constant, with the direction, with the load."""
    if rows.scenes[0].robot.joints[j].gear_ratio is None:
        return []
    laws: tuple[tuple[Factor, tuple[str, ...]], ...] = (
        ("one", ("position",)),
        ("direction", ("position", "direction")),
        ("load", ("position", "load")),
    )
    return [
        Rival(
            j,
            quantities,
            f"motor angle, order {order}" + (f" x {factor}" if factor != "one" else ""),
            Shape(j, (Axis("motor_angle", j, order=order),), factor),
            np.eye(2),
        )
        for factor, quantities in laws
        for order in range(1, ORDERS + 1)
    ]


def _products(rows: Rows, j: int) -> list[Rival]:
    """Functions of this and another joint's position, and of both velocities."""
    names = rows.scenes[0].robot.joint_names
    measures: tuple[Measure, ...] = ("position", "velocity")
    found = []
    for measure in measures:
        own, x = _axis(rows, j, measure, j, max(TENSOR_SIZES) - 1)
        for k in range(rows.n):
            other, z = _axis(rows, j, measure, k, max(TENSOR_SIZES) - 1)
            if k == j or own is None or other is None:
                continue
            U = smoothest(splines(x, own.knots), greville(own.knots))
            V = smoothest(splines(z, other.knots), greville(other.knots))
            mixings = [_kronecker(U[:, :size], V[:, :size])[:, 1:] for size in TENSOR_SIZES]
            found += [
                Rival(
                    j,
                    (measure, f"other_joint:{names[k]}"),
                    f"{measure} and that of {names[k]}",
                    Shape(j, (own, other)),
                    mixing,
                )
                for mixing in mixings
            ]
    return found


def _kronecker(U: Array, V: Array) -> Array:
    product = U[:, None, :, None] * V[None, :, None, :]
    return product.reshape(len(U) * len(V), -1)


def _lines(rows: Rows, j: int, residual: Array) -> list[Rival]:
    """Waves in time at the strongest lines of the residual."""
    signals = []
    first = 0
    for scene, picked, used in zip(rows.scenes, rows.picked, rows.used, strict=True):
        stride = int(np.min(np.diff(picked), initial=scene.samples))
        values = np.zeros(-(-scene.samples // stride))
        at = picked[used[:, j]] // stride
        values[at] = residual[first : first + len(at)]
        first += len(at)
        signals.append(Signal(values, scene.motion.rate_hz / stride))
    cutoff = min(scene.motion.lowpass.cutoff_hz for scene in rows.scenes)
    return [
        Rival(
            j,
            ("time_frequency",),
            f"time at {frequency:.4g} Hz",
            Line(frequency, len(rows.scenes)),
            np.eye(2 * len(rows.scenes)),
        )
        for frequency in strongest_lines(signals, SLOWEST_LINE_HZ, LINES)
        if frequency < 1.5 * cutoff
    ]


@dataclass
class _Kept:
    """Columns (M_j, k) by joint and source, and the rivals that last by joint."""

    columns: dict[tuple[int, Shape | Line], Single] = field(default_factory=dict)
    lasting: dict[int, list[Rival]] = field(default_factory=dict)


class Filtered:
    """Rivals' rows; those of one source share the filtering, and single precision the memory.

    What has been made is kept with the rows, which it does not know itself: nothing of a search
    that is over stays in memory.
    """

    def __init__(self, rows: Rows, kept: _Kept) -> None:
        self.rows, self._kept = rows, kept

    @classmethod
    def of(cls, rows: Rows) -> Filtered:
        """With what has been made of these rows."""
        kept = rows.made.setdefault("smooth", _Kept())
        assert isinstance(kept, _Kept)
        return cls(rows, kept)

    def rivals(self, joint: int, residual: Array) -> list[Rival]:
        """All rivals at a joint; those that last are made once."""
        kept = self._kept.lasting
        if joint not in kept:
            kept[joint] = lasting(self.rows, joint)
        return [*kept[joint], *_lines(self.rows, joint, residual)]

    def columns(self, rival: Rival) -> dict[int, Array]:
        """Columns (M_j, k) on the rows of the rival's joint."""
        key = (rival.joint, rival.source)  # one line in time may be at several joints
        made = self._kept.columns
        if key not in made:
            per_scene = [{rival.joint: rival.source.basis(scene)} for scene in self.rows.scenes]
            basis = self.rows.columns(per_scene, passes=2)[rival.joint]
            made[key] = basis.astype(np.float32)
        return {rival.joint: made[key].astype(np.float64) @ rival.mixing}


def best_rivals(
    system: System, joints: Sequence[int] | None = None
) -> dict[int, list[tuple[Rival, Trial]]]:
    """Try all rivals of each joint by leaving folds out.

    Parameters
    ----------
    system : System
        Base and accepted effects.
    joints : sequence of int, optional
        Default: all.

    Returns
    -------
    mapping
        Per joint, each label once (few functions or many, as gains more), ordered by total gain.
    """
    rows = system.rows
    residual = system.residual()
    result: dict[int, list[tuple[Rival, Trial]]] = {}
    for joint in range(rows.n) if joints is None else joints:
        if rows.count(joint) == 0:
            result[joint] = []
            continue
        filtered = Filtered.of(rows)
        result[joint] = tried(system, filtered.rivals(joint, residual[joint]), filtered)
    return result


def known_beforehand(residual: Array | float, functions: int) -> float:
    """Precision of the coefficients of so many functions of unit size before any row is seen.

    Together they are no larger than the residual (or its RMS); rows in a row tell much the same.
    """
    return ALIKE * functions / max(float(np.mean(np.square(residual))), 1e-300)


def tried(
    system: System, candidates: Sequence[Rival], filtered: Filtered
) -> list[tuple[Rival, Trial]]:
    """Try rivals against a system; of those with one label the best is kept, best first."""
    trials: list[Trial] = []
    residual = system.residual()
    edges = np.cumsum([rival.size for rival in candidates]) // BATCH
    for number in np.unique(edges):
        some = [r for r, e in zip(candidates, edges, strict=True) if e == number]
        held = [known_beforehand(residual[rival.joint], rival.size) for rival in some]
        trials += system.tried([filtered.columns(rival) for rival in some], held)
    best: dict[str, tuple[Rival, Trial]] = {}
    for rival, trial in sorted(zip(candidates, trials, strict=True), key=lambda p: -p[1].total):
        best.setdefault(rival.label, (rival, trial))
    return list(best.values())
