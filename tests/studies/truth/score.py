"""What the stages say of a case, beside what is true: a row of plain values."""

import tempfile
import time
import warnings
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow.parquet as pq
from scipy.spatial.transform import Rotation

from seqid_cli import identify
from seqid_cli.errors import SeqidError, SeqidWarning
from seqid_cli.model.friction import FrictionSurface
from seqid_cli.params.schema import (
    FrictionStage,
    ImuStage,
    Parameter,
    ParameterFile,
    Verdict,
)
from tests import Array
from tests.studies.truth.plan import Case
from tests.studies.truth.session import Session, paths, session_of
from tests.studies.truth.truths import (
    true_friction,
    true_nuisances,
    true_offset,
    true_standard,
)

Row = dict[str, Any]
HANDED_ON = "friction, after gravity"  # as the gravity stage leaves it
POINTS = 10  # of each friction surface, in each direction
# Bands, and how many standard deviations they are wide.
LEVELS = {0.9: 1.645, 0.95: 1.960}
WORST_FIRST = ("poor", "usable", "good")
COLD = 25.0  # degC
VAGUE_DEG = 20.0  # a turn with a larger stated error is not known, and no estimate


def scored(case: Case, cache: Path) -> Row:
    """Run every stage on a case's logs, and compare with the truth."""
    started = time.process_time()
    session = session_of(case, cache / "logs")
    row: Row = {
        "label": case.label,
        "seed": case.seed,
        "n": case.arm.n,
        "imus": len(case.arm.imus),
        "rate_hz": case.arm.rate_hz,
        "imperfections": [
            {"kind": x.kind, "declared": x.declared, "sizes": x.sizes}
            for x in case.imperfections
        ],
        "stages": {},
        "failed": {},
        "simulated_s": time.process_time() - started,
    }
    started = time.process_time()
    with tempfile.TemporaryDirectory() as name, warnings.catch_warnings():
        warnings.simplefilter("ignore", SeqidWarning)
        _Stages(case, session, Path(name), row).run()
    return row | {"seconds": time.process_time() - started}


