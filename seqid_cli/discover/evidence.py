"""What a finding rests on, for people to see: residuals over what the effect goes with, and rivals.

Before is what the model leaves without the effect, its base fitted anew, after is what
it leaves with it: both on blocks of time that were left out of the fit, so that they
show what the gain says. After must be flat, where the law is the right one.
"""

from collections.abc import Callable, Collection, Iterable, Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from seqid_cli.discover.candidates import Candidate
from seqid_cli.discover.investigate import Investigation
from seqid_cli.discover.select.options import Options
from seqid_cli.discover.select.results import ScoredTerm, TermResult
from seqid_cli.discover.select.smooth import SmoothFunction
from seqid_cli.model.effects.scene import Scene
from seqid_cli.model.effects.smooth import Axis
from seqid_cli.params.evidence_schema import EvidenceEntry, RivalEntry
from seqid_cli.robot.types import Robot
from seqid_cli.shares import percent
from seqid_cli.typing import Array, Index

# a joint's samples that count, of all logs
Take = Callable[[int, Sequence[Array]], Array]

MOST = 6  # rivals of each list that are told
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

    def sign(self, scenes: Sequence[Scene], j: int, take: Take) -> Array | float:
        """Direction of motion at a joint's rows where it counts, else 1."""
        return (
            np.sign(take(j, [s.motion.dq[:, j] for s in scenes])) if self.sided else 1.0
        )


def evidence_of(found: Investigation, robot: Robot, taken: TermResult) -> EvidenceEntry:
    """Bin what is left without a term and with it, at its joint or the one that shows it most."""
    term, model, stage, n = taken.term, taken.model, found.ground.stage, found.ground.n
    theta = model.linear.theta[model.where(term)]
    weight, own = (
        model.noise.weight,
        [c for c in term.channels if term.joint in (c % n, None)],
    )
    channel = max(own, key=lambda c: float(weight[c] @ term.part.torque(c, theta) ** 2))
    j, narrow = channel % n, channel // n != 1
    take = stage.rows.of if narrow else stage.high.of
    scenes = [scene if narrow else scene.full or scene for scene in stage.scenes]
    over = _over(term.what, theta[term.part.at(channel)], scenes, j)
    x = take(j, over.values) if over.values else term.part.torque(channel, theta)
    sign, left = over.sign(scenes, j, take), model.linear.left_out[channel]
    return _binned(robot, j, over, x, taken.left_without[channel] * sign, left * sign)


def left_over(
    found: Investigation, robot: Robot, what: SmoothFunction
) -> EvidenceEntry:
    """Bin what is left at a joint over what it is most like; nothing takes that off."""
    scenes, take, j = found.ground.stage.scenes, found.ground.stage.rows.of, what.joint
    over = _over(what, np.zeros(0), scenes, j)
    y = take(j, [r[:, j] for r in found.model.left()])
    x = take(j, over.values) if over.values else y
    return _binned(robot, j, over, x, y * over.sign(scenes, j, take))


def pushed(found: Investigation, robot: Robot) -> EvidenceEntry:
    """Bin the residual over time around the strongest of some pushes; nothing takes that off."""
    event = max(found.events, key=lambda one: one.score)
    left, scene = (
        found.model.left()[event.scene],
        found.ground.stage.scenes[event.scene],
    )
    near = event.inside(scene, AROUND_S)
    j = max(event.joints, key=lambda k: float(np.mean(left[near, k] ** 2)))
    x = found.logs[event.scene].offset + (scene.motion.t - scene.motion.t[0])[near]
    return _binned(robot, j, _Over("time", j), x, left[near, j])


def _over(
    what: Candidate | SmoothFunction, theta: Array, scenes: Sequence[Scene], j: int
) -> _Over:
    """What a term with coefficients theta (k,) goes with; of a wave the place, 0 where it rises."""
    if isinstance(what, SmoothFunction):
        sided, axes = what.factor == "direction", [what.axes[0]]
    elif what.effect.over == "wave":
        turns, a, b = list[Array](), theta[::2], theta[1::2]
        for X in (what.columns(scene)[j] for scene in scenes):
            turn = np.arctan2(
                X[:, ::2] @ a + X[:, 1::2] @ b, X[:, 1::2] @ a - X[:, ::2] @ b
            )
            turns.append(np.mod(turn / (2 * np.pi), 1.0))
        return _Over("wave", j, values=turns)
    elif what.effect.over == "driving_load":
        along = [scene.load[:, j] * np.sign(scene.motion.dq[:, j]) for scene in scenes]
        return _Over("driving_load", j, what.effect.sided, along)
    else:
        axis = what.effect.axis(j, what.settings)
        sided, axes = what.effect.sided, [axis] if axis else []
    # where logs share no clock: since each's start
    if axes and axes[0].measure == "session_time":
        axes.append(Axis("time", axes[0].joint))
    for one in axes:
        known = [x for scene in scenes if (x := one.values(scene)) is not None]
        if len(known) == len(scenes):
            return _Over(NAMES.get(one.measure, one.measure), one.joint, sided, known)
    return _Over("torque", j)


