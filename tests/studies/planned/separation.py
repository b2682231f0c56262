"""Does `plan discriminate` separate what a log at hand does not tell apart?

On two joints.
"""

import argparse
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path

from seqid_cli.discover.diagnosis import diagnose
from seqid_cli.discover.options import DiscoverOptions
from seqid_cli.logs.recording import Recording
from seqid_cli.plan.belief import belief_of
from seqid_cli.plan.discrimination.discriminate import plan_discriminate
from seqid_cli.plan.limits import limits_of
from seqid_cli.plan.options import PlanOptions
from seqid_cli.plan.settings import DiscriminationSettings
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

# Seed of motions and noise, number of the joint, sizes that are tried in turn.
Drawn = tuple[int, int, tuple[float, ...]]
DRAWN: Mapping[str, Drawn] = {
    "Tuned on": (0, 1, (1.0, 0.4)),
    "Judged on": (43, 0, (0.7, 0.3)),
}
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
# By whether the pair is separated, and whether the plan says beforehand that it may not
# be.
ANSWERS = {
    (True, True): "separated, though not promised",
    (True, False): "separated",
    (False, True): "told beforehand",
    (False, False): "no",
}


@dataclass(frozen=True)
class Outcome:
    """One case: the names before and after, and what the plan said; no log where none
    is open.
    """

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
        """Whether the effect is found afterwards, and no longer confused with the
        rival.
        """
        return self.effect in self.after and self.rival not in self.after

    @property
    def told(self) -> bool:
        return self.power < DiscriminationSettings().min_power


def study(chosen: argparse.Namespace) -> str:
    sources = package_sources("plan", "discover", "model") + plant_sources()
    parts = []
    pairs = {"-".join(pair): pair for pair in (PAIRS[:2] if chosen.quick else PAIRS)}
    for name, drawn in list(DRAWN.items())[: 1 if chosen.quick else None]:
        path = chosen.cache / "separation" / f"{drawn[0]}_{drawn[1]}.jsonl"
        work = partial(outcome, drawn=drawn, cache=chosen.cache)
        found = results(pairs, work, Outcome, path, sources=sources)
        parts.append(f"{name}: {_table(list(found.values()))}")
    return "\n\n".join(parts)


def _table(found: Sequence[Outcome]) -> str:
    open_ = [o for o in found if o.log]
    right = sum(o.separated or o.told for o in open_)
    parted, promised = sum(o.separated for o in open_), [o for o in open_ if not o.told]
    head = [
        "effect",
        "log, size",
        "names before",
        "planned against",
        "it reaches up to",
    ]
    head += ["plan: dropped with", "names after", "answer"]
    rows = [
        [
            o.effect,
            f"{o.log}, {o.size:g}",
            ", ".join(o.before),
            o.rival,
            f"{o.imitated:.1%}",
            f"{o.power:.0%}",
            ", ".join(o.after),
            ANSWERS[o.separated, o.told],
        ]
        for o in open_
    ]
    closed = ", ".join(f"{o.effect} against {o.rival}" for o in found if not o.log)
    return (
        f"of {len(open_)} pairs that a log leaves open {parted} are separated, {right}"
        f" separated or told beforehand; of {len(promised)} that the plan promises"
        f" {sum(o.separated for o in promised)} are"
        f" separated.\n\n{table(head, rows)}\n\nNot open on any of these logs:"
        f" {closed or 'none'}."
    )


def outcome(pair: tuple[str, str], drawn: Drawn, cache: Path) -> Outcome:
    """One pair: the first log that leaves the rival open, and what the plan makes of
    it.
    """
    (effect, rival), (seed, joint, sizes) = pair, drawn
    clean = Condition("clean", "two", seed + EARLIER)
    robot, stages = robot_for(clean), stages_of(clean, cache)
    at = robot.joint_names[joint]

    def names(logs: Sequence[Recording]) -> list[str]:
        """All names of the finding that is the effect, or its rival."""
        found = diagnose(logs, robot, stages, options=DiscoverOptions()).findings
        every = [[f.effect, *f.confusable_with] for f in found]
        return next((own for own in every if set(pair) & set(own)), [])

    for size in sizes:
        case = Condition(
            "catalogue", "two", seed, ((effect, joint, size),), seconds=LOG_S
        )
        plant, _ = built(case)
        plan = drills(declared(case), seed, seconds=LOG_S)
        for drill in (drill for drill in plan if drill.name in LOGS):
            what = f"{case.effects}|{drill.name}"
            log = stored(
                cache, what, plant, drill.reference, seed, every=2, start=drill.start
            )
            if rival in (before := names([log])):
                belief = belief_of(robot, stages, limits_of(robot, ramp_s=0.4))
                wanted = {
                    "duration_s": SECONDS,
                    "move_s": MOVE_S,
                    "between": pair,
                    "joint": at,
                }
                options = PlanOptions(**wanted, seed=seed)
                planned = plan_discriminate(belief, stages, options, [log])
                told = planned.stage.separation
                power, imitated = (
                    (told.powers[0], told.imitations[0]) if told else (0.0, 1.0)
                )
                after = names(
                    [log, *recorded(plant, planned.moves, seed, start=LATER_S)]
                )
                return Outcome(
                    effect, rival, at, drill.name, size, before, power, imitated, after
                )
    return Outcome(effect, rival, at)
