"""How well `imu-calib` finds IMUs whose sensors have faults, and whether its intervals hold.

The arm's motion is simulated once per case; encoders (their codes' phase), instruments (gains,
axes, biases) and noise are drawn anew for every seed. Results are kept seed by seed, so that a
study that was cut short goes on where it stopped.
"""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from itertools import zip_longest
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from seqid_cli.identify.imu_calibration.calibrate import calibrate_imus
from seqid_cli.identify.imu_calibration.result import deflecting
from seqid_cli.logs.recording import Recording
from seqid_cli.motion.options import MotionOptions
from seqid_cli.params.schema import ImuCalibration, ImuStage
from seqid_cli.robot.types import Robot
from tests import ROOT
from tests.plants.experiments import swing
from tests.plants.injections_drive import backlash, elastic
from tests.plants.rigid import link_motion
from tests.plants.rigs import one_joint, six_joint, two_joint
from tests.plants.robots.lab import recording_of, robot_of
from tests.plants.sensors import AccelerometerArray, Faults, quantise
from tests.plants.simulate import Log, Plant, simulate
from tests.studies.tables import table

Array = NDArray[np.float64]

DOCUMENT = ROOT / "docs" / "imu.md"

EVERY = 4  # control periods of 1 ms per row
TURNS: Mapping[str, int] = {"one": 4, "two": 3, "six": 1}
SHARE: Mapping[str, float] = {"one": 1.0, "two": 1.0, "six": 0.3}  # of the seeds
FAULTS = Faults(bias=0.15, drift=0.002, turn_on=0.01, scale=0.01, tilt=np.deg2rad(0.5), spikes=2e-4)
GYRO_FAULTS = Faults(
    bias=0.01, drift=1e-4, turn_on=1e-3, scale=0.005, tilt=np.deg2rad(0.3), spikes=2e-4
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
    """A robot with its encoders (rad per count at the joint) and the kind of its IMUs."""

    label: str
    robot: str
    step: float
    gyro: bool = False
    delay: float = 0.002
    span: float = 0.4  # share of the joints' ranges that a swing takes
    turns: int | None = None  # swings, where it is not as many as usual
    share: float = 1.0  # of the seeds
    hidden: str | None = None  # effect of `DRIVES`
    joint: int = 0  # that has it
    size: float = 1.0


DRIVES: Mapping[str, Callable[[Plant, int, float], Plant]] = {
    "elastic": elastic,
    "backlash": backlash,
}
CASES = (
    Case("one joint, 400 counts", "one", 2 * np.pi / 400),
    Case("one joint, 17 bits", "one", 2 * np.pi / 2**17),
    Case("two joints, 400 counts", "two", 2 * np.pi / 400, delay=0.02),
    Case("two joints, 17 bits", "two", 2 * np.pi / 2**17),
    Case("six joints, 400 counts", "six", 2 * np.pi / 400),
    Case("six joints, 17 bits", "six", 2 * np.pi / 2**17, delay=-0.02),
    Case("six joints, 17 bits, gyro", "six", 2 * np.pi / 2**17, gyro=True),
    Case("two joints, 400 counts, long", "two", 2 * np.pi / 400, span=0.8, turns=4, share=0.3),
    Case("six joints, 17 bits, long", "six", 2 * np.pi / 2**17, span=0.8, turns=2, share=0.5),
)
DEFLECTING = tuple(
    Case(f"{hidden} joint {joint + 1}, {size:g}", "two", 2 * np.pi / 2**17, turns=1, **own)
    for hidden, joint, size in (
        ("stiff", 0, 0.0),
        ("elastic", 0, 0.5),
        ("elastic", 1, 1.0),
        ("elastic", 1, 0.3),
        ("backlash", 0, 1.0),
        ("backlash", 1, 1.0),
        ("backlash", 1, 0.3),
    )
    for own in ({"hidden": hidden if size else None, "joint": joint, "size": size},)
)


@dataclass(frozen=True)
class Scene:
    """A case whose motion is simulated."""

    case: Case
    plant: Plant
    robot: Robot
    logs: Sequence[Log]


@dataclass(frozen=True)
class Score:
    """One calibration of one IMU: errors over standard errors, and the errors themselves."""

    turn_deg: float
    stated_deg: float
    z_turn: Array
    z_delay: float
    z_lever: Array
    z_gain: Array
    z_bias: Array
    delay_error: float
    holdout: float
    outliers: int
    deflects: str = ""  # joint that the calibration names


def scene_of(case: Case) -> Scene:
    """Simulate the arm's motion of a case."""
    plant = _plant(case.robot)
    if case.hidden is not None:
        plant = DRIVES[case.hidden](plant, case.joint, case.size)
    plant = replace(plant, imus=tuple(_instrument(imu, case) for imu in plant.imus))
    postures = [np.array(posture) for posture in POSTURES[case.robot]]
    moves = [(posture, 0) for posture in postures]
    moves += [(postures[0], joint) for joint in range(1, plant.arm.n)]
    turns = case.turns or TURNS[case.robot]
    logs = [
        simulate(
            plant,
            swing(plant, posture, joint, turns, share=case.span, rate_hz=1000.0),
            number,
            every=EVERY,
            imus=False,
        )
        for number, (posture, joint) in enumerate(moves)
    ]
    robot = robot_of(case.robot, replace(plant, encoder_step=np.full(plant.arm.n, case.step)))
    return Scene(case, plant, robot, logs)


def _plant(name: str) -> Plant:
    if name == "one":
        return one_joint()
    return two_joint() if name == "two" else six_joint()


def _instrument(imu: AccelerometerArray, case: Case) -> AccelerometerArray:
    faults = replace(FAULTS, delay=case.delay)
    if not case.gyro:
        return replace(imu, faults=faults)
    return replace(
        imu,
        positions=np.zeros((3, 3)),
        axes=np.eye(3),
        faults=faults,
        gyro_noise=0.003,
        gyro_faults=replace(GYRO_FAULTS, delay=case.delay),
    )


def instruments(scene: Scene, seed: int) -> list[AccelerometerArray]:
    """The IMUs of one seed."""
    found = []
    for number, imu in enumerate(scene.plant.imus):
        assert imu.faults is not None
        faults = replace(imu.faults, seed=1000 * seed + number)
        gyro = replace(imu.gyro_faults, seed=1000 * seed + 500 + number)
        found.append(replace(imu, faults=faults, gyro_faults=gyro))
    return found


def recordings(scene: Scene, seed: int) -> list[Recording]:
    """What one seed's encoders and IMUs make of the motion."""
    found = []
    phase = np.random.default_rng([seed, 0]).random(scene.plant.arm.n) * scene.case.step
    for number, log in enumerate(scene.logs):
        rng = np.random.default_rng([seed, number + 1])
        rate = 1.0 / float(log.t[1] - log.t[0])
        truth = log.truth
        accelerometers: dict[str, Array] = {}
        gyros: dict[str, Array] = {}
        for imu in instruments(scene, seed):
            motion = link_motion(scene.plant.arm, imu.after, truth.q, truth.dq, truth.ddq)
            accelerometers[imu.name] = imu.read(motion, rng, rate)
            gyro = imu.read_gyro(motion, rng, rate)
            gyros |= {} if gyro is None else {imu.name: gyro}
        q = quantise(truth.angle + phase, scene.case.step) - phase
        seen = replace(log, q=q, accelerometers=accelerometers)
        own = recording_of(scene.plant, f"imu/{number}", seen)
        found.append(replace(own, gyros=gyros))
    return found


def calibrated(scene: Scene, seed: int) -> ImuStage:
    """Calibrate the IMUs of one seed."""
    return calibrate_imus(recordings(scene, seed), scene.robot, options=MotionOptions())


def scored(imu: AccelerometerArray, found: ImuCalibration) -> Score:
    """Compare a calibration with the instrument that it is of."""
    assert imu.faults is not None
    R = np.array(found.rotation)
    off = np.degrees(Rotation.from_matrix(R @ true_mounting(imu).T).as_rotvec())
    sigma = np.array(found.std_errors_deg)
    known = sigma < 5.0
    lever = _z(found.lever, found.lever_std_errors, imu.lever)
    k = len(imu.axes)
    gain = _z(found.accelerometer_scale, found.accelerometer_scale_std_errors, imu.faults.gains(k))
    errors = found.accelerometer_bias_std_errors
    bias = _z(found.accelerometer_bias, errors, imu.faults.biases(k))
    late = found.time_offset_s - imu.faults.delay
    return Score(
        turn_deg=float(np.linalg.norm(off[known])),
        stated_deg=float(np.linalg.norm(sigma[known])),
        z_turn=off[known] / sigma[known],
        z_delay=late / (found.time_offset_std_error_s or np.nan),
        z_lever=lever,
        z_gain=gain,
        z_bias=bias,
        delay_error=abs(late),
        holdout=found.holdout or np.nan,
        outliers=found.outliers,
        deflects=getattr(deflecting(found), "joint", ""),
    )


def true_mounting(imu: AccelerometerArray) -> Array:
    """Mounting of the frame that the calibration means.

    Of an array it is that of the sensors' places. Accelerometers at one point have none but their
    axes, whose common turn is the mounting's.
    """
    if np.ptp(imu.positions, axis=0).max() > 0 or imu.faults is None:
        return imu.rotation
    turn = 0.5 * np.sum(np.cross(imu.axes, imu.faults.axes(imu.axes)), axis=0)
    return np.asarray(imu.rotation @ Rotation.from_rotvec(turn).as_matrix())


def _z(found: list[float | None], errors: list[float | None], truth: Array) -> Array:
    pairs = [
        (value - true) / error
        for value, error, true in zip(found, errors, truth, strict=True)
        if value is not None and error is not None
    ]
    return np.array(pairs)


def scores(scene: Scene, seed: int) -> list[Score]:
    """All IMUs of one seed."""
    stage = calibrated(scene, seed)
    return [scored(imu, stage.imus[imu.name]) for imu in instruments(scene, seed)]


class Kept:
    """Scores of a case, one line per seed in a file where a folder is given."""

    def __init__(self, case: Case, folder: Path | None) -> None:
        name = "".join(c if c.isalnum() else "_" for c in case.label)
        self.path = folder / f"{name}.jsonl" if folder else None
        self.found: dict[int, list[Score]] = {}
        if self.path and self.path.exists():
            for line in self.path.read_text(encoding="utf-8").splitlines():
                row = json.loads(line)
                self.found[row["seed"]] = [_score(each) for each in row["scores"]]

    def add(self, seed: int, found: list[Score]) -> None:
        """Keep the scores of a seed."""
        self.found[seed] = found
        if self.path:
            self.path.parent.mkdir(parents=True, exist_ok=True)
            each = [{k: np.asarray(v).tolist() for k, v in asdict(s).items()} for s in found]
            with self.path.open("a", encoding="utf-8") as file:
                file.write(json.dumps({"seed": seed, "scores": each}) + "\n")


def _score(kept: Mapping[str, object]) -> Score:
    named = str(kept.get("deflects", ""))
    arrays = {k: np.asarray(v, dtype=np.float64) for k, v in kept.items() if k != "deflects"}
    values = {k: v if v.ndim else v.item() for k, v in arrays.items()}
    return Score(**values, deflects=named)  # type: ignore[arg-type]


def coverage(z: Array) -> float:
    """Share of 95 % intervals that hold the truth."""
    return float(np.mean(np.abs(z) < 1.96)) if len(z) else float("nan")


def row(case: Case, found: Sequence[Score]) -> list[str]:
    """One line of the study's table."""
    turn = np.array([s.turn_deg for s in found])

    def held(name: str) -> str:
        z = np.concatenate([np.atleast_1d(getattr(s, name)) for s in found])
        return f"{100 * coverage(z):.0f} %" if len(z) else "-"

    late = np.array([s.delay_error for s in found])
    named = Counter(s.deflects for s in found if s.deflects)
    return [
        case.label,
        str(len(found)),
        f"{np.median(turn):.3f}",
        f"{np.median([s.stated_deg for s in found]):.3f}",
        f"{turn.max():.3f}",
        *(held(f"z_{name}") for name in ("turn", "delay", "lever", "gain", "bias")),
        f"{1e3 * case.delay:.0f}",
        f"{1e3 * np.sqrt(np.mean(late**2)):.3f}",
        f"{np.median([s.holdout for s in found]):.2f}",
        f"{rms_z(found):.2f}",
        ", ".join(f"{name} {count}" for name, count in sorted(named.items())) or "-",
    ]


def rms_z(found: Sequence[Score]) -> float:
    """RMS of the mounting's errors over the stated ones."""
    z = np.concatenate([score.z_turn for score in found])
    return float(np.sqrt(np.mean(z**2)))


HEADER = [
    "case",
    "IMUs",
    "median error, deg",
    "stated",
    "largest",
    "mounting held",
    "offset",
    "lever",
    "scale",
    "bias",
    "offset, ms",
    "its RMS error",
    "held-out / noise",
    "rms z",
    "deflects",
]


def study(count: int, *, cases: Sequence[Case] = CASES, folder: Path | None = None) -> str:
    """Table over the cases, `count` seeds for one joint and fewer for more.

    The cases take turns, so that a table of what is there says something of all of them.
    """
    kept = [Kept(case, folder) for case in cases]
    scenes: dict[str, Scene] = {}
    missing = [
        [(case, seed, own) for seed in range(_seeds(case, count)) if seed not in own.found]
        for case, own in zip(cases, kept, strict=True)
    ]
    for turn in zip_longest(*missing):
        for case, seed, own in filter(None, turn):
            if case.label not in scenes:
                scenes[case.label] = scene_of(case)
            own.add(seed, scores(scenes[case.label], seed))
    return tabulated(cases, kept)


def _seeds(case: Case, count: int) -> int:
    return max(1, round(count * SHARE[case.robot] * case.share))


def tabulated(cases: Sequence[Case], kept: Sequence[Kept]) -> str:
    """Table of the scores that are there."""
    rows = [
        row(case, [score for seed in own.found.values() for score in seed])
        for case, own in zip(cases, kept, strict=True)
        if own.found
    ]
    return table(HEADER, rows)
