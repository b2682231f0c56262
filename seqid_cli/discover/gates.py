"""How large a gain must be to mean something: what clean data of this robot and log set give.

Significance is not enough: with tens of thousands of samples every imperfection of a log is
significant. The level is therefore taken from logs as they would be if the model were right
(parametric bootstrap, `clean`), which pass through the whole screening again.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from seqid_cli.discover.base import base_of
from seqid_cli.discover.candidates import Stage, Tried
from seqid_cli.discover.clean import CleanLogs
from seqid_cli.discover.dependence import Dependence, dependence
from seqid_cli.discover.events import GATE, Interval, event_masks, event_score
from seqid_cli.discover.options import DiscoverOptions
from seqid_cli.discover.rows import Rows, rows_of
from seqid_cli.discover.scenes import scenes_of
from seqid_cli.discover.search import Search
from seqid_cli.discover.system import LEAST_STEADY
from seqid_cli.logs.recording import Recording
from seqid_cli.model.effects.registry import CATALOGUE
from seqid_cli.params.schema import Stages

Array = NDArray[np.float64]

# Shares of one joint's squared residual below which nothing is worth a name: 2 % of its RMSE, and
# for smooth functions, the best of hundreds, 4 %. Slow torque noise alone reaches 0.036 and 0.075.
LEAST = 0.04
LEAST_SMOOTH = 0.08
MARGIN = 2.0  # over the largest gain on clean data
# Rows' worth of gain that the luckiest of some hundred candidates has on noise: 2 ln(200), twice
# that for rows that are correlated, and twice again to be sure.
CHANCE = 50.0
MUCH = 0.3  # of the squared residual: an effect that gains it may do so on fewer folds
STEADY_IF_MUCH = 1.1
SMOOTH_RUNS = 2  # clean data sets that smooth functions look at, being slow
EVENT_MARGIN = 1.4
SMOOTH = ""  # the name under which smooth functions are counted


@dataclass(frozen=True)
class Gates:
    """Largest relative gain of each effect, and of smooth functions, on clean data.

    `event` is the score that an event must reach, in robust sigmas.
    """

    clean: Mapping[str, float] = field(default_factory=dict)
    event: float = GATE

    def joined(self, other: Gates) -> Gates:
        """The higher levels of two calibrations."""
        names = {*self.clean, *other.clean}
        top = {k: max(self.clean.get(k, 0.0), other.clean.get(k, 0.0)) for k in sorted(names)}
        return Gates(top, max(self.event, other.event))

    def least(self, name: str, joints: int = 1) -> float:
        """Relative gain from which an effect at so many joints is believed.

        What shows at many joints needs less of each: it must be worth as much as at one.
        """
        floor = LEAST_SMOOTH if name == SMOOTH else LEAST / max(joints, 1)
        return max(floor, MARGIN * self.clean.get(name, 0.0))

    def least_of(self, tried: Tried) -> float:
        """Relative gain from which a candidate is believed: more of few rows, or of few folds."""
        rows = max(len(X) for X in tried.columns.values())
        chance = CHANCE / max(rows, 1)
        least = max(self.least(tried.candidate.effect.name, tried.trial.joints), chance)
        return least * tried.trial.scarcity

    def passes(self, tried: Tried) -> bool:
        """Whether a candidate gains more than clean data show, on the folds alike.

        Or so much that it matters less how few they are: coefficients of the other folds, where
        little of it is seen, foretell what quick moves show. A single fold is never enough.
        """
        least = LEAST_STEADY if tried.trial.relative < MUCH else STEADY_IF_MUCH
        enough = tried.trial.relative >= self.least_of(tried)
        return enough and tried.trial.steadiness >= least


def calibrated(
    logs: Sequence[Recording],
    search: Search,
    smooth: Sequence[Dependence],
    stages: Stages,
    options: DiscoverOptions,
    events: Sequence[Interval] = (),
) -> Gates:
    """Screen clean data sets made from what a search has arrived at.

    Only what was found is looked for in them: the level of other effects is not asked.

    Parameters
    ----------
    logs : sequence of Recording
        As they were searched.
    search : Search
        Its base is taken for the truth, what it leaves for the noise.
    smooth : sequence of Dependence
        What smooth functions found beside the effects; that is no noise either.
    stages : Stages
    options : DiscoverOptions
    events : sequence of Interval
        What clean data do not have.
    """
    scenes = search.stage.scenes
    told = replace(search, smooth=(*search.smooth, *(r for look in smooth for r in look.rivals)))
    system = told.system()
    # Where joints do not slide the logs' own torque is kept: it must not hold what was found.
    freed = [
        replace(log, tau=log.tau - torque)
        for log, torque in zip(logs, told.effect_torques(system), strict=True)
        if log.tau is not None
    ]
    left = quiet(search.stage.rows, told.residual(system))
    deviation = told.deviation(system)
    masks = event_masks(search.stage.rows, events)
    rng = np.random.default_rng(options.seed)
    gates = Gates()
    for run in range(options.clean_runs):
        # The file is as uncertain as it says: what it has wrong leaves residuals, too.
        wrong = told.base.drawn_deviation(rng)
        truth = [one + other for one, other in zip(deviation, wrong, strict=True)]
        drawn = CleanLogs.of(freed, scenes, left, truth, masks).draw(rng)
        looked = smooth if run < SMOOTH_RUNS else ()
        gates = gates.joined(_screened(drawn, search, looked, stages, options))
    return gates


def _screened(
    drawn: Sequence[Recording],
    search: Search,
    smooth: Sequence[Dependence],
    stages: Stages,
    options: DiscoverOptions,
) -> Gates:
    """What one clean data set shows of what was found."""
    robot = search.stage.scenes[0].robot
    rows = rows_of(scenes_of(drawn, robot, stages, options=options.motion))
    base = base_of(rows, stages)
    fresh = Search.begin(Stage(rows), base, kept=search.kept, broad=search.broad)
    system = fresh.system()
    clean: dict[str, float] = {}
    effects = [CATALOGUE[n] for n in sorted({t.candidate.effect.name for t in search.accepted})]
    for tried in fresh.ranked(effects, system, refine=0):
        name = tried.candidate.effect.name
        clean[name] = max(clean.get(name, 0.0), tried.trial.relative)
    looks = [dependence(system, d.joint, least_gain=0.0, most=1) for d in smooth]
    clean[SMOOTH] = max((look.relative for look in looks), default=0.0)
    event = EVENT_MARGIN * event_score(rows, system.left_out()[: rows.n])
    return Gates(clean, max(GATE, event))


def quiet(rows: Rows, residual: Sequence[Array]) -> list[Array]:
    """Residuals (N, n) with zeros where a joint's rows do not count, as in events."""
    result = []
    for values, picked, used in zip(residual, rows.picked, rows.used, strict=True):
        nearest = np.searchsorted(picked, np.arange(len(values)), side="right") - 1
        result.append(np.where(used[nearest], values, 0.0))
    return result
