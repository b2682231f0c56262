"""A case as a user meets it: logs and files on disk, every command's own function, an
answer.
"""

import tempfile
import time
import warnings
from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple

import msgspec
import numpy as np

from seqid_cli import discover, identify
from seqid_cli.errors import SeqidWarning
from seqid_cli.params.io import read_parameters
from seqid_cli.params.results.diagnosis import DiagnosisFile
from tests import Array
from tests.studies.outside import motions
from tests.studies.outside.arms import Arm
from tests.studies.outside.groups import GROUPS
from tests.studies.outside.plan import Case
from tests.studies.outside.robotfiles import robot_toml, urdf
from tests.studies.outside.simulate import Effect, Log, simulate
from tests.unit.logs.writers import write_mcap, write_parquet

SPEEDS = np.array([0.08, 0.2, 0.45, 0.8])  # of the joint's limit
FEWER = np.array([0.2, 0.45])
EPOCH_S = 1.7e9
ASTRAY = 1.0  # rad, m: from its motion, where a position loop does not hold the arm


class AstrayError(ArithmeticError):
    """Effect and position loop are unstable together: nobody records such a log."""


def write(path: Path, arm: Arm, log: Log, t: Array) -> None:
    own: dict[str, Any] = {"accelerometers": log.accelerometers, "gyros": log.gyros}
    effort = (
        log.torque / (arm.of("ratio") * arm.of("constant"))
        if arm.currents
        else log.torque
    )
    if path.suffix == ".mcap":
        own |= {"effort": effort, "encoding": "cdr", "t0_ns": int(t[0]) * 10**9}
        write_mcap(path, t - int(t[0]), arm.names, log.q, **own)
        return
    own["current" if arm.currents else "torque"] = effort
    own["temperature"] = log.temperature if arm.temperatures else None
    write_parquet(path, t, arm.names, log.q, **own)


class Recorder:
    """Writes the robot's files, and one log after the other,
    as a user's logger does.
    """

    def __init__(self, case: Case, folder: Path) -> None:
        self.case, self.folder, self.clock, self.count = case, folder, 0.0, 0
        self.rng = np.random.default_rng([case.outline.seed, 6])
        self.robot = folder / "robot.toml"
        self.robot.write_text(robot_toml(case.arm))
        (folder / "arm.urdf").write_text(urdf(case.arm))

    def record(self, motion: Array, effects: Sequence[Effect]) -> Path:
        case, self.count = self.case, self.count + 1
        log = simulate(
            case.arm, motion, 100 * case.outline.seed + self.count, effects, self.clock
        )
        asked = motion[:: round(len(motion) / len(log.q))][: len(log.q)]
        if np.max(np.abs(log.q[: len(asked)] - asked)) > ASTRAY:
            raise AstrayError("the arm has left its motion")
        start, self.clock = self.clock, self.clock + len(motion) * 1e-3 + 5.0
        suffix = "mcap" if case.outline.mcap else "parquet"
        path = self.folder / f"log_{self.count:02}.{suffix}"
        write(
            path,
            case.arm,
            log,
            log.t + EPOCH_S if case.outline.clock else log.t - start,
        )
        return path

    def moves(
        self, count: int, seconds: float, effects: Sequence[Effect]
    ) -> list[Path]:
        """Motions of all joints, of drawn sorts."""
        sorts = [
            motions.MOTIONS[x]
            for x in self.rng.permutation(list(motions.MOTIONS))[:count]
        ]
        return [
            self.record(sort(self.case.arm, self.rng, seconds), effects)
            for sort in sorts
        ]

    def trials(self, speeds: Array, effects: Sequence[Effect]) -> list[Path]:
        arm = self.case.arm
        posture = self.rng.uniform(-0.6, 0.6, arm.n)
        return [
            self.record(motions.trial(arm, j, posture, speeds), effects)
            for j in range(arm.n)
        ]

    def one_step(self, logs: list[Path]) -> Path:
        """Identify everything from the same logs; returns the parameter file."""
        file, imu = self.folder / "simultaneous.json", self.folder / "imu.json"
        known = [imu] if self.case.arm.imus else []
        if known:
            identify.imu_calib(logs, self.robot, output=imu)
        identify.simultaneous(logs, self.robot, known, output=file)
        return file

    def sequential(self) -> Path:
        """Record and identify stage by stage; returns the last parameter file."""
        case, robot = self.case, self.robot
        trials, more = (self.trials(speeds, case.before) for speeds in (SPEEDS, FEWER))
        moves = self.moves(2, 18.0, case.before)
        names = ("friction", "gravity", "imu", "inertia")
        friction, known, imu, file = (self.folder / f"{name}.json" for name in names)
        identify.friction(trials, robot, output=friction)
        identify.gravity([*trials, *more], robot, friction, output=known)
        if case.arm.imus:
            identify.imu_calib([*more, *moves], robot, known, output=imu)
            known = imu
        identify.inertia(moves, robot, [known], output=file)
        return file


