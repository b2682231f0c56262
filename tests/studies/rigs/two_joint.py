"""The paper's planar two-joint rig (Sec. 4.2): Table IV and the friction surfaces."""

from argparse import Namespace
from dataclasses import dataclass

import numpy as np

from seqid_cli.identify.friction_surface.stage import identify_friction
from seqid_cli.identify.options import FrictionOptions
from seqid_cli.model.friction import FrictionSurface
from seqid_cli.params.schema import FrictionStage, RigidStage
from tests import Array
from tests.plants.arms.rigs import two_joint
from tests.plants.motions.experiments import (
    Trial,
    friction_trials,
    imu_trials,
    inertia_trials,
    validation_trials,
)
from tests.plants.robots.identified import sequential
from tests.plants.robots.lab import run, true_standard, true_value
from tests.plants.simulate import Plant
from tests.studies.rigs.repetition import another, predicted
from tests.studies.tables import number, rms, spread, table

SEED, REPETITIONS = 42, 6
POSTURES = tuple(np.array([0.0, angle]) for angle in (0.0, 1.2, -0.9, 2.3, -1.9))
PAPER = {"pi_1": "2.1", "pi_2": "10.5", "pi_4": "5.7", "pi_5": "1.1"}
SYMBOLS = {
    "pi_1": "pi_1 (I_1zz + N_1^2 I_m1 + m_2 l_1^2)",
    "pi_2": "pi_2 (I_2zz)",
    "pi_4": "pi_4 (m_2 r_2x)",
    "pi_5": "pi_5 (m_2 r_2y, % of pi_4)",
}
ORDERS = {
    "chosen": FrictionOptions(),
    "paper's, m = 10, l = 11": FrictionOptions(position_order=10, velocity_order=11),
}


@dataclass(frozen=True)
class SurfaceError:
    """Identified friction against the true one inside the identified range, share of its RMS."""

    rms: float
    worst: float
    orders: tuple[int, int]


@dataclass(frozen=True)
class Repetition:
    """Results of one rig built anew; errors are shares of the true values."""

    error: dict[str, float]
    z: dict[str, float]
    surface: dict[tuple[str, str], SurfaceError]  # by orders and joint
    torque: dict[str, Array]  # RMSE N m over all samples, per joint


def trials(plant: Plant, rng: np.random.Generator) -> list[Trial]:
    """All logs of one repetition; there is no gravity to identify."""
    return [
        *friction_trials(plant, POSTURES[:1]),
        *imu_trials(plant, POSTURES, turns=1),
        *inertia_trials(plant, POSTURES[1:], rng, pairs=[(0, 1), (0, 1)], seconds=8.0),
        *validation_trials(plant, rng, runs=1, seconds=12.0, points=6),
    ]


def repetition(number_of: int) -> Repetition:
    """Build the rig, record, identify, predict."""
    rng = np.random.default_rng([SEED, number_of])
    plant = another(two_joint(), rng)
    experiment = run("two_joint", plant, trials(plant, rng), SEED + number_of)
    logs, robot = experiment.recordings, experiment.robot
    stages = sequential(experiment.recordings, experiment.robot)
    assert stages.inertia is not None
    error, z = table_iv(plant, stages.inertia)
    surface: dict[tuple[str, str], SurfaceError] = {}
    for label, orders in ORDERS.items():
        fitted = identify_friction(logs["friction"], robot, options=orders)
        for j, joint in enumerate(plant.arm.names):
            surface[label, joint] = surface_error(plant, fitted, j)
    found = predicted(experiment, stages)
    torque = {"sequential": found.sequential.every, "simultaneous": found.simultaneous.every}
    return Repetition(error, z, surface, torque | {"noise": found.floor})


