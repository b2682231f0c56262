"""A case as a user meets it: logs and files on disk, every command's own function, an answer."""

import time
import warnings
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from seqid_cli import discover, identify
from seqid_cli.errors import SeqidWarning
from seqid_cli.params.results.diagnosis import DiagnosisFile
from tests import Array
from tests.studies.outside import motions
from tests.studies.outside.arms import Arm
from tests.studies.outside.effects.effect import Effect
from tests.studies.outside.plan import Case, drawn
from tests.studies.outside.robotfiles import robot_toml, urdf
from tests.studies.outside.simulate import Log, simulate
from tests.unit.logs.writers import write_mcap, write_parquet

SPEEDS = np.array([0.08, 0.2, 0.45, 0.8])  # of the joint's limit
FEWER = np.array([0.2, 0.45])
EPOCH_S = 1.7e9
ASTRAY = 1.0  # rad, m: from its motion, where a position loop does not hold the arm


class AstrayError(ArithmeticError):
    """Effect and position loop are unstable together: nobody records such a log."""


class Recorder:
    """Writes one log after the other, as a user's logger does."""

    def __init__(self, case: Case, folder: Path, rng: np.random.Generator) -> None:
        self.case, self.folder, self.rng = case, folder, rng
        self.clock, self.count = 0.0, 0

    def record(self, motion: Array, effects: Sequence[Effect]) -> Path:
        """Simulate a motion and write the log."""
        case, self.count = self.case, self.count + 1
        log = simulate(case.arm, motion, 100 * case.outline.seed + self.count, effects, self.clock)
        asked = motion[:: round(len(motion) / len(log.q))][: len(log.q)]
        if np.max(np.abs(log.q[: len(asked)] - asked)) > ASTRAY:
            raise AstrayError("the arm has left its motion")
        start, self.clock = self.clock, self.clock + len(motion) * 1e-3 + 5.0
        suffix = "mcap" if case.outline.mcap else "parquet"
        path = self.folder / f"log_{self.count:02}.{suffix}"
        write(path, case.arm, log, log.t + EPOCH_S if case.outline.clock else log.t - start)
        return path

    def moves(self, count: int, seconds: float, effects: Sequence[Effect]) -> list[Path]:
        """Motions of all joints, of drawn sorts."""
        sorts = self.rng.permutation(list(motions.MOTIONS))[:count]
        return [
            self.record(motions.MOTIONS[sort](self.case.arm, self.rng, seconds), effects)
            for sort in sorts
        ]

    def trials(self, speeds: Array, effects: Sequence[Effect]) -> list[Path]:
        """Every joint by itself, the others held at a drawn posture."""
        n = self.case.arm.n
        posture = self.rng.uniform(-0.6, 0.6, n)
        return [
            self.record(motions.trial(self.case.arm, j, posture, speeds), effects) for j in range(n)
        ]


def write(path: Path, arm: Arm, log: Log, t: Array) -> None:
    """Write a log as Parquet or MCAP, with torques or currents."""
    scale = arm.of("ratio") * arm.of("constant")
    own: dict[str, Any] = {"accelerometers": log.accelerometers, "gyros": log.gyros}
    effort = log.torque / scale if arm.currents else log.torque
    if path.suffix == ".mcap":
        t0 = int(t[0]) * 10**9
        write_mcap(
            path, t - int(t[0]), arm.names, log.q, encoding="cdr", effort=effort, t0_ns=t0, **own
        )
        return
    own["current" if arm.currents else "torque"] = effort
    own["temperature"] = log.temperature if arm.temperatures else None
    write_parquet(path, t, arm.names, log.q, **own)


def run_case(
    seed: int, folder: Path, coarser: float = 1.0
) -> tuple[dict[str, Any], DiagnosisFile | None]:
    """Record, identify, record on, diagnose: what was hidden and what was found."""
    case = drawn(seed, coarser)
    start, found, row = time.process_time(), None, _truth(case)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", SeqidWarning)
        try:
            ready = prepared(case, folder)
            row["stages"], found = (
                ready.poor,
                discover.diagnose(ready.logs, ready.robot, ready.file),
            )
            row |= told(found)
        except Exception as error:  # a case that fails is an answer too
            row["error"] = f"{type(error).__name__}: {error}"
    row["seconds"] = time.process_time() - start
    return row, found


