"""Arms with an undeclared effect in all of their logs, whose friction trials reach less
far.
"""

from collections.abc import Collection
from dataclasses import replace
from pathlib import Path

import numpy as np

from tests.plants.motions.experiments import (
    friction_trials,
    gravity_trials,
    inertia_trials,
)
from tests.plants.motions.trajectories import Reference
from tests.plants.motions.trials import moves, waves
from tests.plants.samples import SIX_POSTURES
from tests.studies.undeclared.cases import Condition, built, declared
from tests.studies.undeclared.logs import TWO_POSTURES, Logs, in_turn, robot_for

KINDS = (
    "load_dependent_friction",
    "gear_efficiency",
    "thermal_friction",
    "torque_ripple",
)
KINDS += ("spring",)
TRAVEL, SPEED = 0.85, 0.75  # of what the other logs use, in the sequential experiments
# of the friction trials; the slowest as a share of the fastest
SPEEDS, SLOWEST = 6, 0.2
PERIODS = (5.626, 6.126, 6.374)  # s, of the Fourier series
TRIAL_EVERY, EVERY = 4, 2  # control periods per row
HELD_OUT_S = 14.0  # of a held-out log, about
# of the top speed: what a motor does in each turn is below the low-pass there
SLOW = 0.12
PAUSE = 60.0  # s between logs


def case_of(rig: str, kind: str, seed: int) -> Condition:
    joints = declared(Condition("starts", rig, seed, (), "sequential_with")).arm.n
    effects = ((kind, (seed + KINDS.index(kind)) % joints, 1.0),)
    return Condition("starts", rig, seed, effects, "sequential_with")


def references(case: Condition) -> list[tuple[str, Reference, int]]:
    """Stage or part, motion, and control periods per row of every log, in the order of
    time.
    """
    plant, rng = declared(case), np.random.default_rng([case.seed, 11])
    middle = plant.position_limits.mean(axis=1, keepdims=True)
    small = replace(
        plant,
        position_limits=middle + TRAVEL * (plant.position_limits - middle),
        velocity_limits=SPEED * plant.velocity_limits,
    )
    postures = list(0.8 * np.array(TWO_POSTURES if case.rig == "two" else SIX_POSTURES))
    pairs = [(0, 1)] * 3 if case.rig == "two" else None
    trials = [
        *friction_trials(small, postures[0], speeds=SPEEDS, lowest=SLOWEST),
        *gravity_trials(small, postures[:2], speeds=(0.3,)),
        *inertia_trials(small, postures, rng, pairs=pairs, seconds=5.0),
    ]
    one, two, three = (float(x) for x in rng.permutation(PERIODS))
    return [
        *((trial.stage, trial.reference, TRIAL_EVERY) for trial in trials),
        ("training", waves(plant, rng, period=one, share=0.9), EVERY),
        ("training", moves(plant, rng, share=0.6), EVERY),
        ("training", waves(plant, rng, period=two, share=0.45), EVERY),
        (
            "held_out",
            waves(plant, rng, period=three, share=0.9, seconds=HELD_OUT_S),
            EVERY,
        ),
        ("held_out", moves(plant, rng, share=0.7, seconds=HELD_OUT_S), EVERY),
        ("training", waves(plant, rng, period=one, share=SLOW), EVERY),
        (
            "held_out",
            waves(plant, rng, period=three, share=SLOW, seconds=HELD_OUT_S),
            EVERY,
        ),
    ]


def recorded(case: Condition, cache: Path, *, without: Collection[str] = ()) -> Logs:
    """Simulate a case's logs, or read them from the cache; `without` some parts."""
    seed, label = 10_000 + 1000 * case.seed, f"loop|{case.rig}|{case.effects!r}"
    plan = [
        (part, f"{label}|{part}/{k}", reference, seed + k, every)
        for k, (part, reference, every) in enumerate(references(case))
        if part not in without
    ]
    found = in_turn(cache, built(case)[0], plan, PAUSE)
    training, held_out = (
        tuple(found.pop(part, ())) for part in ("training", "held_out")
    )
    return Logs(robot_for(case), training, held_out, earlier=found)
