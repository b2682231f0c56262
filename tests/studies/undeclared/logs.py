"""Logs of the study's cases, simulated once, and the parameter files that they start
from.
"""

import hashlib
import os
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from seqid_cli.identify.options import InertiaOptions
from seqid_cli.identify.prediction.predict import predict
from seqid_cli.logs.recording import Recording
from seqid_cli.params.schema import Stages
from seqid_cli.robot.types import Robot
from tests import Array, plants
from tests.plants.motions.experiments import (
    Trial,
    friction_trials,
    gravity_trials,
    inertia_trials,
)
from tests.plants.motions.trajectories import Reference
from tests.plants.motions.trials import SEED_STRIDE, drills
from tests.plants.robots.identified import sequential, simultaneous
from tests.plants.robots.lab import recording_of, robot_of
from tests.plants.robots.made import made_recording
from tests.plants.samples import SIX_POSTURES
from tests.plants.simulate import Plant, simulate
from tests.studies.records import sources_of
from tests.studies.undeclared.cases import SENSORS, Condition, built, declared

EARLIER = 5000  # added to the seed: the logs of before a change
TRIAL_SEED = 7000
TRIAL_EVERY = 4  # control periods per row of the sequential experiments
FIRST_START = 20.0  # s since power-on
PAUSE = 10.0  # s between the sequential experiments
TWO_POSTURES = np.array(
    [[0.0, 0.3], [0.7, -1.0], [-0.9, 1.3], [1.5, 0.8], [-1.8, -1.6]]
)


@dataclass(frozen=True)
class Logs:
    """What one case records, and its robot file; `earlier` are experiments of stages,
    by stage.
    """

    robot: Robot
    training: Sequence[Recording]
    held_out: Sequence[Recording]
    earlier: Mapping[str, Sequence[Recording]] = field(default_factory=dict)


def logs_of(condition: Condition, cache: Path) -> Logs:
    sensors, (plant, _) = SENSORS[condition.sensors], built(condition)
    found: dict[bool, list[Recording]] = {False: [], True: []}
    plan = drills(declared(condition), condition.seed, seconds=condition.seconds)
    for seed, drill in enumerate(plan, start=SEED_STRIDE * condition.seed):
        if sensors.keep == "all" or (sensors.keep == "periodic") == (
            drill.period is not None
        ):
            own = (
                f"{_plant_label(condition)}|{drill.name}",
                plant,
                drill.reference,
                seed,
            )
            log = stored(cache, *own, every=sensors.every, start=drill.start)
            found[drill.held_out].append(log)
    return Logs(robot_for(condition), found[False], found[True])


def robot_for(condition: Condition) -> Robot:
    return robot_of(condition.rig, declared(condition))


def _plant_label(condition: Condition) -> str:
    sensors = SENSORS[condition.sensors]
    plant = (condition.rig, condition.simple_friction, condition.effects)
    return repr((plant, sensors.noise, sensors.coloured, sensors.step))


def stored(
    cache: Path, what: str, plant: Plant, reference: Reference, seed: int, **how: Any
) -> Recording:
    """Simulate a log, or read from the cache what the stages read of it; it has no
    IMUs.
    """
    motion = hashlib.sha256(np.ascontiguousarray(reference.q).tobytes()).hexdigest()
    key = f"{what}|{motion}|{seed}|{how!r}|{plant_sources()}"
    digest = hashlib.sha256(key.encode()).hexdigest()
    path = cache / "logs" / digest[:2] / f"{digest[:24]}.npz"
    name = what.rpartition("|")[2]
    if not path.is_file():
        made = simulate(plant, reference, seed, imus=False, **how)
        log = recording_of(plant, name, made)
        found = {"q": log.q, "tau": log.tau, "rate": log.rate_hz, "start": log.start}
        found |= {} if log.temperature is None else {"temperature": log.temperature}
        path.parent.mkdir(parents=True, exist_ok=True)
        part = path.with_suffix(f".{os.getpid()}.part")
        with part.open("wb") as stream:
            np.savez_compressed(stream, allow_pickle=False, **found)
        part.replace(path)  # whole or not at all
    with np.load(path, allow_pickle=False) as data:
        q, rate = data["q"], float(data["rate"])
        more = {"start": float(data["start"]), "temperature": data.get("temperature")}
        return made_recording(
            q, data["tau"], rate_hz=rate, path=name, sha256=digest, **more
        )


