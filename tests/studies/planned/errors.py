"""Predicted standard errors against those obtained afterwards, on six-joint plants
built anew.
"""

from argparse import Namespace
from collections.abc import Sequence

import numpy as np

from seqid_cli.identify.options import InertiaOptions
from seqid_cli.logs.recording import Recording
from seqid_cli.params.results.plan import PlannedStage
from seqid_cli.params.schema import RigidStage, Stages
from seqid_cli.plan.belief import belief_of, information_of
from seqid_cli.plan.limits import limits_of
from seqid_cli.plan.options import PlanOptions
from seqid_cli.plan.stages.inertia import plan_inertia
from seqid_cli.robot.types import Array
from tests.plants.arms.rigs import six_joint
from tests.plants.motions.experiments import friction_trials, gravity_trials
from tests.plants.planned import recorded
from tests.plants.robots.identified import before_inertia, with_inertia
from tests.plants.robots.lab import run
from tests.plants.samples import SIX_POSTURES
from tests.studies.rigs.repetition import another
from tests.studies.tables import number, share_within, table

SEED, ARMS, DRAWS = 77, 3, 2
EVERY = 4  # control periods per row: 250 Hz
FIRST = PlanOptions(duration_s=40.0, ramp_s=0.2, sweeps=1, seed=5)
OPTIONS = PlanOptions(duration_s=150.0, ramp_s=0.2)


def study(chosen: Namespace) -> str:
    """Ratios of obtained to predicted errors of every arm; there is no quick way to
    them.
    """
    rows = [row for arm in range(ARMS) for row in compared(arm, DRAWS)]
    return table(
        ["arm", "parameters", "within 25 %", "median ratio", "smallest", "largest"],
        rows,
    )


def compared(arm: int, draws: int) -> list[list[str]]:
    plant = another(six_joint(), np.random.default_rng([SEED, arm]))
    slow = gravity_trials(plant, list(SIX_POSTURES[:5]), speeds=(0.3,))
    trials = [*friction_trials(plant, SIX_POSTURES[0], lowest=0.08), *slow]
    experiment = run("six_joint", plant, trials, arm, every=EVERY)
    robot, before = (
        experiment.robot,
        before_inertia(experiment.recordings, experiment.robot),
    )

    def inertia(logs: Sequence[Recording]) -> Stages:
        return with_inertia({"inertia": logs}, robot, before, InertiaOptions())

    belief = belief_of(robot, before, limits_of(robot, ramp_s=FIRST.ramp_s))
    first = recorded(
        plant, plan_inertia(belief, before, FIRST).moves, 900 + arm, every=EVERY
    )
    stages = inertia(first)
    belief = belief_of(robot, stages, limits_of(robot, ramp_s=OPTIONS.ramp_s))
    rows = []
    for label, logs in (("", []), (", with --have", first)):
        planned = plan_inertia(belief, stages, OPTIONS, information_of(belief, logs))
        obtained = []
        for draw in range(draws):
            more = recorded(plant, planned.moves, 7000 + 97 * arm + draw, every=EVERY)
            obtained.append(inertia([*logs, *more]).inertia)
        found = ratios(planned.stage, obtained)
        numbers = [number(x, 3) for x in (np.median(found), found.min(), found.max())]
        share = f"{share_within(found - 1.0, 0.25):.0%}".replace("%", " %")
        rows.append([f"{arm + 1}{label}", str(len(found)), share, *numbers])
    return rows


def ratios(planned: PlannedStage, obtained: Sequence[RigidStage]) -> Array:
    """Obtained standard errors, RMS over the draws, over the predicted ones."""
    squares = [{p.name: p.std_error**2 for p in stage.parameters} for stage in obtained]
    return np.array(
        [
            np.sqrt(np.mean([own[p.name] for own in squares])) / p.std_error
            for p in planned.parameters
            if all(p.name in own for own in squares)
        ]
    )
