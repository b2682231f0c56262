"""Rigs, encoders and faulty IMUs for motion from all sensors, read off a simulated
truth.
"""

from dataclasses import dataclass, field, replace
from functools import cache

import numpy as np
from scipy.spatial.transform import Rotation

from seqid_cli.logs.recording import Recording
from seqid_cli.params.schema import ImuCalibration, ImuStage
from seqid_cli.robot.types import Robot
from tests import Array
from tests.plants.arms.rigs import array_on, one_joint, six_joint, two_joint
from tests.plants.mechanics.rigid import LinkMotion, link_motion
from tests.plants.motions.experiments import inertia_trials, validation_trials
from tests.plants.robots.lab import recording_of, robot_of
from tests.plants.sensors import AccelerometerArray, quantise
from tests.plants.simulate import Log, Plant, simulate

GYRO_NOISE, GYRO_BIAS = 0.005, 0.02  # rad/s


@dataclass(frozen=True)
class Fault:
    """What is wrong with the IMUs beyond noise; the first of each channel, standard
    deviations.
    """

    bias: float = 0.02  # m/s^2
    drift: float = 0.0  # m/s^2, of the bias over the log
    gain: float = 0.0
    tilt_deg: float = 0.0
    delay_s: float = 0.0  # by which stamps are late as the log begins
    rate: float = 0.0  # s/s, by which they get later
    lost: bool = False  # the last IMU stops midway
    limit: float = np.inf  # m/s^2, where accelerometers saturate


@dataclass(frozen=True)
class Case:
    plant: Plant
    robot: Robot
    recording: Recording
    stage: ImuStage
    truth: Array  # (N, n) rad/s^2
    log: Log


@dataclass(frozen=True)
class Rig:
    """Joints, encoder counts per joint turn (0: as built), IMUs and kind of motion."""

    joints: int
    counts: int = 0
    layout: str = "two"  # of six joints: "end", "two" or "each"
    gyro: bool = False
    fault: Fault = field(default_factory=Fault)
    seconds: float = 4.0


def _arrays(plant: Plant, layout: str) -> tuple[AccelerometerArray, ...]:
    """The plant's own arrays, or one at the end or one on each link."""
    if layout == "two" or plant.arm.n < 6:
        return plant.imus
    found = []
    for link in range(0 if layout == "each" else plant.arm.n - 1, plant.arm.n):
        at = (0.3 - 0.2 * link, 0.5 * link, 0.4), (0.05, 0.02, -0.03 + 0.01 * link)
        found.append(array_on(f"imu_{link + 1}", link, *at, size=0.06, bias=0.02))
    return tuple(found)


def built(rig: Rig) -> Plant:
    plant = {1: one_joint, 2: two_joint, 6: six_joint}[rig.joints]()
    if rig.counts:
        plant = replace(plant, encoder_step=np.full(rig.joints, 2 * np.pi / rig.counts))
    return replace(plant, imus=_arrays(plant, rig.layout))


@cache
def simulated(rig: Rig) -> Log:
    """Inertia trials of one or two joints, a validation run of six; faults do not
    change it.
    """
    rng, plant = np.random.default_rng(0), built(rig)
    if rig.joints == 6:
        trials = validation_trials(plant, rng, seconds=rig.seconds)
    else:
        posture = np.array([0.0, 0.5])[: rig.joints]
        trials = inertia_trials(plant, [posture], rng, seconds=rig.seconds)
    return simulate(plant, trials[0].reference, 0, imus=False)


def _late(log: Log, fault: Fault, plant: Plant, link: int) -> LinkMotion:
    """A link's true motion when readings were taken that are stamped t."""
    felt = (log.t - fault.delay_s) / (1.0 + fault.rate)
    parts = (log.truth.q, log.truth.dq, log.truth.ddq)
    late = (np.transpose([np.interp(felt, log.t, x) for x in own.T]) for own in parts)
    return link_motion(plant.arm, link, *late)


def readings(
    array: AccelerometerArray,
    motion: LinkMotion,
    fault: Fault,
    rng: np.random.Generator,
) -> Array:
    tilts = Rotation.from_rotvec(
        np.radians(fault.tilt_deg) * rng.standard_normal(array.axes.shape)
    )
    true = replace(array, axes=tilts.apply(array.axes), bias=0.0)
    count = len(array.axes)
    ideal = true.ideal(motion) * (1.0 + fault.gain * rng.standard_normal(count))
    ideal += fault.bias * rng.standard_normal(count)
    ideal += (
        fault.drift
        * rng.standard_normal(count)
        * np.linspace(0, 1, len(ideal))[:, None]
    )
    noisy = ideal + array.noise * rng.standard_normal(ideal.shape)
    return np.clip(quantise(noisy, array.resolution), -fault.limit, fault.limit)


def case(rig: Rig) -> Case:
    plant, rng = built(rig), np.random.default_rng(1000)
    log, robot = (
        simulated(replace(rig, gyro=False, fault=Fault())),
        robot_of("rig", plant),
    )
    accelerometers, gyros, imus = {}, {}, []
    for imu, array in zip(robot.imus, plant.imus, strict=True):
        motion = _late(log, rig.fault, plant, array.after)
        kept = (
            replace(array, positions=np.zeros((3, 3)), axes=np.eye(3))
            if rig.gyro
            else array
        )
        accelerometers[imu.name] = readings(kept, motion, rig.fault, rng)
        if rig.gyro:
            rates = motion.omega @ array.rotation + GYRO_BIAS * rng.standard_normal(3)
            gyros[imu.name] = rates + GYRO_NOISE * rng.standard_normal(rates.shape)
            imu = replace(imu, positions=kept.positions, axes=kept.axes, gyro=True)
        imus.append(imu)
    if rig.fault.lost:
        last, half = imus[-1].name, len(log.t) // 2
        for values in (each[last] for each in (accelerometers, gyros) if last in each):
            values[half:] = values[half]
    recording = replace(
        recording_of(plant, "rig", log), accelerometers=accelerometers, gyros=gyros
    )
    robot = replace(robot, imus=tuple(imus))
    return Case(plant, robot, recording, stage_of(plant, rng), log.truth.ddq, log)


def stage_of(plant: Plant, rng: np.random.Generator, off_deg: float = 0.1) -> ImuStage:
    """Calibration of the mounting alone, a tenth of a degree off."""
    found = {}
    for imu in plant.imus:
        off = Rotation.from_rotvec(
            np.radians(off_deg) * rng.standard_normal(3)
        ).as_matrix()
        rotation = (imu.rotation @ off).tolist()
        found[imu.name] = ImuCalibration(
            rotation=rotation, std_error_deg=0.1, noise_density=0.05
        )
    return ImuStage(imus=found)
