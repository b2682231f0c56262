"""The paper's one-joint rig (Sec. 4.1): parameters, prediction, and how far from the bound."""

from argparse import Namespace
from dataclasses import dataclass

import numpy as np

from seqid_cli.identify.options import InertiaOptions
from tests.plants.arms.rigs import LINK_INERTIA, MOMENT, one_joint
from tests.plants.robots.identified import before_inertia, with_inertia
from tests.plants.robots.lab import run
from tests.plants.samples import one_joint_trials
from tests.studies.rigs.bound import bound
from tests.studies.rigs.repetition import (
    METHODS,
    Estimate,
    Torque,
    another,
    parameter_table,
    predicted,
)
from tests.studies.tables import number, rms, spread, table

SEED, REPETITIONS = 41, 8
FACTORS = (1, 4)


@dataclass(frozen=True)
class Quantity:
    name: str
    unit: float
    paper: str
    source: str = ""


QUANTITIES = {
    "m r_x": Quantity("mx_1", MOMENT, "3.4"),
    "m r_y": Quantity("my_1", MOMENT, "1.1"),
    "link inertia, encoder": Quantity("Izz_1", LINK_INERTIA, "79", "encoder"),
    "link inertia, with accelerometers": Quantity("Izz_1", LINK_INERTIA, "16", "auto"),
}
PAPER_MNM = dict(zip(METHODS, ("8.16", "8.73", ""), strict=True))


@dataclass(frozen=True)
class Repetition:
    estimates: dict[str, Estimate]
    bounds: dict[str, list[float]]  # friction known, and its form alone
    torque: Torque


def repetition(factor: int, number_of: int) -> Repetition:
    rng = np.random.default_rng([SEED, factor, number_of])
    plant = another(one_joint(quadrature_factor=factor), rng)
    experiment = run(
        "one_joint", plant, one_joint_trials(plant, rng), SEED + 100 * factor + number_of
    )
    recordings, robot, logs = experiment.recordings, experiment.robot, experiment.logs
    stages = before_inertia(recordings, robot)
    found = {
        source: with_inertia(recordings, robot, stages, InertiaOptions(source=source))
        for source in ("encoder", "auto")
    }
    truth = dict(zip(("mx_1", "my_1", "Izz_1"), plant.arm.phi[0, [1, 2, 9]], strict=True))
    slow = [*logs["friction"], *logs["gravity"]]
    estimates, bounds = {}, {}
    for label, asked in QUANTITIES.items():
        stage = found[asked.source].inertia if asked.source else stages.gravity
        (p,) = (p for p in stage.parameters if p.name == asked.name)
        off = float(p.value - truth[asked.name])
        estimates[label] = Estimate(off / asked.unit, p.std_error / asked.unit)
        used, motion = [*slow, *(logs["inertia"] if asked.source else ())], asked.source == "auto"
        bounds[label] = [
            bound(plant, used, asked.name, friction=friction, motion=motion) / asked.unit
            for friction in (True, False)
        ]
    return Repetition(estimates, bounds, predicted(experiment, found["auto"]))


def study(chosen: Namespace) -> str:
    repetitions = 1 if chosen.quick else REPETITIONS
    results = {f: [repetition(f, k) for k in range(repetitions)] for f in FACTORS}
    parameters, bounds, torques = {}, [], []
    for factor, found in results.items():
        counts = f"{100 * factor} counts"
        for label, asked in QUANTITIES.items():
            own = [r.estimates[label] for r in found]
            parameters[f"{label}, {counts}"] = own, asked.paper
            limits = [rms(values) for values in zip(*(r.bounds[label] for r in found), strict=True)]
            deviation, told = spread([e.error for e in own]).std, rms([e.std_error for e in own])
            cells = [number(100 * x) for x in (deviation, told, *limits)]
            bounds.append([f"{label}, {counts}", *cells, number(deviation / limits[0])])
        for method, paper in PAPER_MNM.items():
            every, sliding = (
                spread([1e3 * float(r.torque[method][k][0]) for r in found]) for k in (0, 1)
            )
            cells = [number(x, 3) for x in (every.median, every.worst, sliding.median)]
            torques.append([f"{method}, {counts}", *cells, paper])
    header = ["parameter", "std of error %", "reported std error %", "bound, friction known %"]
    torque = ["held-out torque RMSE, mN m", "median", "worst", "median while sliding", "paper"]
    return "\n\n".join(
        [
            f"{repetitions} rigs per encoder; error in % of the true value, m r_y in % of m r_x.",
            parameter_table(parameters),
            table([*header, "bound, its form known %", "std / bound"], bounds),
            table(torque, torques),
        ]
    )