def _truth(case: Case) -> dict[str, Any]:
    names = case.arm.names
    return {
        "seed": case.outline.seed,
        "kinds": [effect.name for effect in case.effects],
        "joints": [
            " ".join(names[j] for j in (e.joint, e.partner) if j is not None) for e in case.effects
        ],
        "shares": list(case.shares),
        "flow": case.outline.flow,
        "arm": case.arm.label,
        "n": case.arm.n,
        "imu": bool(case.arm.imus),
        "error": "",
    }


def told(found: DiagnosisFile) -> dict[str, Any]:
    """What a diagnosis says, as far as it is judged."""
    return {
        "verdict": found.verdict,
        "findings": [
            {
                "effect": item.effect,
                "joint": item.joint or "",
                "confidence": item.confidence,
                "name_confidence": item.name_confidence,
                "alike": item.confusable_with,
            }
            for item in found.findings
        ],
        "unexplained": [[part.joint, part.depends_on] for part in found.unexplained],
        "events": [[e.log, e.start, e.end, e.joints] for e in found.events],
        "residuals": {
            joint: [entry.rmse, entry.noise_floor, entry.rmse_explained]
            for joint, entry in found.joints.items()
        },
    }


@dataclass(frozen=True)
class Prepared:
    """What a user has when something may be missing; `poor` is what the stages say."""

    robot: Path
    logs: list[Path]
    file: Path
    poor: str
    recorder: Recorder


def prepared(case: Case, folder: Path) -> Prepared:
    """Record, identify, and record the logs that are asked about."""
    robot = folder / "robot.toml"
    robot.write_text(robot_toml(case.arm))
    (folder / "arm.urdf").write_text(urdf(case.arm))
    recorder = Recorder(case, folder, np.random.default_rng([case.outline.seed, 6]))
    if case.outline.flow == "single":
        logs = recorder.moves(1, 20.0, case.effects)
        file, poor = _one_step(case, robot, logs, folder)
    elif case.outline.flow.startswith("step"):
        file, poor = _one_step(case, robot, recorder.moves(3, 20.0, case.before), folder)
        logs = recorder.moves(2, 16.0, case.effects)
    else:
        file, poor = _sequential(case, robot, recorder, folder)
        logs = recorder.moves(2, 18.0, case.effects)
    return Prepared(robot, logs, file, poor, recorder)


def _one_step(case: Case, robot: Path, logs: list[Path], folder: Path) -> tuple[Path, str]:
    file, imu = folder / "simultaneous.json", folder / "imu.json"
    if case.arm.imus:
        identify.imu_calib(logs, robot, output=imu)
    stages = identify.simultaneous(logs, robot, [imu] if case.arm.imus else [], output=file).stages
    return file, _poor(stages)


def _sequential(case: Case, robot: Path, recorder: Recorder, folder: Path) -> tuple[Path, str]:
    trials = recorder.trials(SPEEDS, case.before)
    more = recorder.trials(FEWER, case.before)
    moves = recorder.moves(2, 18.0, case.before)
    files = [folder / f"{stage}.json" for stage in ("friction", "gravity", "imu", "inertia")]
    identify.friction(trials, robot, output=files[0])
    identify.gravity([*trials, *more], robot, files[0], output=files[1])
    known = files[1:2]
    if case.arm.imus:
        identify.imu_calib([*more, *moves], robot, files[1], output=files[2])
        known = files[2:3]
    return files[3], _poor(identify.inertia(moves, robot, known, output=files[3]).stages)


def _poor(stages: Any) -> str:
    """What is poor of the stages, or "good"."""
    named = ((name, getattr(stages, name)) for name in ("friction", "gravity", "imu", "inertia"))
    poor = [
        f"{name} {verdict.joint}: {verdict.reason}"
        for name, stage in named
        if stage is not None
        for verdict in stage.verdicts
        if not verdict.good
    ]
    return "; ".join(poor) or "good"
