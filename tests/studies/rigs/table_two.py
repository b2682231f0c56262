"""The paper's Table II on a twin of its rig: the link's inertia by four sources of
motion.
"""

import argparse
from collections.abc import Mapping, Sequence
from dataclasses import replace

import msgspec
import numpy as np

from seqid_cli.identify.options import InertiaOptions
from seqid_cli.model.torque import TorqueModel, known_rotors
from seqid_cli.motion.filters.butterworth import Lowpass
from seqid_cli.params.schema import ImuCalibration, ImuStage, Stages
from seqid_cli.robot.base_parameters import gear_ratios
from tests.plants.arms.rigs import LINK_INERTIA, one_joint
from tests.plants.motions import experiments
from tests.plants.motions.experiments import Trial
from tests.plants.robots.identified import before_inertia, with_inertia
from tests.plants.robots.lab import Experiment, run
from tests.plants.sensors import Faults
from tests.plants.simulate import Plant
from tests.studies.rigs.repetition import another
from tests.studies.tables import number, table

SEED = 2012
FACTORS = (1, 4)  # 100 and 400 counts per turn of the motor
PAPER_HZ = 20.0  # the paper filters what it differentiated, and does not say how
WAYS: Mapping[str, str] = {
    "raw": "encoder, differenced twice",
    "differenced": "encoder, differenced twice, then filtered (test 1)",
    "encoder": "encoder, torque filtered alike, cut-off chosen from the log",
    "imu": "accelerometers, Eq. 30, mounting alone calibrated (test 2)",
    "fused": "encoder and accelerometers in one smoother",
}
PAPER = {"differenced": "79", "imu": "16"}


def rig(factor: int, seed: int, rng: np.random.Generator) -> Plant:
    """The rig with `factor` counts per line of its encoder, and a cheap accelerometer's
    errors.
    """
    plant = another(one_joint(quadrature_factor=factor), rng)
    faults = Faults(
        seed=seed, bias=0.2, turn_on=0.02, scale=0.005, tilt=0.005, delay=0.002
    )
    return replace(
        plant, imus=tuple(replace(x, bias=0.0, faults=faults) for x in plant.imus)
    )


def trials(
    plant: Plant, rng: np.random.Generator, *, short: bool = False
) -> list[Trial]:
    """The logs of one rig; `short` ones only show that everything runs."""
    home = [np.zeros(1)]
    speeds, lowest, seconds = (5, 0.2, 4.0) if short else (8, 0.08, 12.0)
    return [
        *experiments.friction_trials(plant, home[0], speeds=speeds, lowest=lowest),
        *experiments.gravity_trials(
            plant, home, speeds=(0.2, 0.3) if short else (0.1, 0.2)
        ),
        *experiments.imu_trials(plant, home),
        *experiments.inertia_trials(plant, home, rng, seconds=seconds),
    ]


def errors(factor: int, seed: int, *, short: bool = False) -> dict[str, float]:
    rng = np.random.default_rng([SEED, factor, seed])
    plant = rig(factor, seed, rng)
    recorded = trials(plant, rng, short=short)
    experiment = run("one_joint", plant, recorded, SEED + 100 * factor + seed)
    logs, robot = experiment.recordings, experiment.robot
    stages = before_inertia(logs, robot)
    cutoffs = {"raw": np.inf, "differenced": PAPER_HZ}
    found = {way: differenced(experiment, stages, hz) for way, hz in cutoffs.items()}
    # The paper calibrates no bias, gain, axis or clock of a sensor.
    kept = ("rotation", "std_error_deg", "references", "noise_density")
    mounted = {
        name: ImuCalibration(**{field: getattr(one, field) for field in kept})
        for name, one in stages.imu.imus.items()
    }
    papers = msgspec.structs.replace(stages, imu=ImuStage(imus=mounted))
    for source in ("encoder", "imu", "fused"):
        known = papers if source == "imu" else stages
        stage = with_inertia(logs, robot, known, InertiaOptions(source=source)).inertia
        found[source] = next(p.value for p in stage.parameters if p.name == "Izz_1")
    return {way: 100.0 * (value / LINK_INERTIA - 1.0) for way, value in found.items()}


def differenced(experiment: Experiment, stages: Stages, cutoff_hz: float) -> float:
    """The link's inertia, kg m^2, from differences of counts; torque as recorded."""
    robot = experiment.robot
    model = TorqueModel.from_stages(stages, robot)
    reflected = float((gear_ratios(robot) ** 2 * known_rotors(robot))[0])
    x, y = [], []
    for log in experiment.recordings["inertia"]:
        lowpass = Lowpass(cutoff_hz, log.rate_hz)
        speed = np.gradient(log.q, axis=0) * log.rate_hz
        ddq = lowpass(np.gradient(speed, axis=0) * log.rate_hz)
        dq, zero = lowpass(speed), np.zeros_like(log.q)
        known = model.friction(log.q, dq) + model.rigid(log.q, zero, zero)
        moving = np.abs(dq[:, 0]) > 0.5
        x.append(ddq[moving, 0])
        y.append((log.tau - known)[moving, 0])
    a, b = np.concatenate(x), np.concatenate(y)
    return float(a @ b / (a @ a)) - reflected


def table_of(results: Mapping[int, Sequence[Mapping[str, float]]]) -> str:
    rows = {way: [label] for way, label in WAYS.items()}
    header = ["error of the link inertia, %"]
    for factor, found in results.items():
        header += [f"{100 * factor} counts: median", "95 % of the rigs"]
        for way, row in rows.items():
            values = [one[way] for one in found]
            low, high = np.quantile(values, [0.025, 0.975])
            row += [
                number(np.median(np.abs(values))),
                f"{number(low)} to {number(high)}",
            ]
    return table(
        [*header, "paper"], [[*row, PAPER.get(way, "")] for way, row in rows.items()]
    )


def add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "--rigs", type=int, default=50, help="per encoder, for table_two"
    )


def study(chosen: argparse.Namespace) -> str:
    seeds = 1 if chosen.quick else chosen.rigs
    results = {
        f: [errors(f, seed, short=chosen.quick) for seed in range(seeds)]
        for f in FACTORS
    }
    return f"{seeds} rigs per encoder.\n\n{table_of(results)}"
