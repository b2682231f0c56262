"""The paper's one-joint rig (Sec. 4.1): parameters, prediction, and how far from the
bound.
"""

from argparse import Namespace
from collections.abc import Mapping
from typing import NamedTuple

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
    error_table,
    predicted,
)
from tests.studies.tables import number, rms, table

SEED, REPETITIONS = 41, 8
FACTORS = (1, 4)
# Parameter, its unit, the paper's error in %, and the source of motion. Without a
# source it is of the gravity stage, whose slow logs alone are in the bound.
QUANTITIES: Mapping[str, tuple[str, float, str, str]] = {
    "m r_x": ("mx_1", MOMENT, "3.4", ""),
    "m r_y": ("my_1", MOMENT, "1.1", ""),
    "link inertia, encoder": ("Izz_1", LINK_INERTIA, "79", "encoder"),
    "link inertia, with accelerometers": ("Izz_1", LINK_INERTIA, "16", "auto"),
}
PAPER_MNM = dict(zip(METHODS, ("8.16", "8.73", ""), strict=True))


class Repetition(NamedTuple):
    estimates: dict[str, Estimate]  # by quantity
    bounds: dict[str, list[float]]  # friction known, and its form alone
    torque: Torque


def repetition(factor: int, number_of: int) -> Repetition:
    rng = np.random.default_rng([SEED, factor, number_of])
    plant, seed = (
        another(one_joint(quadrature_factor=factor), rng),
        100 * factor + number_of,
    )
    experiment = run("one_joint", plant, one_joint_trials(plant, rng), SEED + seed)
    recordings, robot, logs = experiment.recordings, experiment.robot, experiment.logs
    stages = before_inertia(recordings, robot)
    found = {
        source: with_inertia(recordings, robot, stages, InertiaOptions(source=source))
        for source in ("encoder", "auto")
    }
    truth = dict(
        zip(("mx_1", "my_1", "Izz_1"), plant.arm.phi[0, [1, 2, 9]], strict=True)
    )
    slow = [*logs["friction"], *logs["gravity"]]
    estimates, bounds = {}, {}
    for label, (name, unit, _, source) in QUANTITIES.items():
        stage = found[source].inertia if source else stages.gravity
        (p,) = (p for p in stage.parameters if p.name == name)
        estimates[label] = Estimate(
            float(p.value - truth[name]) / unit, p.std_error / unit
        )
        used = [*slow, *(logs["inertia"] if source else ())]
        bounds[label] = [
            bound(plant, used, name, friction=friction, motion=source == "auto") / unit
            for friction in (True, False)
        ]
    return Repetition(estimates, bounds, predicted(experiment, found["auto"]))


def study(chosen: Namespace) -> str:
    repetitions = 1 if chosen.quick else REPETITIONS
    results = {f: [repetition(f, k) for k in range(repetitions)] for f in FACTORS}
    parameters, bounds, torques = {}, [], []
    for factor, found in results.items():
        counts = f"{100 * factor} counts"
        for label, (_, _, paper, _) in QUANTITIES.items():
            own = [r.estimates[label] for r in found]
            parameters[f"{label}, {counts}"] = own, paper
            limits = [
                rms(values)
                for values in zip(*(r.bounds[label] for r in found), strict=True)
            ]
            deviation = (
                np.std([e.error for e in own], ddof=1) if len(own) > 1 else np.nan
            )
            told = rms([e.std_error for e in own])
            cells = [number(100 * x) for x in (deviation, told, *limits)]
            bounds.append([f"{label}, {counts}", *cells, number(deviation / limits[0])])
        for method, paper in PAPER_MNM.items():
            every, sliding = (
                1e3 * np.array([[x[0] for x in r.torque[method]] for r in found]).T
            )
            sizes = (np.median(every), every.max(), np.median(sliding))
            torques.append(
                [f"{method}, {counts}", *(number(x, 3) for x in sizes), paper]
            )
    header = [
        "parameter",
        "std of error %",
        "reported std error %",
        "bound, friction known %",
    ]
    header += ["bound, its form known %", "std / bound"]
    torque = [
        "held-out torque RMSE, mN m",
        "median",
        "worst",
        "median while sliding",
        "paper",
    ]
    made = (
        f"{repetitions} rigs per encoder; error in % of the true value, m r_y in % of m"
        " r_x."
    )
    tables = (error_table(parameters), table(header, bounds), table(torque, torques))
    return "\n\n".join([made, *tables])
