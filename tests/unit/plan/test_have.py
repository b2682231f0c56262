"""Logs that are recorded already: their information, and what the plan makes of it."""

import numpy as np

from seqid_cli.inspect.screening import read_screened
from seqid_cli.params.schema import Stages
from seqid_cli.plan.belief import belief_of, information_of
from seqid_cli.plan.limits import limits_of
from seqid_cli.plan.make import make_plan
from seqid_cli.plan.options import PlanOptions
from tests.plants.robots.sample import SAMPLES, sample_robot

OPTIONS = PlanOptions(duration_s=12.0, move_s=4.0, pool=30, sweeps=1)


def test_logs_count_and_lower_the_errors() -> None:
    robot = sample_robot("two_joint")
    limits = limits_of(robot, ramp_s=0.3)
    logs = sorted((SAMPLES / "two_joint" / "inertia").iterdir())
    recordings = [read_screened(log, robot, imus=False).recording for log in logs]
    belief = belief_of(robot, Stages(), limits)
    once = information_of(belief, recordings)
    assert np.linalg.eigvalsh(once).min() >= -1e-9 * np.abs(once).max()
    assert np.allclose(information_of(belief, recordings * 2), 2 * once)
    alone = make_plan("inertia", robot, limits, Stages(), OPTIONS)
    more = make_plan("inertia", robot, limits, Stages(), OPTIONS, have=recordings)
    before = {p.name: p.std_error for p in alone.stages["inertia"].parameters}
    after = {p.name: p.std_error for p in more.stages["inertia"].parameters}
    assert after.keys() >= before.keys()
    assert np.median([after[name] / before[name] for name in before]) < 0.95
    assert not np.any(information_of(belief, []))
