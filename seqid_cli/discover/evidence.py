"""What a finding rests on, for people to see: residuals over what the effect goes with.

Before is what the model leaves without the effect, its base fitted anew, after is what it leaves
with it: both on blocks of time that were left out of the fit, so that they show what the gain says.
After must be flat, where the law is the right one.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from seqid_cli.discover.candidates import Candidate
from seqid_cli.discover.investigate import Investigation
from seqid_cli.discover.select.model import Model
from seqid_cli.discover.select.results import Taken
from seqid_cli.discover.select.smooth import SmoothFunction
from seqid_cli.discover.select.terms import Term
from seqid_cli.model.effects.scene import Scene
from seqid_cli.model.effects.smooth import Axis
from seqid_cli.params.evidence_schema import EvidenceEntry
from seqid_cli.robot.types import Robot
from seqid_cli.typing import Array, Index

Take = Callable[[int, Sequence[Array]], Array]  # a joint's samples that count, of all logs
What = Candidate | SmoothFunction

CELLS = 80  # of the quantity's range, that bins are made of
LEAST = 0.02  # of the samples, up to which cells are joined into one bin
GAP = 2  # cells without a sample, that no bin goes over
DIGITS = 4
AROUND_S = 1.0  # shown before and behind a push
# What each quantity is measured in: for a revolute joint, for a prismatic one.
UNITS = {
    "position": ("rad", "m"),
    "velocity": ("rad/s", "m/s"),
    "acceleration": ("rad/s^2", "m/s^2"),
    "load": ("N m", "N"),
    "temperature": ("degC", "degC"),
    "time": ("s", "s"),
    "time_frequency": ("Hz", "Hz"),
    "speed": ("rad/s", "m/s"),
    "driving_load": ("N m", "N"),
    "wave": ("turn", "turn"),
    "torque": ("N m", "N"),
}
NAMES = {"load_size": "load", "session_time": "time"}


@dataclass(frozen=True)
class _Over:
    """What a residual is shown over: `values` (N,) by data set of joint `of`; none: own torque."""

    quantity: str
    of: int
    sided: bool = False
    values: Sequence[Array] = ()


def evidence_of(found: Investigation, robot: Robot, taken: Taken) -> EvidenceEntry:
    """Bin what the model leaves of a term's joint without it, and with it."""
    term, model = taken.term, found.model
    theta, channel = model.linear.theta[model.where(term)], _channel_of(term, model)
    j, stage = channel % model.ground.n, model.ground.stage
    narrow = channel // model.ground.n != 1
    take = stage.rows.of if narrow else stage.high.of
    scenes = stage.scenes if narrow else [scene.full or scene for scene in stage.scenes]
    over = _over(term.what, theta[term.part.at(channel)], scenes, j)
    x = take(j, over.values) if over.values else term.part.torque(channel, theta)
    sign = _sign(over, scenes, j, take)
    return _binned(
        robot, j, over, x, taken.left[channel] * sign, model.linear.left_out[channel] * sign
    )


def left_over(found: Investigation, robot: Robot, what: SmoothFunction) -> EvidenceEntry:
    """Bin what is left at a joint over what it is most like; nothing takes that off."""
    scenes, take, j = found.ground.stage.scenes, found.ground.stage.rows.of, what.joint
    over = _over(what, np.zeros(0), scenes, j)
    y = take(j, [r[:, j] for r in found.model.left()])
    x = take(j, over.values) if over.values else y
    return _binned(robot, j, over, x, y * _sign(over, scenes, j, take))


def pushed(found: Investigation, robot: Robot) -> EvidenceEntry | None:
    """Bin the residual over time around the strongest push; nothing takes that off."""
    event = max(found.events, key=lambda one: one.score, default=None)
    if event is None:
        return None
    left = found.model.left()[event.scene]
    motion = found.ground.stage.scenes[event.scene].motion
    t = motion.t - motion.t[0]
    near = (t >= event.start - AROUND_S) & (t <= event.end + AROUND_S)
    j = max(event.joints, key=lambda k: float(np.mean(left[near, k] ** 2)))
    x = found.logs[event.scene].offset + t[near]
    return _binned(robot, j, _Over("time", j), x, left[near, j])


