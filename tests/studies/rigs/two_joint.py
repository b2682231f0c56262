"""The paper's planar two-joint rig (Sec. 4.2): Table IV and the friction surfaces."""

from argparse import Namespace
from typing import NamedTuple

import numpy as np

from seqid_cli.identify.friction_surface.stage import identify_friction
from seqid_cli.identify.options import FrictionOptions
from seqid_cli.model.friction import FrictionSurface
from seqid_cli.params.schema import FrictionStage, RigidStage
from tests.plants.arms.rigs import two_joint
from tests.plants.robots.identified import sequential
from tests.plants.robots.lab import run, true_friction, true_standard, true_value
from tests.plants.samples import two_joint_trials
from tests.plants.simulate import Plant
from tests.studies.rigs.repetition import (
    METHODS,
    Estimate,
    Torque,
    another,
    error_table,
    predicted,
)
from tests.studies.tables import number, rms, table

SEED, REPETITIONS = 42, 6
PAPER = {  # of Eq. 44: symbol, and the paper's error in %
    "Izz_1": ("pi_1 (I_1zz + N_1^2 I_m1 + m_2 l_1^2)", "2.1"),
    "Izz_2": ("pi_2 (I_2zz)", "10.5"),
    "mx_2": ("pi_4 (m_2 r_2x)", "5.7"),
    "my_2": ("pi_5 (m_2 r_2y, % of pi_4)", "1.1"),
}
ORDERS = {
    "chosen": FrictionOptions(),
    "paper's, m = 10, l = 11": FrictionOptions(position_order=10, velocity_order=11),
}


class SurfaceError(NamedTuple):
    """Identified friction against the true one inside the identified range, share of
    its RMS.
    """

    rms: float
    worst: float
    orders: str


class Repetition(NamedTuple):
    estimates: dict[str, Estimate]
    surfaces: dict[str, SurfaceError]  # by joint and orders
    torque: Torque


def repetition(number_of: int) -> Repetition:
    rng = np.random.default_rng([SEED, number_of])
    plant = another(two_joint(), rng)
    experiment = run("two_joint", plant, two_joint_trials(plant, rng), SEED + number_of)
    logs, robot = experiment.recordings, experiment.robot
    stages = sequential(logs, robot)
    surfaces = {}
    for label, orders in ORDERS.items():
        fitted = identify_friction(logs["friction"], robot, options=orders)
        for j, joint in enumerate(plant.arm.names):
            surfaces[f"{joint}, {label}"] = surface_error(plant, fitted, j)
    return Repetition(
        table_iv(plant, stages.inertia), surfaces, predicted(experiment, stages)
    )


def table_iv(plant: Plant, stage: RigidStage) -> dict[str, Estimate]:
    """Errors of Eq. 44's parameters; the known rotor of joint 1 belongs to pi_1."""
    standard = true_standard(plant)
    scale = standard | {"my_2": standard["mx_2"]}
    scale["Izz_1"] = true_value(
        {"Izz_1": 1.0, "m_2": float(plant.arm.dh[1, 1]) ** 2}, standard
    )
    scale["Izz_1"] += float(plant.arm.reflected[0])
    found = {}
    for p in stage.parameters:
        off, size = p.value - true_value(p.terms, standard), scale[p.name]
        found[p.name] = Estimate(off / size, p.std_error / size)
    return found


def surface_error(plant: Plant, stage: FrictionStage, joint: int) -> SurfaceError:
    """Compare on a grid over the identified range of positions and speeds, both
    directions.
    """
    found = stage.joints[plant.arm.names[joint]]
    places = np.linspace(*found.position_range, 61)
    position, speed = np.meshgrid(places, np.geomspace(*found.speed_range, 41))
    q, v = np.tile(position.ravel(), 2), np.concatenate([speed.ravel(), -speed.ravel()])
    true = true_friction(plant, joint, q, v)
    off = (FrictionSurface.from_stage(found).torque(q, v) - true) / rms(true)
    orders = f"{found.position_order}, {found.velocity_order}"
    return SurfaceError(rms(off), float(np.abs(off).max()), orders)


def study(chosen: Namespace) -> str:
    found = [repetition(k) for k in range(1 if chosen.quick else REPETITIONS)]
    parameters = {
        symbol: ([r.estimates[name] for r in found], paper)
        for name, (symbol, paper) in PAPER.items()
    }
    surfaces = []
    for label in found[0].surfaces:
        errors = [r.surfaces[label] for r in found]
        sizes = float(np.median([e.rms for e in errors])), max(e.worst for e in errors)
        orders = "; ".join(sorted({e.orders for e in errors}))
        surfaces.append([label, *(number(100 * size) for size in sizes), orders])
    torques = []
    for method in METHODS:
        values = 1e3 * np.array([r.torque[method][0] for r in found])
        cells = [*np.median(values, axis=0), *values.max(axis=0)]
        torques.append([method, *(number(float(x), 3) for x in cells)])
    joints = [
        f"{what} {joint}"
        for what in ("median", "worst")
        for joint in two_joint().arm.names
    ]
    surface = ["friction surface", "median of RMS error %", "largest error %", "m, l"]
    torque = table(["held-out torque RMSE, mN m", *joints], torques)
    made = f"{len(found)} rigs; errors in % of the true value."
    return "\n\n".join(
        [made, error_table(parameters), table(surface, surfaces), torque]
    )
