"""The noise floor's estimate against the truth: `python -m tests.studies --only noise_floor`.

Plants whose noise is known record motion that does not come back, motion that does, and moves with
rests between them; torque noise is white, or half of its variance 1/f, and encoders are coarse or
fine. The true floor is the RMS of what the plant's own model leaves, over the samples in which a
joint slides: the measured torque without that of the rigid bodies and of friction at the positions,
velocities and accelerations that the tool makes of the encoder. That is the residual given; a
second one has an effect in it that the model lacks.
"""

from __future__ import annotations

import sys
from collections.abc import Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, replace
from itertools import product

import numpy as np
from numpy.typing import NDArray

from seqid_cli.discover.noise.encoder import encoder_residuals
from seqid_cli.discover.noise.floor import noise_floor, rms
from seqid_cli.discover.scenes import scenes_of
from seqid_cli.identify.options import InertiaOptions
from seqid_cli.model.effects.scene import Scene
from tests import ROOT
from tests.plants.experiments import Trial, span_of, validation_trials
from tests.plants.rigs import one_joint, two_joint
from tests.plants.robots.identified import simultaneous
from tests.plants.robots.lab import run
from tests.plants.simulate import Log, Plant
from tests.plants.trajectories import point_to_point
from tests.plants.twin import inverse
from tests.studies.tables import number, table
from tests.studies.variants import another

Array = NDArray[np.float64]

DOCUMENT = ROOT / "docs" / "method.md"
FIRST_SEED = 20_000  # nothing was set on these; an interval was after a look at 10_000 to 10_007
RIGS = {"one joint": one_joint, "two joints": two_joint}
NOISES = {"white": 0.0, "half 1/f": 0.5}
ENCODERS = ("coarse", "fine")
FINER = 50.0  # times
MISSED = 3.0  # floors, amplitude of an effect that the model lacks
MOTIONS = ("does not come back", "comes back", "rests between moves")
SECONDS = 20.0
DWELL_S = 1.2


@dataclass(frozen=True)
class Case:
    """One arm, its noise, its motion."""

    rig: str
    noise: str
    encoder: str
    motion: str
    seed: int


@dataclass(frozen=True)
class Outcome:
    """Estimate over truth by joint, whether the interval holds the truth, its upper end.

    `missed`, `missed_inside`: the same where the model lacks an effect.
    """

    case: Case
    ways: tuple[str, ...]
    ratio: Array
    inside: Array
    reach: Array
    missed: Array
    missed_inside: Array


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
    if case.encoder == "fine":
        plant = replace(plant, encoder_step=plant.encoder_step / FINER)
    experiment = run(case.rig, plant, trials(plant, case.motion, rng), case.seed)
    logs = experiment.recordings["validation"]
    stages = simultaneous(logs, experiment.robot)
    scenes = scenes_of(logs, experiment.robot, stages, options=InertiaOptions(source="encoder"))
    left = [
        np.where(scene.motion.usable[:, None], perfect(plant, log, scene), 0.0)
        for log, scene in zip(experiment.logs["validation"], scenes, strict=True)
    ]
    echo = encoder_residuals(logs, scenes)
    truth = np.array(
        [
            rms(np.concatenate([e[s.slides[:, j], j] for e, s in zip(left, scenes, strict=True)]))
            for j in range(plant.arm.n)
        ]
    )
    effect = [MISSED * truth * np.cos(3.0 * s.motion.q) for s in scenes]
    more = [np.where(e != 0.0, e + x, 0.0) for e, x in zip(left, effect, strict=True)]
    floors = [noise_floor(logs, scenes, given, echo) for given in (left, more)]
    inside = [(floor.low <= truth) & (truth <= floor.high) for floor in floors]
    reach = floors[0].high / floors[0].rms
    ratios = [floor.rms / truth for floor in floors]
    return Outcome(case, floors[0].ways, ratios[0], inside[0], reach, ratios[1], inside[1])


def perfect(plant: Plant, log: Log, scene: Scene) -> Array:
    """What the plant's own model leaves of the torque (N, n) N m, at the scene's samples.

    Friction turns round where the motion that the encoder shows does.
    """
    assert scene.full is not None
    seen, truth = scene.full.motion, log.truth
    rigid = np.array(
        [inverse(plant.arm, *now) for now in zip(seen.q, seen.dq, seen.ddq, strict=True)]
    )
    forward, backward, smooth = plant.friction.begin()(0.0, seen.q, seen.dq, np.zeros_like(seen.q))
    dry = np.where(seen.dq > 0.0, forward, -backward)
    measured = log.current * plant.torque_per_ampere
    assert len(truth.q) == seen.samples
    left = seen.filtered(measured - dry - smooth, times=2) - seen.filtered(rigid)
    return left[:: round(seen.rate_hz / scene.motion.rate_hz)]


def study(seeds: int, processes: int = 1) -> str:
    """The table."""
    cases = [
        Case(*names, FIRST_SEED + k)
        for names in product(RIGS, NOISES, ENCODERS, MOTIONS)
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
        "rig, noise, encoder, motion",
        "way",
        "joints",
        "estimate / truth, median",
        "5 %",
        "95 %",
        "interval holds the truth",
        "its upper end / estimate, median",
        "estimate / truth where the model lacks an effect",
        "interval holds the truth there",
    )
    rows = []
    for names in product(RIGS, NOISES, ENCODERS, MOTIONS):
        own = [
            x for x in found if (x.case.rig, x.case.noise, x.case.encoder, x.case.motion) == names
        ]
        if not own:
            continue
        ratio = np.concatenate([x.ratio for x in own])
        low, middle, high = np.quantile(ratio, [0.05, 0.5, 0.95])
        inside = np.concatenate([x.inside for x in own])
        missed = np.concatenate([x.missed_inside for x in own])
        raised = float(np.median(np.concatenate([x.missed for x in own])))
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
                number(raised),
                f"{missed.sum()} of {len(missed)}",
            )
        )
    inside = np.concatenate([x.inside for x in found])
    share = f"{100.0 * inside.mean():.0f} %"
    return f"Interval holds the truth in {share} of {len(inside)}.\n\n{table(header, rows)}"
