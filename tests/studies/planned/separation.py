"""Does `plan discriminate` separate what a log at hand does not tell apart? On two joints.

Each case is a pair of the catalogue's page and of the literature: one effect at a joint, a short
log in which the diagnosis leaves the other name open, the motion planned with that log, recorded on
the same plant, and a second diagnosis of all logs. The plan was tuned on one seed, joint and size,
and judged on others once.
"""

import argparse
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path

from seqid_cli.discover.diagnosis import diagnose
from seqid_cli.discover.options import DiscoverOptions
from seqid_cli.logs.recording import Recording
from seqid_cli.params.schema import Stages
from seqid_cli.plan.belief import belief_of
from seqid_cli.plan.discrimination.discriminate import ENOUGH, plan_discriminate
from seqid_cli.plan.limits import limits_of
from seqid_cli.plan.options import PlanOptions
from seqid_cli.robot.types import Robot
from tests.plants.motions.trials import drills
from tests.plants.planned import recorded
from tests.studies.records import package_sources, results
from tests.studies.tables import table
from tests.studies.undeclared.cases import Condition, built, declared
from tests.studies.undeclared.logs import plant_sources, robot_for, stages_of, stored

SECONDS, MOVE_S = 24.0, 8.0  # of the plan, of each move
LOG_S = 8.0  # of the log before
LATER_S = 2000.0  # s since power-on, when the planned moves are recorded
EARLIER = 50  # added to the seed: the model is of logs without the effect
LOGS = ("fast", "moves", "slow")  # tried in turn, until one leaves the rival open


@dataclass(frozen=True)
class Drawn:
    """Seed of motions and noise, number of the joint, sizes that are tried in turn."""

    seed: int
    joint: int
    sizes: tuple[float, ...]


DRAWN = {"Tuned on": Drawn(0, 1, (1.0, 0.4)), "Judged on": Drawn(43, 0, (0.7, 0.3))}
PAIRS = (
    ("asymmetric_friction", "torque_bias"),
    ("torque_bias", "asymmetric_friction"),
    ("torque_bias", "spring"),
    ("spring", "torque_bias"),
    ("load_dependent_friction", "gear_efficiency"),
    ("gear_efficiency", "load_dependent_friction"),
    ("load_dependent_friction", "position_dependent_friction"),
    ("torque_saturation", "gear_efficiency"),
    ("quadratic_drag", "nonlinear_viscous"),
    ("nonlinear_viscous", "quadratic_drag"),
    ("stribeck", "presliding_hysteresis"),
    ("presliding_hysteresis", "backlash"),
    ("presliding_hysteresis", "stribeck"),
    ("spring", "payload"),
    ("actuator_lag", "time_skew"),
    ("joint_elasticity", "time_skew"),
    ("torque_ripple", "encoder_eccentricity"),
)


@dataclass(frozen=True)
class Outcome:
    """One case: the names before and after, and what the plan said; no log where none is open."""

    effect: str
    rival: str
    joint: str
    log: str = ""
    size: float = 1.0
    before: Sequence[str] = ()
    power: float = 0.0  # that the rival is dropped, as the plan says
    imitated: float = 1.0
    after: Sequence[str] = ()

    @property
    def separated(self) -> bool:
        """Whether the effect is found afterwards, and no longer confused with the rival."""
        return self.effect in self.after and self.rival not in self.after

    @property
    def told(self) -> bool:
        """Whether the plan says beforehand that the rival may stay."""
        return self.power < ENOUGH


def study(chosen: argparse.Namespace) -> str:
    """Names before and after the planned motion, case by case."""
    sources = package_sources("plan", "discover", "model") + plant_sources()
    parts = {}
    for name, drawn in DRAWN.items() if not chosen.quick else list(DRAWN.items())[:1]:
        found = results(
            {"-".join(pair): pair for pair in (PAIRS[:2] if chosen.quick else PAIRS)},
            partial(outcome, drawn=drawn, cache=chosen.cache),
            Outcome,
            chosen.cache / "separation" / f"{drawn.seed}_{drawn.joint}.jsonl",
            sources=sources,
        )
        parts[name] = _table(list(found.values()))
    return "\n\n".join(f"{name}: {text}" for name, text in parts.items())


