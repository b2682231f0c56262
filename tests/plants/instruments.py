"""IMUs whose sensors have faults, on arms that swing, and what a calibration finds of
them.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cache

import numpy as np
from scipy.spatial.transform import Rotation

from seqid_cli.identify.imu_calibration import calibrate_imus
from seqid_cli.logs.recording import Recording
from seqid_cli.motion.options import MotionOptions
from seqid_cli.params.schema import ImuCalibration, ImuStage
from seqid_cli.robot.types import Robot
from tests import Array
from tests.plants.arms.rigs import one_joint, six_joint, two_joint
from tests.plants.effects import drive
from tests.plants.mechanics.rigid import link_motion
from tests.plants.motions.experiments import swing
from tests.plants.robots.lab import recording_of, robot_of
from tests.plants.sensors import AccelerometerArray, Faults, quantise
from tests.plants.simulate import Log, Plant, simulate

EVERY = 4  # control periods of 1 ms per row
SPAN = 0.4  # share of the joints' ranges that a swing takes
ROBOTS = {"one": one_joint, "two": two_joint, "six": six_joint}
TURNS: Mapping[str, int] = {"one": 4, "two": 3, "six": 1}
FAULTS = Faults(
    bias=0.15, drift=0.002, turn_on=0.01, scale=0.01, tilt=np.deg2rad(0.5), spikes=2e-4
)
GYRO_FAULTS = Faults(
    0, 0.01, 1e-4, 1e-3, scale=0.005, tilt=np.deg2rad(0.3), spikes=2e-4
)
POSTURES: Mapping[str, Sequence[Sequence[float]]] = {
    "one": [[0.0], [0.0], [0.0]],
    "two": [[0.0, angle] for angle in (-1.6, -0.8, 0.0, 0.8, 1.6)],
    "six": [
        [0.0, -1.2, 1.0, -0.6, 1.2, 0.4],
        [0.0, -0.6, -1.2, 0.9, -1.0, 1.5],
        [0.0, -1.9, 0.4, 1.8, 0.3, -1.2],
        [0.0, -1.4, 1.6, -1.9, -1.9, 2.2],
    ],
}


@dataclass(frozen=True)
class Case:
    """A robot with its encoders (rad per count at the joint) and the kind of
    its IMUs.
    """

    label: str
    robot: str
    step: float
    gyro: bool = False
    delay: float = 0.002
    rate: float = 0.0  # s/s, by which the IMU's clock gains on the encoders'
    scatter: float = 0.0  # s, of the delay from log to log
    turns: int | None = None  # swings, where it is not as many as usual
    hidden: str | None = None  # effect of a drive that joint 2 has


COARSE = Case("one joint, 400 counts", "one", 2 * np.pi / 400)
FINE = Case("one joint, 17 bits", "one", 2 * np.pi / 2**17)
GYRO = Case("six joints, 17 bits, gyro", "six", 2 * np.pi / 2**17, gyro=True)
STIFF = Case("stiff joint 1", "two", 2 * np.pi / 2**17, turns=1)
ELASTIC = replace(STIFF, label="elastic joint 2", hidden="elastic")
BACKLASH = replace(STIFF, label="backlash joint 2", hidden="backlash")


@dataclass(frozen=True)
class Scene:
    case: Case
    plant: Plant
    robot: Robot
    logs: Sequence[Log]


@dataclass(frozen=True)
class Score:
    """One calibration of one IMU: errors over standard errors, and the errors
    themselves.
    """

    turn_deg: float
    z_turn: tuple[float, ...]
    z_delay: tuple[float, ...]
    z_gain: tuple[float, ...]
    z_bias: tuple[float, ...]
    delay_error: float
    holdout: float | None
    outliers: int


@cache
def scene_of(case: Case) -> Scene:
    plant = ROBOTS[case.robot]()
    if case.hidden is not None:
        plant = getattr(drive, case.hidden)(plant, 1, 1.0)
    plant = replace(plant, imus=tuple(_instrument(imu, case) for imu in plant.imus))
    postures = [np.array(posture) for posture in POSTURES[case.robot]]
    moves = [(posture, 0) for posture in postures]
    moves += [(postures[0], joint) for joint in range(1, plant.arm.n)]
    turns = case.turns or TURNS[case.robot]
    swings = [swing(plant, *move, turns, share=SPAN, rate_hz=1000.0) for move in moves]
    logs = [
        simulate(plant, x, k, every=EVERY, imus=False) for k, x in enumerate(swings)
    ]
    robot = robot_of(
        case.robot, replace(plant, encoder_step=np.full(plant.arm.n, case.step))
    )
    return Scene(case, plant, robot, logs)


def _instrument(imu: AccelerometerArray, case: Case) -> AccelerometerArray:
    faults = replace(FAULTS, delay=case.delay, rate=case.rate)
    if not case.gyro:
        return replace(imu, faults=faults)
    gyro_faults = replace(GYRO_FAULTS, delay=case.delay, rate=case.rate)
    own = {"gyro_noise": 0.003, "gyro_faults": gyro_faults}
    return replace(
        imu, positions=np.zeros((3, 3)), axes=np.eye(3), faults=faults, **own
    )


def instruments(scene: Scene, seed: int) -> list[AccelerometerArray]:
    found = []
    for number, imu in enumerate(scene.plant.imus, start=1000 * seed):
        gyro = replace(imu.gyro_faults, seed=500 + number)
        found.append(
            replace(imu, faults=replace(imu.faults, seed=number), gyro_faults=gyro)
        )
    return found


def offsets(scene: Scene, seed: int) -> Array:
    """How late the IMUs' stamps are as each log begins, s."""
    rng = np.random.default_rng([seed, 7])
    scatter = scene.case.scatter * rng.standard_normal(len(scene.logs))
    return np.asarray(scene.case.delay + scatter)