class _Stages:
    """The stages in a user's order, each with its file; what fails is a part of the
    answer.
    """

    def __init__(self, case: Case, session: Session, folder: Path, row: Row) -> None:
        self.case, self.session, self.folder, self.row = case, session, folder, row
        self.truth = true_standard(case)

    def run(self) -> None:
        session, robot = self.session, self.session.robot
        trials = paths(session, ["friction"])
        slow = paths(session, ["friction", "gravity"])
        moves = paths(session, ["inertia"])

        friction = self._stage(
            "friction", lambda out: identify.friction(trials, robot, output=out)
        )
        gravity = friction and self._stage(
            "gravity", lambda out: identify.gravity(slow, robot, friction, output=out)
        )
        known = gravity
        if known and self.case.arm.imus:
            logs = [*paths(session, ["gravity"]), *moves]
            known = self._stage(
                "imu", lambda out: identify.imu_calib(logs, robot, gravity, output=out)
            )
            known = known or gravity
        inertia = known and self._stage(
            "inertia", lambda out: identify.inertia(moves, robot, [known], output=out)
        )
        imu = [known] if known and self.case.arm.imus and known != gravity else []
        self._stage(
            "simultaneous",
            lambda out: identify.simultaneous(moves, robot, imu, output=out),
        )
        if inertia:
            self._predict(inertia)

    def _stage(
        self, name: str, function: Callable[[Path], ParameterFile]
    ) -> Path | None:
        path = self.folder / f"{name}.json"
        started = time.process_time()
        try:
            file = function(path)
        except SeqidError as error:
            self.row["failed"][name] = self._short(error.message)
            return None
        except Exception as error:  # a case that fails is an answer too
            self.row["failed"][name] = f"{type(error).__name__}: {error}"
            return None
        seconds = time.process_time() - started
        self.row["stages"][name] = self._of_stage(name, file) | {"seconds": seconds}
        if name == "gravity":
            handed_on = verdict_row(file.stages.friction.verdicts, self.session.folder)
            handed_on["parameters"] = []
            handed_on["friction"] = friction_rows(
                self.case, self.session.warmth, file.stages.friction
            )
            self.row["stages"][HANDED_ON] = handed_on
        return path

    def _short(self, text: str) -> str:
        return text.replace(f"{self.session.folder}/", "")

    def _of_stage(self, name: str, file: ParameterFile) -> Row:
        stages = file.stages
        if name == "simultaneous":
            verdicts = [*stages.inertia.verdicts, *stages.friction.verdicts]
            parameters = stages.inertia.parameters
        else:
            stage = getattr(stages, name)
            verdicts, parameters = stage.verdicts, getattr(stage, "parameters", [])
        row: Row = verdict_row(verdicts, self.session.folder)
        row["parameters"] = [self._of_parameter(p) for p in parameters]
        if name == "imu":
            row["parameters"] = imu_rows(self.case, stages.imu)
        if name in ("friction", "simultaneous"):
            one_step = name == "simultaneous"
            warmth = self.session.warmth_of_moves if one_step else self.session.warmth
            row["friction"] = friction_rows(self.case, warmth, stages.friction)
        if name in ("inertia", "simultaneous"):
            row["rotor_coupling"] = stages.inertia.rotor_coupling
            row["cutoff_hz"] = stages.inertia.cutoff_hz
        row["nuisances"] = nuisance_rows(self.case, file, name)
        noted = stages.inertia if name == "simultaneous" else getattr(stages, name)
        return row | {"notes": list(noted.notes)}

    def _of_parameter(self, p: Parameter) -> Row:
        truth = sum(factor * self.truth[name] for name, factor in p.terms.items())
        return {
            "name": p.name,
            "value": p.value,
            "std_error": p.std_error,
            "truth": truth,
        }

    def _predict(self, file: Path) -> None:
        torques = self.folder / "torques.parquet"
        logs = paths(self.session, ["held_out"])
        try:
            found = identify.predict(logs, self.session.robot, file, torques=torques)
        except SeqidError as problem:
            self.row["failed"]["predict"] = self._short(problem.message)
            return
        table = pq.read_table(torques)
        noise = dict(zip(self.case.arm.names, self.session.noise, strict=True))
        cutoff = float(np.mean([log.cutoff_hz for log in found.logs]))
        passed = min(1.0, 2.0 * cutoff / self.case.arm.rate_hz)
        joints = {}
        for name, error in found.joints.items():
            # White noise that the same low-pass leaves.
            left = noise[name] * float(np.sqrt(passed))
            joints[name] = {
                "rmse": error.rmse,
                "relative": error.relative_rmse,
                "noise": left,
                "bands": bands(table, name),
            }
        self.row["prediction"] = verdict_row(found.verdicts, self.session.folder) | {
            "joints": joints
        }


def verdict_row(verdicts: Sequence[Verdict], folder: Path) -> Row:
    """Return the worst level of some verdicts, and the reasons of all that are not
    good.

    Logs are named without their `folder`, which says nothing about them.
    """
    levels = [x.level for x in verdicts]
    worst = min(levels, key=WORST_FIRST.index, default="good")
    reasons = [
        f"{x.joint}: {x.reason}" if x.joint else x.reason
        for x in verdicts
        if x.level != "good"
    ]
    return {"level": worst, "reasons": [x.replace(f"{folder}/", "") for x in reasons]}