class Prepared(NamedTuple):
    """What a user has when something may be missing."""

    recorder: Recorder
    logs: list[Path]
    file: Path


def prepared(case: Case, folder: Path) -> Prepared:
    recorder = Recorder(case, folder)
    if case.outline.flow == "single":
        logs = recorder.moves(1, 20.0, case.effects)
        return Prepared(recorder, logs, recorder.one_step(logs))
    if case.outline.flow.startswith("step"):
        file, seconds = recorder.one_step(recorder.moves(3, 20.0, case.before)), 16.0
    else:
        file, seconds = recorder.sequential(), 18.0
    if case.asked:
        logs = [recorder.record(log.motion, log.effects) for log in case.asked]
    else:
        logs = recorder.moves(2, seconds, case.effects)
    return Prepared(recorder, logs, file)


def answered(
    seed: int, cache: Path, group: str = "mixed", **drawing: Any
) -> dict[str, Any]:
    """Record, identify and diagnose the case of a seed of a group; a row of numbers."""
    cache.mkdir(parents=True, exist_ok=True)
    start = time.process_time()
    case = GROUPS[group](seed, **drawing)
    row = {
        "seed": seed,
        "group": group,
        "variant": case.variant,
        "kinds": [effect.name for effect in case.effects],
        "joints": [" ".join(names) for names in case.joints],
        "shares": list(case.shares),
        "flow": case.outline.flow,
        "arm": case.arm.label,
        "n": case.arm.n,
        "imu": bool(case.arm.imus),
        "error": "",
    }
    with tempfile.TemporaryDirectory() as name, warnings.catch_warnings():
        warnings.simplefilter("ignore", SeqidWarning)
        try:
            ready = prepared(case, Path(name))
            row["pushes"] = [
                [ready.logs[push.log].name, push.start, push.end]
                for push in case.pushes
            ]
            asked = time.process_time()
            found = discover.diagnose(ready.logs, ready.recorder.robot, ready.file)
            row["diagnose_seconds"] = time.process_time() - asked
            row |= {"stages": poor(ready.file)} | told(found)
            (cache / f"{seed}.diagnosis.json").write_bytes(msgspec.json.encode(found))
        except Exception as error:  # a case that fails is an answer too
            row["error"] = f"{type(error).__name__}: {error}"
    return row | {"seconds": time.process_time() - start}


def poor(file: Path) -> str:
    stages = read_parameters(file).stages
    poor = [
        f"{name} {verdict.joint}: {verdict.reason}"
        for name in ("friction", "gravity", "imu", "inertia")
        for verdict in getattr(getattr(stages, name), "verdicts", ())
        if not verdict.good
    ]
    return "; ".join(poor) or "good"


def told(found: DiagnosisFile) -> dict[str, Any]:
    rows = {
        joint: (e.rmse, e.noise_floor, e.rmse_explained)
        for joint, e in found.joints.items()
    }
    kept = ("effect", "confidence", "name_confidence")
    findings = [
        {name: getattr(item, name) for name in kept}
        | {"joint": item.joint or "", "alike": item.confusable_with}
        for item in found.findings
    ]
    return {
        "verdict": found.verdict,
        "findings": findings,
        "unexplained": [[part.joint, part.depends_on] for part in found.unexplained],
        "events": [[e.log, e.start, e.end, e.joints] for e in found.events],
        "causes": [
            [values.joint, cause.effect, cause.joint or "", cause.probability]
            for values in found.changed
            for cause in values.causes
        ],
        "residuals": {joint: list(row) for joint, row in rows.items()},
    }