def _table(found: Sequence[Outcome]) -> str:
    open_ = [o for o in found if o.log]
    right = sum(o.separated or o.told for o in open_)
    parted, promised = sum(o.separated for o in open_), [o for o in open_ if not o.told]
    head = ["effect", "log, size", "names before", "planned against", "it reaches up to",
            "plan: dropped with", "names after", "answer"]  # fmt: skip
    rows = [
        [o.effect, f"{o.log}, {o.size:g}", ", ".join(o.before), o.rival, f"{o.imitated:.1%}",
         f"{o.power:.0%}", ", ".join(o.after), _answer(o)]
        for o in open_
    ]  # fmt: skip
    closed = ", ".join(f"{o.effect} against {o.rival}" for o in found if not o.log)
    return (
        f"of {len(open_)} pairs that a log leaves open {parted} are separated, {right} separated or"
        f" told beforehand; of {len(promised)} that the plan promises"
        f" {sum(o.separated for o in promised)} are separated.\n\n{table(head, rows)}\n\n"
        f"Not open on any of these logs: {closed or 'none'}."
    )


def _answer(o: Outcome) -> str:
    if o.separated:
        return "separated, though not promised" if o.told else "separated"
    return "told beforehand" if o.told else "no"


def outcome(pair: tuple[str, str], drawn: Drawn, cache: Path) -> Outcome:
    """One pair: the first log that leaves the rival open, and what the plan makes of it."""
    effect, rival = pair
    clean = Condition("clean", "two", drawn.seed + EARLIER)
    stages = stages_of(clean, cache)
    for case, robot, log in _logs(effect, drawn, cache):
        names = _names([log], robot, stages, pair)
        if rival in names:
            return _after(case, pair, robot, stages, log, names)
    return Outcome(effect, rival, robot_for(clean).joint_names[drawn.joint])


def _logs(effect: str, drawn: Drawn, cache: Path) -> Iterator[tuple[Condition, Robot, Recording]]:
    seed = drawn.seed
    for size in drawn.sizes:
        case = Condition("catalogue", "two", seed, ((effect, drawn.joint, size),), seconds=LOG_S)
        plant, robot = built(case)[0], robot_for(case)
        for drill in drills(declared(case), seed, seconds=LOG_S):
            if drill.name in LOGS:
                what = f"{case.effects}|{drill.name}"
                log = stored(cache, what, plant, drill.reference, seed, every=2, start=drill.start)
                yield case, robot, log


def _names(
    logs: Sequence[Recording], robot: Robot, stages: Stages, pair: tuple[str, str]
) -> list[str]:
    """All names of the finding that is the effect, or its rival."""
    found = diagnose(logs, robot, stages, options=DiscoverOptions()).findings
    every = [[f.effect, *f.confusable_with] for f in found]
    return next((names for names in every if set(pair) & set(names)), [])


def _after(
    case: Condition,
    pair: tuple[str, str],
    robot: Robot,
    stages: Stages,
    log: Recording,
    before: list[str],
) -> Outcome:
    """Plan with the log at hand, record on the same plant, and diagnose all logs."""
    effect, joint, size = case.effects[0]
    at = robot.joint_names[joint]
    belief = belief_of(robot, stages, limits_of(robot, ramp_s=0.4))
    options = PlanOptions(duration_s=SECONDS, move_s=MOVE_S, between=pair, joint=at, seed=case.seed)
    planned = plan_discriminate(belief, stages, options, [log])
    told = planned.stage.separation
    power, imitated = (told.powers[0], told.imitations[0]) if told else (0.0, 1.0)
    more = recorded(built(case)[0], planned.moves, case.seed, start=LATER_S)
    after = _names([log, *more], robot, stages, pair)
    name = log.path.name
    return Outcome(effect, pair[1], at, name, size, before, power, imitated, after)