def _binned(
    robot: Robot, j: int, over: _Over, x: Array, y: Array, left: Array | None = None
) -> EvidenceEntry:
    """Means and spreads over x (M,) of y, left (M,) N m."""
    bins, names = _bins(x), robot.joint_names
    before, after = ([r[part] for part in bins if r is not None] for r in (y, left))
    return EvidenceEntry(
        joint=names[j],
        quantity=over.quantity,
        of=names[over.of],
        unit=UNITS.get(over.quantity, ("", ""))[robot.joints[over.of].prismatic],
        sided=over.sided,
        x=_each(np.mean, [x[part] for part in bins]),
        count=[len(part) for part in bins],
        before=_each(np.mean, before),
        before_spread=_each(np.std, before),
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
    for at, after in pairwise(np.flatnonzero(count).tolist()):
        if count[ends[-1] : at + 1].sum() >= LEAST * len(x) or after - at > GAP:
            ends.append(at + 1)
    number = np.searchsorted(ends, cell, side="right") - 1
    return [np.flatnonzero(number == k) for k in range(len(ends))]


def _each(what: Callable[[Array], np.floating], parts: Sequence[Array]) -> list[float]:
    return [float(f"{what(part):.{DIGITS}g}") for part in parts]


def rivals_of(
    robot: Robot, taken: TermResult, alike: Collection[str] = ()
) -> list[RivalEntry]:
    """What was tried in a term's place; `alike` are the effects that could be it as well."""
    others = _each_once(r for r in taken.rivals if r.term.key != taken.term.key)
    # these first
    told = sorted(others, key=lambda one: one.term.name not in alike)[:MOST]
    ranked = sorted(told, key=lambda one: -one.score.total)
    return [_rival(robot, one, _beside(one, taken, alike)) for one in ranked]


def tried_at(found: Investigation, robot: Robot, joint: int) -> list[RivalEntry]:
    """What was tried at a joint beside all that was taken, the largest gain first."""
    n = found.ground.n
    here = (
        r
        for r in found.selection.untaken
        if any(c % n == joint for c in r.term.channels)
    )
    return [_rival(robot, one, _lacking(one)) for one in _each_once(here)[:MOST]]


def _each_once(some: Iterable[ScoredTerm]) -> list[ScoredTerm]:
    """The first of every name at every joint; one smooth function, the best, for all."""
    kept: dict[object, ScoredTerm] = {}
    for one in some:
        kept.setdefault("smooth" if one.term.smooth else one.term.key, one)
    return list(kept.values())


def _rival(robot: Robot, one: ScoredTerm, why_not: str) -> RivalEntry:
    name, joint = one.term.name, robot.name_of(one.term.joint)
    name = f"some function of {name}" if one.term.smooth else name
    return RivalEntry(
        effect=name, joint=joint, log_gain=one.score.total, why_not=why_not
    )


def _beside(one: ScoredTerm, taken: TermResult, alike: Collection[str]) -> str:
    """Why a rival was not taken in a term's place."""
    reach = one.score.total / max(taken.scored.score.total, 1e-300)
    if one.term.name in alike:
        return (
            f"these logs cannot tell the two apart: it reaches {percent(reach)} of the"
            " gain"
        )
    if reach <= 0.0:
        return "predicts nothing in its place"
    if reach < 1.0 - Options().small:
        return f"explains {percent(1.0 - reach)} less"
    more, own = one.term.freedom, taken.term.freedom
    if more > own:
        return (
            f"needs {more} parameters, not {own}, to reach {percent(reach)} of the gain"
        )
    return f"no better: it reaches {percent(reach)} of the gain"


def _lacking(one: ScoredTerm) -> str:
    """Why something was not taken beside all that was."""
    options, told = Options(), one.score
    if told.total <= 0.0:
        return "predicts left-out blocks worse than the model without it"
    if told.doubt >= options.doubt:
        chance, most = percent(told.doubt), percent(options.doubt)
        return (
            f"gains nothing in {chance} of drawn blocks of time; {most} is allowed at"
            " most"
        )
    if (evidence := one.fit.log_bayes_factor) <= options.chance:
        return (
            f"log evidence of {evidence:.1f}, as of noise; {options.chance:g} is asked"
            " at least"
        )
    if told.share <= options.improvement:
        share, least = percent(told.share), percent(options.improvement)
        return f"takes away {share} of the squared error; {least} is asked at least"
    return "was taken, and removed again: not worth it once all was fitted together"