def friction_rows(
    case: Case, warmth: Sequence[float], stage: FrictionStage
) -> list[Row]:
    """Compare surfaces at random places of the identified range, both ways.

    `z` counts a logged offset as part of the friction, `z_without` does not. The truth
    is at the temperature that the file states, or else at the mean of the stage's own
    logs: `warmth` (n,) K above the cold arm.
    """
    rows = []
    names = case.arm.names
    for name, joint in stage.joints.items():
        j = names.index(name)
        rng = np.random.default_rng([case.seed, 623, j])
        (low, high), (slow, fast) = joint.position_range, joint.speed_range
        q = np.tile(rng.uniform(low, high, POINTS), 2)
        speed = rng.uniform(slow, fast, POINTS)
        v = np.concatenate([speed, -speed])
        surface = FrictionSurface.from_stage(joint)
        stated = joint.temperature
        above_cold = warmth[j] if stated is None else stated - COLD
        truth = true_friction(case, j, q, v, above_cold)
        found, error = surface.torque(q, v), surface.stated_error(q, v)
        rows.append(
            {
                "joint": name,
                "z": _z(found - truth - true_offset(case, j), error),
                "z_without": _z(found - truth, error),
                "relative": float(
                    np.sqrt(np.mean((found - truth) ** 2) / np.mean(truth**2))
                ),
                "stated": float(np.sqrt(np.mean(error**2) / np.mean(truth**2))),
            }
        )
    return rows


def nuisance_rows(case: Case, file: ParameterFile, name: str) -> list[Row]:
    """Compare what a stage states of the drives: delays, offsets and the like."""
    stages = file.stages
    rigid = stages.inertia if name == "simultaneous" else getattr(stages, name)
    found = list(getattr(rigid, "nuisances", ()))
    if name in ("friction", "simultaneous"):
        found += [
            x for joint in stages.friction.joints.values() for x in joint.nuisances
        ]
    rows = []
    for x in found:
        truth = true_nuisances(case, case.arm.names.index(x.joint))
        if x.name in truth:
            row = {"name": x.name, "joint": x.joint, "value": x.value}
            rows.append(row | {"std_error": x.std_error, "truth": truth[x.name]})
    return rows


def imu_rows(case: Case, stage: ImuStage) -> list[Row]:
    """Compare where IMUs sit: turns about the link's axes in deg, origins in m."""
    rows = []
    for k, imu in enumerate(case.arm.imus):
        if (found := stage.imus.get(f"imu{k}")) is None:
            continue
        w, *v = imu.quaternion
        true_rotation = Rotation.from_quat([*v, w]).as_matrix()
        off = Rotation.from_matrix(
            np.array(found.rotation) @ true_rotation.T
        ).as_rotvec()
        turns = zip("xyz", np.degrees(off), found.std_errors_deg, strict=False)
        for axis, angle, error in turns:
            if error < VAGUE_DEG:
                rows.append(_imu_row(f"imu{k} turn {axis}", float(angle), error, 0.0))
        places = zip(
            "xyz", found.lever, found.lever_std_errors, imu.place, strict=False
        )
        for axis, place, place_error, truth in places:
            if place is not None and place_error is not None:
                rows.append(
                    _imu_row(f"imu{k} {axis}", place, place_error, float(truth))
                )
    return rows


def _imu_row(name: str, value: float, std_error: float, truth: float) -> Row:
    return {"name": name, "value": value, "std_error": std_error, "truth": truth}


def _z(error: Array, std_error: Array) -> list[float]:
    return [float(x) for x in error / np.maximum(std_error, 1e-12)]


def bands(table: Any, joint: str) -> dict[str, float]:
    """Return the shares of sliding samples inside predicted bands; nothing where there
    are none.
    """
    if f"{joint}.std" not in table.column_names:
        return {}
    residual, std = (
        table[f"{joint}.{what}"].to_numpy().astype(np.float64)
        for what in ("residual", "std")
    )
    sliding = table[f"{joint}.sliding"].to_numpy().astype(bool) & np.isfinite(
        residual * std
    )
    z = np.abs(residual[sliding]) / std[sliding]
    return {
        f"{100 * level:.0f}": float(np.mean(z <= wide))
        for level, wide in LEVELS.items()
    }
