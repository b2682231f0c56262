"""What a finding rests on, for people to see: binned residuals, and rivals.

Residuals are shown over what the effect goes with. Before is what the model leaves
without the effect, its base fitted anew, after is what it leaves with it: both on
blocks of time that were left out of the fit, so that they show what the gain says.
After must be flat, where the law is the right one.
"""

from collections.abc import Callable, Collection, Iterable, Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from seqid_cli.discover.candidates import Candidate
from seqid_cli.discover.investigate import Investigation
from seqid_cli.discover.link_rows import KIND as LINKS
from seqid_cli.discover.select.options import Options
from seqid_cli.discover.select.results import ScoredTerm, TermResult, again
from seqid_cli.discover.select.search import Search
from seqid_cli.discover.select.smooth import SmoothFunction
from seqid_cli.effects.registry import catalogue_of
from seqid_cli.effects.scene import Scene
from seqid_cli.effects.smooth import Axis
from seqid_cli.params.evidence_schema import EvidenceEntry, RivalEntry
from seqid_cli.robot.types import Robot
from seqid_cli.shares import percent
from seqid_cli.typing import Array, Index

# a joint's samples that count, of all logs
Take = Callable[[int, Sequence[Array]], Array]

MOST = 6  # rivals of each list that are told
MOST_TAKEN_UP = 3  # effects that a loosened base takes up, that are told
TAKEN_UP = 0.5  # of its gain beside the file, below which the base has an effect
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
    "recent_speed": ("rad/s", "m/s"),
    "driving_load": ("N m", "N"),
    "wave": ("turn", "turn"),
    "torque": ("N m", "N"),
}
NAMES = {"load_size": "load", "session_time": "time"}


@dataclass(frozen=True)
class _Abscissa:
    """What a residual is shown over.

    Attributes
    ----------
    quantity : str
        As the contract spells it.
    of : int
        The joint whose quantity it is.
    sided : bool
        Whether the residual is shown along the direction of motion.
    values : sequence of (N,) arrays
        By data set; empty where it is the term's own torque.
    """

    quantity: str
    of: int
    sided: bool = False
    values: Sequence[Array] = ()

    def sign(self, scenes: Sequence[Scene], joint: int, take: Take) -> Array | float:
        """Return the direction of motion at a joint's rows where it counts, else 1."""
        if not self.sided:
            return 1.0
        return np.sign(take(joint, [scene.motion.dq[:, joint] for scene in scenes]))


