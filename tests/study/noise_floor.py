"""The noise floor's estimate against the truth: `python -m tests.study --only noise_floor`.

Plants whose current noise is known record motion that does not come back, motion that does, and
moves with rests between them; noise is white, or half of its variance 1/f. The true floor is the
RMS of the low-passed true noise over the samples in which a joint slides. The residual is that of a
right model, the noise itself: it is what repeats are compared by.
"""

from __future__ import annotations

import sys
from collections.abc import Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, replace
from itertools import product
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from seqid_cli.discover.floor import noise_floor
from seqid_cli.discover.rows import rows_of
from seqid_cli.discover.scenes import scenes_of
from seqid_cli.identify.options import InertiaOptions
from seqid_cli.motion.filtering import Lowpass
from seqid_cli.params.schema import Stages
from tests.plants.experiments import Trial, span_of, validation_trials
from tests.plants.rigs import one_joint, two_joint
from tests.plants.simulate import Plant
from tests.plants.trajectories import point_to_point
from tests.study.lab import Experiment, run
from tests.study.tables import number, table
from tests.study.variants import another

Array = NDArray[np.float64]

DOCUMENT = Path(__file__).parents[2] / "docs" / "method.md"
FIRST_SEED = 10_000  # numbers of the estimate were set on logs that are made up, not on these
RIGS = {"one joint": one_joint, "two joints": two_joint}
NOISES = {"white": 0.0, "half 1/f": 0.5}
MOTIONS = ("does not come back", "comes back", "rests between moves")
SECONDS = 20.0
DWELL_S = 1.2


@dataclass(frozen=True)
class Case:
    """One arm, its noise, its motion."""

    rig: str
    noise: str
    motion: str
    seed: int


@dataclass(frozen=True)
class Outcome:
    """Estimate over truth by joint, whether the interval holds the truth, its upper end."""

    case: Case
    ways: tuple[str, ...]
    ratio: Array
    inside: Array
    reach: Array


def trials(plant: Plant, motion: str, rng: np.random.Generator) -> list[Trial]:
    """Two logs."""
    if motion == "rests between moves":
        low, high = np.array([span_of(plant, j) for j in range(plant.arm.n)]).T
        limits = (0.9 * plant.velocity_limits, 0.9 * plant.acceleration_limits)
        moves = [
            point_to_point(rng, low, high, *limits, points=8, rate_hz=1000.0, dwell=DWELL_S)
            for _ in range(2)
        ]
        return [Trial("validation", f"moves_{k}", m) for k, m in enumerate(moves)]
    runs = validation_trials(plant, rng, runs=2, seconds=SECONDS)[:2]
    first = runs[0] if motion == "comes back" else runs[1]
    return [replace(runs[0], imus=False), replace(first, name="second", imus=False)]


def outcome(case: Case) -> Outcome:
    """Record, estimate, compare."""
    rng = np.random.default_rng([case.seed, MOTIONS.index(case.motion)])
    plant = replace(another(RIGS[case.rig](), rng), coloured=NOISES[case.noise])
    experiment = run(case.rig, plant, trials(plant, case.motion, rng), case.seed)
    logs = experiment.recordings["validation"]
    scenes = scenes_of(logs, experiment.robot, Stages(), options=InertiaOptions(source="encoder"))
    rows, noise = rows_of(scenes), low_passed_noise(experiment, [s.motion.lowpass for s in scenes])
    steps = [round(log.rate_hz / s.motion.rate_hz) for log, s in zip(logs, scenes, strict=True)]
    left = [e[::k] for e, k in zip(noise, steps, strict=True)]
    counted = [
        np.where(s.motion.usable[:, None], e, 0.0) for s, e in zip(scenes, left, strict=True)
    ]
    floor = noise_floor(logs, scenes, rows, counted)
    slid = [np.where(s.slides, e**2, 0.0) for s, e in zip(scenes, left, strict=True)]
    count = np.sum([s.slides.sum(axis=0) for s in scenes], axis=0)
    truth = np.sqrt(np.sum([x.sum(axis=0) for x in slid], axis=0) / count)
    inside = (floor.low <= truth) & (truth <= floor.high)
    return Outcome(case, floor.ways, floor.rms / truth, inside, floor.high / floor.rms)


def low_passed_noise(experiment: Experiment, lowpasses: Sequence[Lowpass]) -> list[Array]:
    """True noise (N, n) N m of each log at its own rate, after two passes."""
    drive, found = experiment.plant.torque_per_ampere, []
    for log, thinned in zip(experiment.logs["validation"], lowpasses, strict=True):
        lowpass = Lowpass(thinned.cutoff_hz, 1.0 / float(log.t[1] - log.t[0]))
        found.append(lowpass(lowpass(log.current * drive - log.truth.tau)))
    return found


def study(seeds: int, processes: int = 1) -> str:
    """The table."""
    cases = [
        Case(*names, FIRST_SEED + k)
        for names in product(RIGS, NOISES, MOTIONS)
        for k in range(seeds)
    ]
    with ProcessPoolExecutor(processes) as pool:
        found = []
        for one in pool.map(outcome, cases):
            found.append(one)
            sys.stderr.write(f"{one.case}: {one.ratio.round(2)} {one.inside}\n")
    return tables_of(found)


def tables_of(found: Sequence[Outcome]) -> str:
    """One row per rig, noise and motion; joints of all seeds together."""
    header = (
        "rig, noise, motion",
        "way",
        "joints",
        "estimate / truth, median",
        "5 %",
        "95 %",
        "interval holds the truth",
        "its upper end / estimate, median",
    )
    rows = []
    for names in product(RIGS, NOISES, MOTIONS):
        own = [x for x in found if (x.case.rig, x.case.noise, x.case.motion) == names]
        if not own:
            continue
        ratio = np.concatenate([x.ratio for x in own])
        low, middle, high = np.quantile(ratio, [0.05, 0.5, 0.95])
        inside = np.concatenate([x.inside for x in own])
        reach = float(np.median(np.concatenate([x.reach for x in own])))
        ways = sorted({way for x in own for way in x.ways})
        rows.append(
            (
                ", ".join(names),
                ", ".join(ways),
                str(len(ratio)),
                *(number(float(x)) for x in (middle, low, high)),
                f"{inside.sum()} of {len(inside)}",
                number(reach),
            )
        )
    inside = np.concatenate([x.inside for x in found])
    share = f"{100.0 * inside.mean():.0f} %"
    return f"Interval holds the truth in {share} of {len(inside)}.\n\n{table(header, rows)}"