def plant_sources() -> str:
    return sources_of(Path(plants.__file__).parent, but=("samples",))


def sequential_trials(plant: Plant, rig: str) -> list[Trial]:
    postures = list(TWO_POSTURES if rig == "two" else SIX_POSTURES)
    rng = np.random.default_rng(TRIAL_SEED)
    pairs = [(0, 1)] * 3 if rig == "two" else None
    return [
        *friction_trials(plant, postures[0], lowest=0.08),
        *gravity_trials(plant, postures[:5], speeds=(0.3,)),
        *inertia_trials(plant, postures, rng, pairs=pairs, seconds=5.0),
    ]


def in_turn(
    cache: Path,
    plant: Plant,
    plan: Iterable[tuple[str, str, Reference, int, int]],
    pause: float,
) -> dict[str, list[Recording]]:
    """Recordings by part, `pause` s apart; each of a part, label, motion, seed and
    `every`.
    """
    found, start = dict[str, list[Recording]](), FIRST_START
    for part, what, reference, seed, every in plan:
        log = stored(
            cache, what, plant, reference, seed, every=every, start=round(start, 3)
        )
        found.setdefault(part, []).append(log)
        start += reference.duration + pause
    return found


def earlier_logs(
    condition: Condition, cache: Path
) -> Mapping[str, Sequence[Recording]]:
    """Logs that the case's parameter file is made from, by stage, see `Condition`."""
    if condition.start == "before":
        condition = replace(condition, seed=condition.seed + EARLIER, effects=())
    elif condition.start == "sequential":
        condition = replace(condition, effects=())
    if condition.simple_friction:
        return {"friction": logs_of(condition, cache).training}
    label, every = _plant_label(condition), TRIAL_EVERY
    plan = [
        (t.stage, f"{label}|{t.stage}/{t.name}", t.reference, TRIAL_SEED + k, every)
        for k, t in enumerate(sequential_trials(declared(condition), condition.rig))
    ]
    return in_turn(cache, built(condition)[0], plan, PAUSE)


def stages_of(condition: Condition, cache: Path) -> Stages:
    logs, robot = earlier_logs(condition, cache), robot_for(condition)
    simple = condition.simple_friction
    return simultaneous(logs["friction"], robot) if simple else sequential(logs, robot)


def errors(recordings: Sequence[Recording], robot: Robot, stages: Stages) -> Array:
    """RMSE (2, n) N m of held-out torque: low-passed, and as it is in the log."""
    squares, samples = np.zeros((2, robot.n)), 0
    found = predict(recordings, robot, stages, options=InertiaOptions())
    for recording, p in zip(recordings, found, strict=True):
        finer = np.column_stack(
            [np.interp(p.t, recording.t, tau) for tau in recording.tau.T]
        )
        off = np.stack([p.beyond, finer - p.tau + p.beyond])[:, p.used]
        squares += np.sum(off**2, axis=1)
        samples += int(p.used.sum())
    return np.sqrt(squares / samples)


def excess(
    condition: Condition, number: int, cache: Path, with_it: Array
) -> tuple[float, ...]:
    """By what share an effect raises each joint's held-out RMSE, (n,).

    Compared with the same logs without it, and the file that they give: what a model
    that has the effect would leave. The larger share of the low-passed and the raw
    error.
    """
    case = condition.without(number)
    logs = logs_of(case, cache)
    without = errors(logs.held_out, logs.robot, stages_of(case, cache))
    return tuple(float(x) for x in (with_it / without - 1.0).max(axis=0))