def table_iv(plant: Plant, stage: RigidStage) -> tuple[dict[str, float], dict[str, float]]:
    """Errors and z of Eq. 44's parameters; the known rotor of joint 1 belongs to pi_1."""
    standard = true_standard(plant)
    names = {"Izz_1": "pi_1", "Izz_2": "pi_2", "mx_2": "pi_4", "my_2": "pi_5"}
    scale = {
        "pi_1": true_value({"Izz_1": 1.0, "m_2": float(plant.arm.dh[1, 1]) ** 2}, standard)
        + float(plant.arm.reflected[0]),
        "pi_2": standard["Izz_2"],
        "pi_4": standard["mx_2"],
        "pi_5": standard["mx_2"],
    }
    error, z = {}, {}
    for parameter in stage.parameters:
        off = parameter.value - true_value(parameter.terms, standard)
        name = names[parameter.name]
        error[name] = off / scale[name]
        z[name] = off / parameter.std_error
    return error, z


def surface_error(plant: Plant, stage: FrictionStage, joint: int) -> SurfaceError:
    """Compare on a grid over the identified range of positions and speeds, both directions."""
    found = stage.joints[plant.arm.names[joint]]
    low, high = found.position_range
    slow, fast = found.speed_range
    position, speed = np.meshgrid(np.linspace(low, high, 61), np.geomspace(slow, fast, 41))
    q = np.zeros((position.size, plant.arm.n))
    q[:, joint] = position.ravel()
    truth, fitted = [], []
    for sign in (1.0, -1.0):
        v = np.zeros_like(q)
        v[:, joint] = sign * speed.ravel()
        law = plant.friction.begin()(0.0, q, v, np.zeros_like(q))
        dry = law.forward if sign > 0 else -law.backward
        truth.append((dry + law.smooth)[:, joint])
        fitted.append(FrictionSurface.from_stage(found).torque(q[:, joint], v[:, joint]))
    true = np.concatenate(truth)
    off = (np.concatenate(fitted) - true) / rms(true)
    orders = (found.position_order, found.velocity_order)
    return SurfaceError(rms(off), float(np.abs(off).max()), orders)


def study(chosen: Namespace) -> str:
    """All tables of this rig."""
    repetitions = 1 if chosen.quick else REPETITIONS
    found = [repetition(k) for k in range(repetitions)]
    said = f"{repetitions} rigs; errors in % of the true value."
    return "\n\n".join([said, parameter_table(found), friction_table(found), torque_table(found)])


def parameter_table(found: list[Repetition]) -> str:
    """Table IV."""
    rows = []
    for name, paper in PAPER.items():
        s = spread([100 * r.error[name] for r in found])
        z = rms([r.z[name] for r in found])
        cells = [number(x) for x in (s.median, s.worst, s.mean, z)]
        rows.append([SYMBOLS[name], *cells, paper])
    return table(
        ["parameter", "median error %", "worst %", "mean (signed) %", "rms z", "paper %"], rows
    )


def friction_table(found: list[Repetition]) -> str:
    """Surfaces with the paper's orders and with the chosen ones."""
    rows = []
    for label in ORDERS:
        for joint in two_joint().arm.names:
            errors = [r.surface[label, joint] for r in found]
            orders = "; ".join(sorted({f"{m}, {l}" for m, l in (e.orders for e in errors)}))
            middle = number(100 * float(np.median([e.rms for e in errors])))
            worst = number(100 * max(e.worst for e in errors))
            rows.append([f"{joint}, {label}", middle, worst, orders])
    header = ["friction surface", "median of RMS error %", "largest error %", "m, l"]
    return table(header, rows)


def torque_table(found: list[Repetition]) -> str:
    """RMSE on the held-out moves, mN m."""
    rows = []
    for method in ("sequential", "simultaneous", "noise"):
        label = "current noise alone" if method == "noise" else method
        values = 1e3 * np.array([r.torque[method] for r in found])
        cells = [number(float(x), 3) for x in [*np.median(values, axis=0), *values.max(axis=0)]]
        rows.append([label, *cells])
    names = two_joint().arm.names
    header = [*(f"median {n}" for n in names), *(f"worst {n}" for n in names)]
    return table(["held-out torque RMSE, mN m", *header], rows)