def evidence_of(
    investigation: Investigation, robot: Robot, result: TermResult
) -> EvidenceEntry:
    """Bin what is left without a term and with it.

    Parameters
    ----------
    investigation : Investigation
        All that a diagnosis is made from.
    robot : Robot
        The arm.
    result : TermResult
        The term.

    Returns
    -------
    EvidenceEntry
        At the term's joint, or the one that shows it most.
    """
    term = result.term
    model = result.model
    stage = investigation.ground.stage
    n = investigation.ground.n

    # Its channel that shows it most, and rows of that one. A joint that stands still
    # while others move has none of its own.
    theta = model.linear.theta[model.where(term)]
    of_torque = [c for c in term.channels if c // n != LINKS] or list(term.channels)
    squares = {
        c: float(model.noise.weight[c] @ term.part.torque(c, theta) ** 2)
        for c in of_torque
    }
    own_channels = [c for c in of_torque if squares[c] and term.joint in (c % n, None)]
    channel = max(own_channels or of_torque, key=lambda c: squares[c])
    joint = channel % n
    is_below_cutoff = channel // n != 1
    take = stage.rows.of if is_below_cutoff else stage.high.of
    scenes = [
        scene if is_below_cutoff else scene.full or scene for scene in stage.scenes
    ]

    over = _abscissa(term.what, theta[term.part.at(channel)], scenes, joint)
    x = take(joint, over.values) if over.values else term.part.torque(channel, theta)
    sign = over.sign(scenes, joint, take)
    return _binned(
        robot,
        joint,
        over,
        x,
        before=result.left_without[channel] * sign,
        after=model.linear.left_out[channel] * sign,
    )


def left_over(
    investigation: Investigation, robot: Robot, function: SmoothFunction
) -> EvidenceEntry:
    """Bin what is left at a joint over what it is most like; nothing takes that off."""
    scenes = investigation.ground.stage.scenes
    take = investigation.ground.stage.rows.of
    joint = function.joint
    over = _abscissa(function, np.zeros(0), scenes, joint)
    left_by_scene = investigation.model.left()
    residual = take(joint, [of_scene[:, joint] for of_scene in left_by_scene])
    x = take(joint, over.values) if over.values else residual
    sign = over.sign(scenes, joint, take)
    return _binned(robot, joint, over, x, before=residual * sign)


def pushed(investigation: Investigation, robot: Robot) -> EvidenceEntry:
    """Bin the residual over time around the strongest push; nothing takes that off."""
    event = max(investigation.events, key=lambda each: each.score)
    residual = investigation.model.left()[event.scene]
    scene = investigation.ground.stage.scenes[event.scene]
    near = event.inside(scene, AROUND_S)
    joint = max(event.joints, key=lambda j: float(np.mean(residual[near, j] ** 2)))
    since_start = (scene.motion.t - scene.motion.t[0])[near]
    x = investigation.logs[event.scene].offset + since_start
    over = _Abscissa("time", joint)
    return _binned(robot, joint, over, x, before=residual[near, joint])


def _abscissa(
    what: Candidate | SmoothFunction,
    theta: Array,
    scenes: Sequence[Scene],
    joint: int,
) -> _Abscissa:
    """Return what a term with coefficients theta (k,) goes with."""
    if isinstance(what, SmoothFunction):
        sided = what.factor == "direction"
        axes = [what.axes[0]]
    elif what.effect.over == "wave":
        return _Abscissa("wave", joint, values=_turns(what, theta, scenes, joint))
    elif what.effect.over == "driving_load":
        driving = [
            scene.load[:, joint] * np.sign(scene.motion.dq[:, joint])
            for scene in scenes
        ]
        return _Abscissa("driving_load", joint, what.effect.sided, driving)
    else:
        sided = what.effect.sided
        axis = what.effect.axis(joint, what.settings)
        axes = [axis] if axis else []

    # Where logs share no clock: since each's start.
    if axes and axes[0].measure == "session_time":
        axes.append(Axis("time", axes[0].joint))
    for axis in axes:
        values = [axis.values(scene) for scene in scenes]
        in_all_logs = [of_scene for of_scene in values if of_scene is not None]
        if len(in_all_logs) == len(scenes):
            quantity = NAMES.get(axis.measure, axis.measure)
            return _Abscissa(quantity, axis.joint, sided, in_all_logs)
    return _Abscissa("torque", joint)


def _turns(
    candidate: Candidate, theta: Array, scenes: Sequence[Scene], joint: int
) -> list[Array]:
    """Return the place (N,) on a wave, in turns by data set: 0 where it rises.

    Columns are sine and cosine of each wave, in turn.
    """
    a = theta[::2]
    b = theta[1::2]
    turns = []
    for scene in scenes:
        X = candidate.columns(scene)[joint]
        sine = X[:, ::2] @ a + X[:, 1::2] @ b
        cosine = X[:, 1::2] @ a - X[:, ::2] @ b
        turns.append(np.mod(np.arctan2(sine, cosine) / (2 * np.pi), 1.0))
    return turns


def _binned(
    robot: Robot,
    joint: int,
    over: _Abscissa,
    x: Array,
    before: Array,
    after: Array | None = None,
) -> EvidenceEntry:
    """Return means and spreads over x (M,) of residuals (M,) N m.

    `after` is None where nothing takes the residual off.
    """
    bins = _bins(x)
    before_parts = [before[part] for part in bins]
    after_parts = [after[part] for part in bins] if after is not None else []
    of_revolute, of_prismatic = UNITS.get(over.quantity, ("", ""))
    is_prismatic = robot.joints[over.of].prismatic
    return EvidenceEntry(
        joint=robot.joint_names[joint],
        quantity=over.quantity,
        of=robot.joint_names[over.of],
        unit=of_prismatic if is_prismatic else of_revolute,
        sided=over.sided,
        x=_rounded(np.mean, [x[part] for part in bins]),
        count=[len(part) for part in bins],
        before=_rounded(np.mean, before_parts),
        before_spread=_rounded(np.std, before_parts),
        after=_rounded(np.mean, after_parts),
        after_spread=_rounded(np.std, after_parts),
    )


def _bins(x: Array) -> list[Index]:
    """Return the indices of each bin of x (M,), ascending.

    Bins are narrow, have enough samples, and go over no gap.
    """
    if not len(x):
        return []
    low = float(np.min(x))
    span = float(np.ptp(x))
    if span == 0.0:
        return [np.arange(len(x))]

    cell = np.minimum((CELLS * (x - low) / span).astype(np.intp), CELLS - 1)
    count = np.bincount(cell, minlength=CELLS)
    starts = [0]  # the first cell of each bin
    for filled, next_filled in pairwise(np.flatnonzero(count).tolist()):
        is_enough = count[starts[-1] : filled + 1].sum() >= LEAST * len(x)
        if is_enough or next_filled - filled > GAP:
            starts.append(filled + 1)
    bin_of_sample = np.searchsorted(starts, cell, side="right") - 1
    return [np.flatnonzero(bin_of_sample == number) for number in range(len(starts))]


def _rounded(
    statistic: Callable[[Array], np.floating], parts: Sequence[Array]
) -> list[float]:
    return [float(f"{statistic(part):.{DIGITS}g}") for part in parts]


def rivals_of(
    robot: Robot, result: TermResult, likely_names: Collection[str] = ()
) -> list[RivalEntry]:
    """Return what was tried in a term's place, the largest gain first.

    Parameters
    ----------
    robot : Robot
        The arm.
    result : TermResult
        The term.
    likely_names : collection of str
        Effects that could be it as well; these are told before others.
    """
    rivals = _each_once(
        rival for rival in result.rivals if rival.term.key != result.term.key
    )
    # What is as likely, and what gains more, is always told.
    gain = result.scored.score.total
    rivals.sort(
        key=lambda rival: (
            rival.term.name not in likely_names and rival.score.total <= gain
        )
    )
    first_rivals = sorted(rivals[:MOST], key=lambda rival: -rival.score.total)
    return [
        _rival_entry(robot, rival, _why_not_in_place(rival, result, likely_names))
        for rival in first_rivals
    ]


def tried_at(
    investigation: Investigation, robot: Robot, joint: int
) -> list[RivalEntry]:
    """Return what was tried at a joint beside what was taken, the largest gain first.

    Parameters
    ----------
    investigation : Investigation
        All that a diagnosis is made from.
    robot : Robot
        The arm.
    joint : int
        Index of the joint.
    """
    n = investigation.ground.n
    at_joint = []
    for scored in investigation.selection.untaken:
        joints = {channel % n for channel in scored.term.channels}
        if joint in joints:
            at_joint.append(scored)
    first_terms = _each_once(at_joint)[:MOST]
    options = investigation.ground.options
    return [
        *_not_told_at(investigation, robot, joint),
        *(
            _rival_entry(robot, scored, _why_not_beside(scored, options))
            for scored in first_terms
        ),
    ]


def _not_told_at(
    investigation: Investigation, robot: Robot, joint: int
) -> list[RivalEntry]:
    """Return what the model has at a joint beside what is told, the largest first."""
    model = investigation.model
    n = investigation.ground.n
    told_keys = {result.term.key for result in investigation.selection.terms}
    scored_terms = [
        again(term, model)
        for term in model.terms
        if term.key not in told_keys
        and joint in {channel % n for channel in term.channels}
    ]
    scored_terms.sort(key=lambda scored: -scored.score.total)
    return [
        _rival_entry(
            robot,
            scored,
            "is in the model for the sake of what is told, and not told: its name is"
            " too unsure, or it may be the error of another law",
        )
        for scored in scored_terms
    ]


def taken_up_at(
    investigation: Investigation, robot: Robot, joint: int
) -> list[RivalEntry]:
    """Return effects of a joint that a loosened base has taken up.

    Beside the file as it is they gain, beside a base that may leave the file by many of
    its errors they do not.

    Parameters
    ----------
    investigation : Investigation
        All that a diagnosis is made from.
    robot : Robot
        The arm.
    joint : int
        Index of the joint.
    """
    model = investigation.model
    ground = investigation.ground
    loosest = max(model.hold.rigid, model.hold.of(joint))
    if loosest <= 1.0 or not ground.stage.rows.count(joint):
        return []
    held = investigation.held_model
    catalogue = tuple(catalogue_of(robot).values())
    fitted = Search(held, catalogue).effects_at(joint, held)
    keys = {term.key for term in model.terms}
    terms = [each.term for each in fitted if each.term.key not in keys]
    if not terms:
        return []
    parts = [term.part for term in terms]
    entries = []
    for term, score, beside_loose in zip(
        terms, held.linear.scores(parts), model.linear.scores(parts), strict=True
    ):
        gain = score.total
        is_worth_it = score.share > ground.options.improvement
        if is_worth_it and beside_loose.total < TAKEN_UP * gain:
            why = (
                f"the base takes it up: held to the file it gains {gain:.0f} nats,"
                f" beside a base that may leave the file by {loosest:g} of its errors"
                f" {max(beside_loose.total, 0.0):.0f}"
            )
            entries.append(
                RivalEntry(
                    effect=term.name,
                    joint=robot.name_of(term.joint),
                    log_gain=gain,
                    why_not=why,
                )
            )
    entries.sort(key=lambda entry: -(entry.log_gain or 0.0))
    return entries[:MOST_TAKEN_UP]


def _each_once(scored_terms: Iterable[ScoredTerm]) -> list[ScoredTerm]:
    """Return the first of every name at every joint; of smooth functions the first."""
    first: dict[object, ScoredTerm] = {}
    for scored in scored_terms:
        key = "smooth" if scored.term.smooth else scored.term.key
        first.setdefault(key, scored)
    return list(first.values())


def _rival_entry(robot: Robot, scored: ScoredTerm, why_not: str) -> RivalEntry:
    name = scored.term.name
    return RivalEntry(
        effect=f"some function of {name}" if scored.term.smooth else name,
        joint=robot.name_of(scored.term.joint),
        log_gain=scored.score.total,
        why_not=why_not,
    )


def _why_not_in_place(
    rival: ScoredTerm, result: TermResult, likely_names: Collection[str]
) -> str:
    """Say why a rival was not taken in a term's place."""
    reach = rival.score.total / max(result.scored.score.total, 1e-300)
    if rival.term.name in likely_names:
        return (
            f"these logs cannot tell the two apart: it reaches {percent(reach)} of the"
            " gain"
        )
    if reach <= 0.0:
        return "predicts nothing in its place"
    if reach < 1.0 - result.model.ground.options.negligible_share:
        return f"explains {percent(1.0 - reach)} less"
    of_rival = rival.term.freedom
    of_term = result.term.freedom
    if reach > 1.0 and of_rival > of_term:
        return (
            f"gains {percent(reach - 1.0)} more, and needs {of_rival} parameters, not"
            f" {of_term}"
        )
    if reach > 1.0:
        return (
            f"gains {percent(reach - 1.0)} more: no more than chance, or a share that"
            " does not matter"
        )
    if of_rival > of_term:
        return (
            f"needs {of_rival} parameters, not {of_term}, to reach {percent(reach)} of"
            " the gain"
        )
    return f"no better: it reaches {percent(reach)} of the gain"


def _why_not_beside(scored: ScoredTerm, options: Options) -> str:
    """Say why something was not taken beside all that was."""
    score = scored.score
    log_bayes_factor = scored.fit.log_bayes_factor
    if score.total <= 0.0:
        return "predicts left-out blocks worse than the model without it"
    if score.doubt >= options.alpha:
        return (
            f"gains nothing in {percent(score.doubt)} of drawn blocks of time;"
            f" {percent(options.alpha)} is allowed at most"
        )
    if log_bayes_factor <= options.min_log_bayes_factor:
        return (
            f"log evidence of {log_bayes_factor:.1f}, as of noise;"
            f" {options.min_log_bayes_factor:g} is asked at least"
        )
    if score.share <= options.improvement:
        return (
            f"takes away {percent(score.share)} of the squared error;"
            f" {percent(options.improvement)} is asked at least"
        )
    return "was taken, and removed again: not worth it once all was fitted together"
