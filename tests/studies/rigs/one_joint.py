"""The paper's one-joint rig (Sec. 4.1): parameters, prediction, and how far from the bound."""

from argparse import Namespace
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from seqid_cli.identify.options import InertiaOptions
from seqid_cli.params.schema import RigidStage
from tests.plants.arms.rigs import LINK_INERTIA, MOMENT, one_joint
from tests.plants.motions.experiments import (
    Trial,
    friction_trials,
    gravity_trials,
    imu_trials,
    inertia_trials,
    validation_trials,
)
from tests.plants.robots.identified import before_inertia, with_inertia
from tests.plants.robots.lab import Experiment, run
from tests.plants.simulate import Plant
from tests.studies.rigs.bound import Knowledge, bounds
from tests.studies.rigs.repetition import another, predicted
from tests.studies.tables import number, rms, spread, table

SEED, REPETITIONS = 41, 8
FACTORS = (1, 4)
SOURCES = ("encoder", "auto")
UNITS = {"mx_1": MOMENT, "my_1": MOMENT, "Izz_1": LINK_INERTIA}
SYMBOLS = {"mx_1": "m r_x", "my_1": "m r_y", "Izz_1": "link inertia"}


@dataclass(frozen=True)
class Estimate:
    """Error and standard error as shares of `UNITS`."""

    error: float
    std_error: float


@dataclass(frozen=True)
class Repetition:
    """Results of one rig built anew."""

    gravity: dict[str, Estimate]
    inertia: dict[str, Estimate]  # by the source of motion
    bounds: dict[Knowledge, dict[str, float]]
    torque: dict[str, tuple[float, float]]  # RMSE N m over all samples, over sliding ones


def trials(plant: Plant, rng: np.random.Generator) -> list[Trial]:
    """All logs of one repetition."""
    home = [np.zeros(1)]
    return [
        *friction_trials(plant, home),
        *gravity_trials(plant, home, speeds=(0.1, 0.2)),
        *imu_trials(plant, home),
        *inertia_trials(plant, home, rng, seconds=12.0),
        *validation_trials(plant, rng, runs=1, seconds=12.0),
    ]


def repetition(factor: int, number_of: int) -> Repetition:
    """Build the rig, record, identify with every source, predict."""
    rng = np.random.default_rng([SEED, factor, number_of])
    plant = another(one_joint(quadrature_factor=factor), rng)
    experiment = run("one_joint", plant, trials(plant, rng), SEED + 100 * factor + number_of)
    logs, robot = experiment.recordings, experiment.robot
    stages = before_inertia(logs, robot)
    found = {
        source: with_inertia(logs, robot, stages, InertiaOptions(source=source))
        for source in SOURCES
    }
    assert stages.gravity is not None
    inertia = {
        key: _estimates(plant, one.inertia)["Izz_1"]
        for key, one in found.items()
        if one.inertia is not None
    }
    torque = predicted(experiment, found["auto"])
    ways = {"sequential": torque.sequential, "simultaneous": torque.simultaneous}
    floor = float(torque.floor[0])
    return Repetition(
        gravity=_estimates(plant, stages.gravity),
        inertia=inertia,
        bounds={known: bound_shares(experiment, known) for known in KNOWLEDGE},
        torque={
            **{way: (float(one.every[0]), float(one.sliding[0])) for way, one in ways.items()},
            "noise": (floor, floor),
        },
    )


KNOWLEDGE = tuple(Knowledge(f, m) for m in (False, True) for f in (True, False))


def bound_shares(experiment: Experiment, known: Knowledge) -> dict[str, float]:
    """Bounds as shares of `UNITS`: moments from the slow logs, inertia from all."""
    logs, plant = experiment.logs, experiment.plant
    slow = [*logs["friction"], *logs["gravity"]]
    found = bounds(plant, slow, known)
    found["Izz_1"] = bounds(plant, [*slow, *logs["inertia"]], known)["Izz_1"]
    return {name: value / UNITS[name] for name, value in found.items()}


def _estimates(plant: Plant, stage: RigidStage) -> dict[str, Estimate]:
    phi = plant.arm.phi[0]
    truth = {"mx_1": phi[1], "my_1": phi[2], "Izz_1": phi[9]}
    return {
        p.name: Estimate(
            float(p.value - truth[p.name]) / UNITS[p.name], p.std_error / UNITS[p.name]
        )
        for p in stage.parameters
    }


def study(chosen: Namespace) -> str:
    """All tables of this rig."""
    repetitions = 1 if chosen.quick else REPETITIONS
    results = {f: [repetition(f, k) for k in range(repetitions)] for f in FACTORS}
    return "\n\n".join(
        [
            f"{repetitions} rigs per encoder; error in % of the true value, m r_y in % of m r_x.",
            parameter_table(results),
            bound_table(results),
            torque_table(results),
        ]
    )


Results = dict[int, list[Repetition]]


def parameter_table(results: Results) -> str:
    """Errors next to the paper's."""
    rows = []
    for factor, found in results.items():
        counts = f"{100 * factor} counts"
        for name, paper in (("mx_1", "3.4"), ("my_1", "1.1")):
            errors = [r.gravity[name] for r in found]
            rows.append([f"{SYMBOLS[name]}, {counts}", *_errors(errors), paper])
        for source, label, paper in (
            ("encoder", "encoder", "79"),
            ("auto", "with accelerometers", "16"),
        ):
            errors = [r.inertia[source] for r in found]
            rows.append([f"link inertia, {label}, {counts}", *_errors(errors), paper])
    return table(
        ["parameter", "median error %", "worst %", "mean (signed) %", "rms z", "paper %"], rows
    )


def _errors(found: Sequence[Estimate]) -> list[str]:
    s = spread([100 * e.error for e in found])
    z = rms([e.error / e.std_error for e in found])
    return [number(s.median), number(s.worst), number(s.mean), number(z)]


def bound_table(results: Results) -> str:
    """Standard deviation of the errors over the Cramer-Rao bounds."""
    rows = []
    for factor, found in results.items():
        for name, source in (("mx_1", ""), ("my_1", ""), ("Izz_1", "encoder"), ("Izz_1", "auto")):
            errors = [r.inertia[source] if source else r.gravity[name] for r in found]
            deviation = spread([e.error for e in errors]).std
            motion = source == "auto"
            limits = [
                rms([r.bounds[Knowledge(friction, motion)][name] for r in found])
                for friction in (True, False)
            ]
            label = {"": "", "encoder": ", encoder", "auto": ", with accelerometers"}[source]
            reported = rms([e.std_error for e in errors])
            rows.append(
                [
                    f"{SYMBOLS[name]}{label}, {100 * factor} counts",
                    *(number(100 * x) for x in (deviation, reported, *limits)),
                    number(deviation / limits[0]),
                ]
            )
    header = ["parameter", "std of error %", "reported std error %", "bound, friction known %"]
    header += ["bound, its form known %", "std / bound"]
    return table(header, rows)


def torque_table(results: Results) -> str:
    """RMSE on the held-out moves, mN m."""
    rows = []
    for factor, found in results.items():
        for method, paper in (("sequential", "8.16"), ("simultaneous", "8.73"), ("noise", "")):
            every = spread([1e3 * r.torque[method][0] for r in found])
            sliding = spread([1e3 * r.torque[method][1] for r in found])
            label = "current noise alone" if method == "noise" else method
            cells = [number(x, 3) for x in (every.median, every.worst, sliding.median)]
            rows.append([f"{label}, {100 * factor} counts", *cells, paper])
    header = ["held-out torque RMSE, mN m", "median", "worst", "median while sliding", "paper"]
    return table(header, rows)
