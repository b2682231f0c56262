"""An arm of a UR5e's size: held-out torque, honesty of the standard errors, IMU
mountings.
"""

from argparse import Namespace
from typing import NamedTuple

import numpy as np

from tests import Array
from tests.plants.arms.rigs import six_joint
from tests.plants.robots.identified import sequential
from tests.plants.robots.lab import run, true_standard, true_value
from tests.plants.samples import six_joint_trials
from tests.studies.coverage.score import turned
from tests.studies.rigs.repetition import METHODS, Torque, another, predicted
from tests.studies.tables import number, rms, share_within, table

SEED, REPETITIONS = 43, 3
EVERY = 4  # control periods per recorded row: 250 Hz


class Repetition(NamedTuple):
    torque: Torque
    # errors over standard errors of every base parameter, by stage
    z: dict[str, list[float]]
    rank: str
    # error of the mounting (3,) deg, and the reported one
    imus: dict[str, tuple[Array, Array]]


def repetition(number_of: int) -> Repetition:
    rng = np.random.default_rng([SEED, number_of])
    plant, seed = another(six_joint(), rng), SEED + number_of
    experiment = run(
        "six_joint", plant, six_joint_trials(plant, rng), seed, every=EVERY
    )
    stages = sequential(experiment.recordings, experiment.robot)
    standard, mounted = true_standard(plant), stages.imu.imus
    return Repetition(
        torque=predicted(experiment, stages),
        z={
            name: [
                (p.value - true_value(p.terms, standard)) / p.std_error
                for p in own.parameters
            ]
            for name, own in (("gravity", stages.gravity), ("inertia", stages.inertia))
        },
        rank=f"{stages.inertia.rank} of {stages.inertia.structural_rank}",
        imus={imu.name: turned(imu, mounted[imu.name]) for imu in plant.imus},
    )


def study(chosen: Namespace) -> str:
    found = [repetition(k) for k in range(REPETITIONS)]
    ranks = ", ".join(sorted({r.rank for r in found}))
    columns = {method: [r.torque[method][0] for r in found] for method in METHODS}
    columns |= {f"{x}, sliding": [r.torque[x][1] for r in found] for x in METHODS[:2]}
    torques = [
        [name, *(number(rms(joint), 3) for joint in np.array(values).T)]
        for name, values in columns.items()
    ]
    honesty = []
    for stage, every in found[0].z.items():
        z = [value for r in found for value in r.z[stage]]
        shares = [f"{100 * share_within(z, limit):.0f} %" for limit in (2.0, 3.0)]
        honesty.append([stage, str(len(every)), *shares, number(rms(z))])
    imus = []
    for name in found[0].imus:
        error, told = (
            np.array(x) for x in zip(*(r.imus[name] for r in found), strict=True)
        )
        worst = float(np.linalg.norm(error, axis=1).max())
        imus.append(
            [name, *map(number, (rms(error), rms(told), worst, rms(error / told)))]
        )
    base = ["base parameters", "count", "within 2 standard errors", "within 3", "rms z"]
    header = ["IMU mounting", "rms error per axis, deg", "reported std error, deg"]
    header += ["largest error angle, deg", "rms z"]
    torque = table(["held-out torque RMSE, N m", *six_joint().arm.names], torques)
    made = f"{REPETITIONS} arms; rank of the inertia stage {ranks}."
    return "\n\n".join([made, torque, table(base, honesty), table(header, imus)])
