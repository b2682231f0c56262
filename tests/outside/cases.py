"""A case as a user meets it: logs and files on disk, every command's own function, an answer."""

from __future__ import annotations

import tempfile
import time
import warnings
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
from numpy.typing import NDArray

from seqid_cli import api
from seqid_cli.params.diagnosis_schema import DiagnosisFile
from tests.outside import motions
from tests.outside.arms import REACH, Arm, drawn_arm, robot_toml, urdf
from tests.outside.effects import KINDS
from tests.outside.simulate import NOTHING, Effect, simulate

Array = NDArray[np.float64]
SPEEDS = np.array([0.15, 0.3, 0.6, 1.2, 2.0])
KINDS_OF_CASE = ("clean", *KINDS)
RESERVED = 10_000  # seeds from here on judge, and are not looked at before


@dataclass(frozen=True)
class Outcome:
    """What was hidden in a case and what was found."""

    seed: int
    kind: str
    joint: str | None
    verdict: str
    names: list[list[str]]  # found: effect, joint
    named: bool  # right effect, or one that it is said not to be told from
    exact: bool  # right effect
    placed: bool  # at the right joint
    stages: str  # "good", or what is poor
    seconds: float
    error: str = ""


def kind_of(seed: int) -> str:
    """Every kind in turn."""
    return KINDS_OF_CASE[seed % len(KINDS_OF_CASE)]


def run_case(seed: int, kind: str) -> Outcome:
    """Record, identify before the effect, record after it, diagnose."""
    arm = drawn_arm(seed)
    rng = np.random.default_rng([seed, 6])
    effect = KINDS[kind](arm, rng) if kind != "clean" else NOTHING
    start = time.perf_counter()
    joint = None if effect.joint is None else arm.names[effect.joint]
    with tempfile.TemporaryDirectory() as name, warnings.catch_warnings():
        warnings.simplefilter("ignore", api.SeqidWarning)
        try:
            stages, found = _identified_and_diagnosed(Path(name), arm, effect, seed, rng)
        except Exception as error:  # a case that fails is an answer too
            said = f"{type(error).__name__}: {error}"
            spent = time.perf_counter() - start
            return Outcome(seed, kind, joint, "failed", [], False, False, False, "", spent, said)
    return _outcome(seed, kind, joint, found, stages, time.perf_counter() - start)


def _identified_and_diagnosed(
    folder: Path, arm: Arm, effect: Effect, seed: int, rng: np.random.Generator
) -> tuple[str, DiagnosisFile]:
    robot = folder / "robot.toml"
    robot.write_text(robot_toml(arm))
    (folder / "arm.urdf").write_text(urdf(arm))
    n = len(arm.links)
    postures = rng.uniform(-0.5 * REACH, 0.5 * REACH, (2, n))
    trials = [
        record(folder / f"trial_{j}_{k}.parquet", arm, motions.trial(n, j, posture, speeds), seed)
        for k, (posture, speeds) in enumerate(zip(postures, (SPEEDS, SPEEDS[2:4]), strict=True))
        for j in range(n)
    ]
    moves = [
        record(folder / "multisine.parquet", arm, motions.multisine(n, rng, 20.0), seed + 1),
        record(folder / "spline.parquet", arm, motions.spline(n, rng, 15.0), seed + 2),
    ]
    after = [
        record(path, arm, motion, seed + 3 + k, effect)
        for k, (path, motion) in enumerate(
            (
                (folder / "after_multisine.parquet", motions.multisine(n, rng, 20.0)),
                (folder / "after_points.parquet", motions.point_to_point(n, rng, 16.0)),
            )
        )
    ]
    files = [folder / f"{stage}.json" for stage in ("friction", "gravity", "inertia")]
    friction = api.friction(trials[:n], robot, output=files[0]).stages.friction
    gravity = api.gravity(trials, robot, files[0], output=files[1]).stages.gravity
    inertia = api.inertia(moves, robot, files[1], output=files[2]).stages.inertia
    named = (("friction", friction), ("gravity", gravity), ("inertia", inertia))
    poor = [
        f"{name} {v.joint}: {v.reason}" for name, s in named if s for v in s.verdicts if not v.good
    ]
    return "; ".join(poor) or "good", api.diagnose(after, robot, files[2])


def record(path: Path, arm: Arm, motion: Array, seed: int, effect: Effect = NOTHING) -> Path:
    """Simulate a log and write it as a user's logger does."""
    log = simulate(arm, motion, seed, effect)
    columns = {"t": log.t}
    for j, name in enumerate(arm.names):
        columns[f"{name}.position"] = log.q[:, j]
        columns[f"{name}.current"] = log.current[:, j]
    pq.write_table(pa.table(columns), path)
    return path


def _outcome(
    seed: int, kind: str, joint: str | None, found: DiagnosisFile, stages: str, seconds: float
) -> Outcome:
    names = [[item.effect, item.joint or ""] for item in found.findings]
    pushed = kind == "external_contact" and bool(found.events)
    right = [item for item in found.findings if item.effect == kind]
    alike = [item for item in found.findings if kind in item.confusable_with]
    at = [item.joint for item in (*right, *alike)]
    clean = kind == "clean"
    return Outcome(
        seed,
        kind,
        joint,
        found.verdict,
        names,
        named=not names and not found.unexplained if clean else bool(right or alike or pushed),
        exact=not names and not found.unexplained if clean else bool(right or pushed),
        placed=joint in at or (pushed and any(joint in e.joints for e in found.events)),
        stages=stages,
        seconds=seconds,
    )


def as_row(outcome: Outcome) -> dict[str, object]:
    """A line of the cache."""
    return asdict(outcome)
