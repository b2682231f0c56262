"""Whether friction over a wider range would pay: what sweeps lose by keeping to it.

The plan with the friction that is given is compared with one that knew it everywhere,
both without the errors of the surfaces, and both by a quick search.
"""

from dataclasses import dataclass, replace

import numpy as np

from seqid_cli.params.results.plan import PlannedStage
from seqid_cli.params.schema import Stages
from seqid_cli.plan.belief import Belief
from seqid_cli.plan.options import PlanOptions
from seqid_cli.plan.stages.coverage import Coverage, ramp_way
from seqid_cli.plan.stages.goal import Planned
from seqid_cli.plan.stages.gravity_sweeps.prediction import predicted
from seqid_cli.plan.stages.gravity_sweeps.search import quick_sweeps
from seqid_cli.plan.stages.gravity_sweeps.space import (
    Sweeps,
    SweepSpace,
    draw_sweeps,
)
from seqid_cli.plan.stages.sweeps import plan_friction
from seqid_cli.shares import percent


@dataclass(frozen=True)
class WiderFriction:
    """Notes on joints whose friction is known too narrowly; trials where they pay."""

    notes: list[str]
    trials: Planned | None = None


def wider_friction(
    belief: Belief,
    coverage: Coverage,
    per_joint: int,
    options: PlanOptions,
    *,
    worth: float,
    narrow: float = 0.8,
) -> WiderFriction:
    """Plan friction trials over the whole ranges, where gravity's sweeps would pay.

    Parameters
    ----------
    belief : Belief
    coverage : Coverage
        Where friction is known.
    per_joint : int
        Sweeps of each joint that gravity loads.
    options : PlanOptions
    worth : float
        Share by which the torque's error has to fall.
    narrow : float
        A joint is tried again where its sweeps cover less than this share of what they
        could.

    Returns
    -------
    WiderFriction
    """
    # Neither what earlier stages know of gravity nor errors of friction count.
    bare = replace(
        belief,
        prior=np.zeros_like(belief.prior),
        surfaces=[None] * belief.robot.n,
    )
    wide, wide_pool = draw_sweeps(bare, Coverage.everywhere(bare), options)
    lacking = [
        j
        for j in wide.joints
        if _covers_little(wide, wide_pool, coverage, j, narrow=narrow)
    ]
    if not lacking:
        return WiderFriction([])
    notes = _notes_on_ranges(belief, coverage, lacking)

    # Both by the same quick search: what it misses, it misses in both.
    space, pool = draw_sweeps(bare, coverage, options)
    covered = predicted(
        space, quick_sweeps(space, pool, per_joint, options), Stages(), options
    ).stage
    everywhere = predicted(
        wide, quick_sweeps(wide, wide_pool, per_joint, options), Stages(), options
    ).stage
    gain = _largest_gain(covered, everywhere)
    lacks_rank = (covered.rank or 0) < (everywhere.rank or 0)
    if gain < worth and not lacks_rank:
        return WiderFriction(notes)

    names = [belief.robot.joint_names[j] for j in lacking]
    notes.append(
        "more range would pay: with friction known over the whole range of"
        f" {', '.join(names)} the torque's error would fall by {percent(gain, 0)};"
        " friction trials for it are planned as well, record them, run seqid friction"
        " with all, and plan gravity again"
    )
    trials = plan_friction(belief, options)
    moves = [move for move in trials.moves if move.joints[0] in names]
    errors = {name: trials.stage.torque_error[name] for name in names}
    return WiderFriction(notes, Planned(moves, PlannedStage(torque_error=errors)))


def _covers_little(
    wide: SweepSpace, wide_pool: Sweeps, coverage: Coverage, j: int, *, narrow: float
) -> bool:
    """Return whether joint j sweeps less than it could, as friction is not known."""
    reach = float(np.max(np.diff(wide_pool.ends[wide_pool.joint == j]), initial=0.0))
    covered = 0.0
    if coverage.is_known[j]:
        covered = float(coverage.upper[j] - coverage.lower[j])
    acceleration = float(wide.belief.limits.acceleration[j])
    ramp = ramp_way(float(wide.speed[j]), acceleration)
    return covered < narrow * reach - 2.0 * ramp


def _notes_on_ranges(
    belief: Belief, coverage: Coverage, lacking: list[int]
) -> list[str]:
    """Return notes on joints whose friction is known too narrowly, or not at all."""
    notes = []
    narrow = [j for j in lacking if coverage.is_known[j]]
    if narrow:
        ranges = "; ".join(coverage.text(belief, j) for j in narrow)
        notes.append(
            "sweeps keep to the friction that is given, rows outside would be lost:"
            f" {ranges}"
        )
    unknown = [belief.robot.joint_names[j] for j in lacking if not coverage.is_known[j]]
    if unknown:
        notes.append(
            f"no friction is given for {', '.join(unknown)}: their sweeps would be"
            " left out"
        )
    return notes


def _largest_gain(covered: PlannedStage, everywhere: PlannedStage) -> float:
    """Return the largest share by which a joint's torque error falls."""
    gains = []
    for name, error_everywhere in everywhere.torque_error.items():
        error_covered = covered.torque_error[name]
        if error_covered > 0.0:
            gains.append(1.0 - error_everywhere / error_covered)
    return max(gains, default=0.0)