def _channel_of(term: Term, model: Model) -> int:
    """The rows that show a term most: of its own joint, or of any where it is of the whole arm."""
    n, theta, weight = model.ground.n, model.linear.theta[model.where(term)], model.noise.weight
    shown = {
        c: float(weight[c] @ term.part.torque(c, theta) ** 2)
        for c in term.channels
        if term.joint in (c % n, None)
    }
    return max(shown, key=lambda c: shown[c])


def _sign(over: _Over, scenes: Sequence[Scene], j: int, take: Take) -> Array | float:
    """Direction of motion at a joint's rows where it counts, else 1."""
    if not over.sided:
        return 1.0
    return np.sign(take(j, [scene.motion.dq[:, j] for scene in scenes]))


def _over(what: What, theta: Array, scenes: Sequence[Scene], j: int) -> _Over:
    """The quantity that a term with coefficients theta (k,) goes with at a joint.

    Of a wave with columns sine, cosine, ... it is the place on it, 0 where it rises.
    """
    if isinstance(what, Candidate) and what.effect.over == "wave":
        columns = [what.columns(scene)[j] for scene in scenes]
        a, b = theta[::2], theta[1::2]
        turns = [
            np.arctan2(X[:, ::2] @ a + X[:, 1::2] @ b, X[:, 1::2] @ a - X[:, ::2] @ b)
            for X in columns
        ]
        return _Over("wave", j, values=[np.mod(turn / (2 * np.pi), 1.0) for turn in turns])
    if isinstance(what, Candidate) and what.effect.over == "driving_load":
        along = [scene.load[:, j] * np.sign(scene.motion.dq[:, j]) for scene in scenes]
        return _Over("driving_load", j, what.sided, along)
    axis = what.axis(j)
    found = _values(axis, scenes) if axis else None
    if axis is None or found is None:
        return _Over("torque", j)
    return _Over(NAMES.get(axis.measure, axis.measure), axis.joint, what.sided, found)


def _values(axis: Axis, scenes: Sequence[Scene]) -> list[Array] | None:
    """A quantity (N,) by data set; time since the start of each log where they share no clock."""
    found = [axis.values(scene) for scene in scenes]
    known = [x for x in found if x is not None]
    if len(known) < len(found):
        return _values(Axis("time", axis.joint), scenes) if axis.measure == "session_time" else None
    return known


def _binned(
    robot: Robot, j: int, over: _Over, x: Array, y: Array, left: Array | None = None
) -> EvidenceEntry:
    """Means and spreads over x (M,) of y, left (M,) N m."""
    bins = _bins(x)
    after = [left[part] for part in bins] if left is not None else []
    names = robot.joint_names
    return EvidenceEntry(
        joint=names[j],
        quantity=over.quantity,
        of=names[over.of],
        unit=UNITS.get(over.quantity, ("", ""))[robot.joints[over.of].prismatic],
        sided=over.sided,
        x=_each(np.mean, [x[part] for part in bins]),
        count=[len(part) for part in bins],
        before=_each(np.mean, [y[part] for part in bins]),
        before_spread=_each(np.std, [y[part] for part in bins]),
        after=_each(np.mean, after),
        after_spread=_each(np.std, after),
    )


def _bins(x: Array) -> list[Index]:
    """Indices of each bin of x (M,), ascending: narrow, with enough samples, over no gap."""
    low, span = float(np.min(x, initial=np.inf)), float(np.ptp(x)) if len(x) else 0.0
    if span == 0.0:
        return [np.arange(len(x))] if len(x) else []
    cell = np.minimum((CELLS * (x - low) / span).astype(np.intp), CELLS - 1)
    count, ends = np.bincount(cell, minlength=CELLS), [0]
    there = np.flatnonzero(count)
    for at, after in pairwise(there.tolist()):
        held = int(count[ends[-1] : at + 1].sum())
        if held >= LEAST * len(x) or after - at > GAP:
            ends.append(at + 1)
    number = np.searchsorted(ends, cell, side="right") - 1
    return [np.flatnonzero(number == k) for k in range(len(ends))]


def _each(what: Callable[[Array], np.floating], parts: Sequence[Array]) -> list[float]:
    return [float(f"{what(part):.{DIGITS}g}") for part in parts]
