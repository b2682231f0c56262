"""What the stages say of one arm of the coverage study, beside what is true."""

import time
import warnings
from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from seqid_cli import identify
from seqid_cli.errors import SeqidError, SeqidWarning
from seqid_cli.model.friction import FrictionSurface
from seqid_cli.params.schema import FrictionStage, ImuCalibration, ImuStage, Stages
from tests import Array
from tests.plants.robots.lab import true_friction, true_standard, true_value
from tests.plants.sensors import AccelerometerArray
from tests.plants.simulate import Plant
from tests.studies.coverage.cases import STREAM, Case, draw, record

Row = Result = dict[str, Any]

# The function of each stage, and the folders of the logs that it gets.
STAGES = {
    "friction": (identify.friction, ["friction"]),
    "gravity": (identify.gravity, ["gravity", "friction"]),
    "imu": (identify.imu_calib, ["imu"]),
    "inertia": (identify.inertia, ["inertia"]),
}
POINTS = 10  # of each friction surface
POINT_STREAM = 95
# a mounting's angle with a larger stated error is not known, and no estimate
VAGUE_DEG = 20.0


def score(case: Case) -> Result:
    """Record the case's logs, run friction, gravity, imu-calib and inertia, compare
    with truth.
    """
    drawn = draw(case)
    result: Result = {**asdict(case), "traits": drawn.traits, "rows": []}
    with TemporaryDirectory(prefix="seqid-coverage-") as name:
        folder = Path(name)
        record(case, drawn, folder)
        start = time.process_time()
        stages, problem = identified(folder)
        result["cpu_s"] = round(time.process_time() - start, 2)
    result |= {"failed": problem} if problem else {}
    result["rows"] = compare(case, drawn.plant, stages)
    found = {
        name: stage.verdicts for name in STAGES if (stage := getattr(stages, name))
    }
    result["verdicts"] = {name: all(v.good for v in own) for name, own in found.items()}
    if inertia := stages.inertia:
        result |= {
            "rotor_coupling": inertia.rotor_coupling,
            "notes": list(inertia.notes),
        }
    return result


def identified(folder: Path) -> tuple[Stages, str]:
    """The stages in their order by the package's own functions,
    and what stopped them.
    """
    stages, known = Stages(), []
    for name, (identify_it, kinds) in STAGES.items():
        logs = [str(folder / kind) for kind in kinds if (folder / kind).is_dir()]
        robot, out = folder / "robot.toml", folder / f"{name}.json"
        try:
            with warnings.catch_warnings(action="ignore", category=SeqidWarning):
                if logs:
                    stages, known = (
                        identify_it(logs, robot, *known, output=out).stages,
                        [out],
                    )
        except SeqidError as error:
            return stages, f"{name}: {error.message}"
    return stages, ""


def compare(case: Case, plant: Plant, stages: Stages) -> list[Row]:
    rows: list[Row] = []
    if stages.friction is not None:
        rng = np.random.default_rng([STREAM[case.rig], case.seed, POINT_STREAM])
        rows += friction_rows(plant, stages.friction, rng)
    standard = true_standard(plant)
    for name in ("gravity", "inertia"):
        for p in getattr(getattr(stages, name), "parameters", ()):
            rows.append(
                row(name, p.name, p.value, p.std_error, true_value(p.terms, standard))
            )
    return rows + ([] if stages.imu is None else imu_rows(plant, stages.imu))


def row(group: str, name: str, *numbers: float) -> Row:
    kinds = zip(("estimate", "std_error", "truth"), map(float, numbers), strict=True)
    return {"group": group, "name": name, **dict(kinds)}


def friction_rows(
    plant: Plant, stage: FrictionStage, rng: np.random.Generator
) -> list[Row]:
    """Surfaces at random positions and speeds of the range that each is identified
    over.
    """
    rows = []
    for j, name in enumerate(plant.arm.names):
        if not (found := stage.joints.get(name)):
            continue
        surface = FrictionSurface.from_stage(found)
        q = rng.uniform(*found.position_range, POINTS)
        v = rng.uniform(*found.speed_range, POINTS) * rng.choice([-1.0, 1.0], POINTS)
        columns, value = surface.columns(q, v), surface.torque(q, v)
        variance = np.einsum("nk,kl,nl->n", columns, surface.covariance, columns)
        error = np.sqrt(np.maximum(variance, 0.0))
        truth = true_friction(plant, j, q, v)
        rows += [
            row("friction", name, *one) for one in zip(value, error, truth, strict=True)
        ]
    return rows


def imu_rows(plant: Plant, stage: ImuStage) -> list[Row]:
    """Mountings as small rotations about the link's axes, deg; the truth is none."""
    rows = []
    for imu in (imu for imu in plant.imus if imu.name in stage.imus):
        for axis, angle, error in zip(
            "xyz", *turned(imu, stage.imus[imu.name]), strict=True
        ):
            if error < VAGUE_DEG:
                rows.append(row("imu", f"{imu.name} {axis}", angle, error, 0.0))
    return rows


def turned(imu: AccelerometerArray, found: ImuCalibration) -> tuple[Array, Array]:
    """Error of a mounting about the link's axes (3,) deg, and the stated standard
    error.
    """
    off = Rotation.from_matrix(np.array(found.rotation) @ imu.rotation.T).as_rotvec()
    return np.degrees(off), np.array(found.std_errors_deg, dtype=np.float64)


def z_of(rows: Sequence[Row]) -> Array:
    """Errors over stated standard errors; infinite where an error is stated as none."""
    off = np.array([r["estimate"] - r["truth"] for r in rows])
    error = np.array([r["std_error"] for r in rows])
    return np.divide(off, error, out=np.inf * np.sign(off), where=error > 0)