def _later(imu: AccelerometerArray, late: float) -> AccelerometerArray:
    if imu.faults is None or late == 0.0:
        return imu
    faults = replace(imu.faults, delay=imu.faults.delay + late)
    gyro = replace(imu.gyro_faults, delay=imu.gyro_faults.delay + late)
    return replace(imu, faults=faults, gyro_faults=gyro)


def recordings(scene: Scene, seed: int) -> list[Recording]:
    """What one seed's encoders and IMUs make of the motion."""
    found = []
    phase = np.random.default_rng([seed, 0]).random(scene.plant.arm.n) * scene.case.step
    for number, log in enumerate(scene.logs):
        rng, truth = np.random.default_rng([seed, number + 1]), log.truth
        rate = 1.0 / float(log.t[1] - log.t[0])
        accelerometers, gyros = dict[str, Array](), dict[str, Array]()
        late = offsets(scene, seed)[number] - scene.case.delay
        for imu in instruments(scene, seed):
            imu = _later(imu, late)
            motion = link_motion(
                scene.plant.arm, imu.after, truth.q, truth.dq, truth.ddq
            )
            accelerometers[imu.name] = imu.read(motion, rng, rate)
            gyro = imu.read_gyro(motion, rng, rate)
            gyros |= {} if gyro is None else {imu.name: gyro}
        q = quantise(truth.angle + phase, scene.case.step) - phase
        seen = replace(log, q=q, accelerometers=accelerometers)
        found.append(
            replace(recording_of(scene.plant, f"imu/{number}", seen), gyros=gyros)
        )
    return found


def calibrated(scene: Scene, seed: int) -> ImuStage:
    return calibrate_imus(recordings(scene, seed), scene.robot, options=MotionOptions())


def scored(imu: AccelerometerArray, found: ImuCalibration) -> Score:
    turn = np.array(found.rotation) @ true_mounting(imu).T
    off, sigma = (
        np.degrees(Rotation.from_matrix(turn).as_rotvec()),
        np.array(found.std_errors_deg),
    )
    known, k = sigma < 5.0, len(imu.axes)
    scales, biases = (
        found.accelerometer_scale_std_errors,
        found.accelerometer_bias_std_errors,
    )
    late = found.time_offset_s - imu.faults.delay
    return Score(
        turn_deg=float(np.linalg.norm(off[known])),
        z_turn=tuple((off[known] / sigma[known]).tolist()),
        z_delay=(
            (late / found.time_offset_std_error_s,)
            if found.time_offset_std_error_s
            else ()
        ),
        z_gain=_z(found.accelerometer_scale, scales, imu.faults.gains(k)),
        z_bias=_z(found.accelerometer_bias, biases, imu.faults.biases(k)),
        delay_error=abs(late),
        holdout=found.holdout or None,
        outliers=found.outliers,
    )


def true_mounting(imu: AccelerometerArray) -> Array:
    """Mounting of the frame that the calibration means."""
    if np.ptp(imu.positions, axis=0).max() > 0 or imu.faults is None:
        return imu.rotation
    turn = 0.5 * np.sum(np.cross(imu.axes, imu.faults.axes(imu.axes)), axis=0)
    return np.asarray(imu.rotation @ Rotation.from_rotvec(turn).as_matrix())


def _z(
    found: list[float | None], errors: list[float | None], truth: Array
) -> tuple[float, ...]:
    own = zip(found, errors, truth, strict=True)
    return tuple(
        float((x - true) / e) for x, e, true in own if x is not None and e is not None
    )


def scores(of: tuple[Case, int]) -> list[Score]:
    scene, seed = scene_of(of[0]), of[1]
    stage = calibrated(scene, seed)
    return [scored(imu, stage.imus[imu.name]) for imu in instruments(scene, seed)]
