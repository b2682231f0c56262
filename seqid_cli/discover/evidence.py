"""What a finding rests on, for people to see: residuals over what the effect goes with.

The residual with everything else taken off (a partial residual, W. A. Larsen, S. J. McCleary, "The
use of partial residual plots in regression analysis", Technometrics 14, 1972) shows the effect's
law; less the effect's torque it is flat, where the law is the right one.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
from numpy.typing import NDArray

from seqid_cli.discover.candidates import Candidate
from seqid_cli.discover.investigate import Investigation
from seqid_cli.discover.results import Evidence
from seqid_cli.discover.select.model import Model
from seqid_cli.discover.select.selection import Taken
from seqid_cli.discover.select.smooth import SmoothFunction
from seqid_cli.discover.select.terms import Term
from seqid_cli.discover.wide import full_residual
from seqid_cli.model.effects.scene import Scene
from seqid_cli.model.effects.smooth import Axis
from seqid_cli.robot.types import Robot

Array = NDArray[np.float64]
Take = Callable[[int, Sequence[Array]], Array]  # a joint's samples that count, of all scenes

BINS = 40
DIGITS = 4
AROUND_S = 1.0  # shown before and behind a push
NAMES = {"load_size": "load", "session_time": "time", "motor_angle": "wave"}


def evidence_of(found: Investigation, robot: Robot, taken: Taken) -> Evidence:
    """Bin what one term explains: residual of its joint without it, and with it."""
    term, model = taken.term, found.model
    j = _joint_of(term, model)
    scenes, take, before, torque = _residual(term, model, j)
    name, of, over = _over(term, model, scenes, j)
    y, shown = take(j, before), take(j, torque)
    x = shown if over is None else take(j, over)
    sided = _sided(term)
    if sided:
        sign = np.sign(take(j, [scene.motion.dq[:, j] for scene in scenes]))
        y, shown = y * sign, shown * sign
    names = robot.joint_names
    return _binned(names[j], name, names[of], sided, x, y, y - shown)


def pushed(found: Investigation, robot: Robot) -> Evidence | None:
    """Bin the residual over time around the strongest push; nothing takes that off."""
    event = max(found.events, key=lambda one: one.score, default=None)
    if event is None:
        return None
    left = found.model.left()[event.scene]
    motion = found.ground.stage.scenes[event.scene].motion
    t = motion.t - motion.t[0]
    near = (t >= event.start - AROUND_S) & (t <= event.end + AROUND_S)
    j = max(event.joints, key=lambda k: float(np.mean(left[near, k] ** 2)))
    name, log = robot.joint_names[j], found.logs[event.scene]
    return _binned(name, "time", name, False, log.offset + t[near], left[near, j])


def _joint_of(term: Term, model: Model) -> int:
    """Whose torque shows a term: its own joint's, or that which it explains most."""
    if term.joint is not None:
        return term.joint
    theta, columns = model.linear.theta[model.where(term)], term.part.columns
    weight, n = model.noise.weight, model.ground.n
    shown = {c: float(weight[c] @ (X @ theta) ** 2) for c, X in columns.items() if c < n}
    return max(shown, key=lambda c: shown[c])


def _residual(
    term: Term, model: Model, j: int
) -> tuple[Sequence[Scene], Take, list[Array], list[Array]]:
    """Scenes, what takes a joint's rows of them, residual (N,) without the term, its torque."""
    what, stage, theta = term.what, model.ground.stage, model.linear.theta[model.where(term)]
    left = model.left(without=term)
    if isinstance(what, Candidate) and what.effect.wide and not what.below:
        full = [scene.full or scene for scene in stage.scenes]
        whole = [full_residual(scene, r)[:, j] for scene, r in zip(stage.scenes, left, strict=True)]
        columns = [what.effect.columns(scene, what.joint, what.settings)[j] for scene in full]
        return full, stage.high.of, whole, [X @ theta for X in columns]
    torque = [np.zeros_like(r) for r in left]
    what.add_torque(torque, stage.scenes, theta)
    return stage.scenes, stage.rows.of, [r[:, j] for r in left], [tau[:, j] for tau in torque]


def _sided(term: Term) -> bool:
    what = term.what
    if isinstance(what, SmoothFunction):
        return what.source.factor == "direction"
    return what.effect.sided


def _over(
    term: Term, model: Model, scenes: Sequence[Scene], j: int
) -> tuple[str, int, list[Array] | None]:
    """Name of the quantity, whose it is, and its values (N,); none for the term's own torque."""
    what = term.what
    if isinstance(what, Candidate) and what.effect.over == "wave":
        theta = model.linear.theta[model.where(term)]
        columns = [what.effect.columns(scene, what.joint, what.settings)[j] for scene in scenes]
        return "wave", j, [_turn(X, theta) for X in columns]
    axis = _axis(what, j)
    found = _values(axis, scenes) if axis else None
    if axis is None or found is None:
        return "torque", j, None
    return NAMES.get(axis.measure, axis.measure), axis.joint, found


def _axis(what: Candidate | SmoothFunction, j: int) -> Axis | None:
    if isinstance(what, SmoothFunction):
        return what.source.axes[0]
    return what.effect.axis(j, what.settings)


def _values(axis: Axis, scenes: Sequence[Scene]) -> list[Array] | None:
    """A quantity (N,) by scene; time since the start of each log where they share no clock."""
    found = [axis.values(scene) for scene in scenes]
    known = [x for x in found if x is not None]
    if len(known) < len(found):
        return _values(Axis("time", axis.joint), scenes) if axis.measure == "session_time" else None
    if axis.measure == "motor_angle":
        return [np.mod(axis.order * x / (2 * np.pi), 1.0) for x in known]
    return known


def _turn(X: Array, theta: Array) -> Array:
    """Place (N,) on the wave that columns (N, 2k) sine, cosine, ... make, 0 where it rises."""
    sin, cos, a, b = X[:, ::2], X[:, 1::2], theta[::2], theta[1::2]
    turn: Array = np.mod(np.arctan2(sin @ a + cos @ b, cos @ a - sin @ b) / (2 * np.pi), 1.0)
    return turn


def _binned(
    joint: str, quantity: str, of: str, sided: bool, x: Array, y: Array, left: Array | None = None
) -> Evidence:
    """Bins of about equally many samples, in the order of x (M,); y, left (M,) N m."""
    parts = np.array_split(np.argsort(x, kind="stable"), min(BINS, max(len(x), 1)))
    bins = [part for part in parts if len(part)]
    after = [left[part] for part in bins] if left is not None else []
    return Evidence(
        joint=joint,
        quantity=quantity,
        of=of,
        sided=sided,
        x=_each(np.mean, [x[part] for part in bins]),
        count=tuple(len(part) for part in bins),
        before=_each(np.mean, [y[part] for part in bins]),
        before_spread=_each(np.std, [y[part] for part in bins]),
        after=_each(np.mean, after),
        after_spread=_each(np.std, after),
    )


def _each(what: Callable[[Array], np.floating], parts: Sequence[Array]) -> tuple[float, ...]:
    return tuple(float(f"{what(part):.{DIGITS}g}") for part in parts)
