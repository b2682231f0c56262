"""What the stages say of one arm of the coverage study, beside what is true."""

import time
import warnings
from collections.abc import Mapping, Sequence
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from seqid_cli import identify
from seqid_cli.errors import SeqidError, SeqidWarning
from seqid_cli.model.friction import FrictionSurface
from seqid_cli.params.schema import FrictionJoint, FrictionStage, ImuStage, Stages
from tests import Array
from tests.plants.robots.lab import true_standard, true_value
from tests.plants.simulate import Plant
from tests.studies.coverage.cases import STREAM, Case, draw, record

Row = dict[str, Any]
Result = dict[str, Any]

POINTS = 10  # of each friction surface
POINT_STREAM = 95
VAGUE_DEG = 20.0  # a mounting's angle with a larger stated error is not known, and no estimate


def score(case: Case) -> Result:
    """Record the case's logs, run friction, gravity, imu-calib and inertia, compare with truth."""
    drawn = draw(case)
    result: Result = {
        "rig": case.rig,
        "seed": case.seed,
        "noise": case.noise,
        "encoder": case.encoder,
        "traits": drawn.traits,
        "rows": [],
    }
    with TemporaryDirectory(prefix="seqid-coverage-") as name:
        folder = Path(name)
        record(case, drawn, folder)
        start = time.process_time()
        stages, problem = identified(folder)
        result["cpu_s"] = round(time.process_time() - start, 2)
    if problem:
        result["failed"] = problem
    result["rows"] = compare(case, drawn.plant, stages)
    result["verdicts"] = verdicts(stages)
    if stages.inertia is not None:
        result["rotor_coupling"] = stages.inertia.rotor_coupling
        result["notes"] = list(stages.inertia.notes)
        result["cutoff_hz"] = stages.inertia.cutoff_hz
    return result


def identified(folder: Path) -> tuple[Stages, str]:
    """The stages in their order by the package's own functions, and what stopped them."""
    robot = folder / "robot.toml"
    logs = {name: str(folder / name) for name in ("friction", "gravity", "imu", "inertia")}
    there = {name: path for name, path in logs.items() if Path(path).is_dir()}
    slow = [there[name] for name in ("gravity", "friction") if name in there]
    out = {name: folder / f"{name}.json" for name in logs}
    stages = Stages()
    name = "friction"
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", SeqidWarning)
            stages = identify.friction(there[name], robot, output=out[name]).stages
            last, name = out[name], "gravity"
            stages = identify.gravity(slow, robot, last, output=out[name]).stages
            last = out[name]
            if "imu" in there:
                name = "imu"
                stages = identify.imu_calib(there[name], robot, last, output=out[name]).stages
                last = out[name]
            name = "inertia"
            stages = identify.inertia(there[name], robot, last, output=out[name]).stages
    except SeqidError as error:
        return stages, f"{name}: {error.message}"
    return stages, ""


def compare(case: Case, plant: Plant, stages: Stages) -> list[Row]:
    """Every estimate with its stated standard error and the truth."""
    rows: list[Row] = []
    if stages.friction is not None:
        rng = np.random.default_rng([STREAM[case.rig], case.seed, POINT_STREAM])
        rows += friction_rows(plant, stages.friction, rng)
    for name in ("gravity", "inertia"):
        stage = getattr(stages, name)
        if stage is not None:
            standard = true_standard(plant)
            rows += [
                row(name, p.name, p.value, p.std_error, true_value(p.terms, standard))
                for p in stage.parameters
            ]
    if stages.imu is not None:
        rows += imu_rows(plant, stages.imu)
    return rows


def row(group: str, name: str, estimate: float, std_error: float, truth: float) -> Row:
    """One estimate; numbers as JSON has them."""
    return {
        "group": group,
        "name": name,
        "estimate": float(estimate),
        "std_error": float(std_error),
        "truth": float(truth),
    }


def friction_rows(plant: Plant, stage: FrictionStage, rng: np.random.Generator) -> list[Row]:
    """Surfaces at random positions and speeds of the range that each is identified over."""
    rows = []
    for j, name in enumerate(plant.arm.names):
        if name not in stage.joints:
            continue
        found = stage.joints[name]
        q = rng.uniform(*found.position_range, POINTS)
        v = rng.uniform(*found.speed_range, POINTS) * rng.choice([-1.0, 1.0], POINTS)
        value, error = surface_at(found, q, v)
        truth = true_friction(plant, j, q, v)
        for k in range(POINTS):
            one = row("friction", name, value[k], error[k], truth[k])
            rows.append(one | {"q": round(float(q[k]), 4), "v": round(float(v[k]), 4)})
    return rows


def surface_at(joint: FrictionJoint, q: Array, v: Array) -> tuple[Array, Array]:
    """Friction (N,) N m of a parameter file's surface, and its standard error."""
    surface = FrictionSurface.from_stage(joint)
    columns = surface.columns(q, v)
    variance = np.einsum("nk,kl,nl->n", columns, surface.covariance, columns)
    return surface.torque(q, v), np.sqrt(np.maximum(variance, 0.0))


def true_friction(plant: Plant, joint: int, q: Array, v: Array) -> Array:
    """Friction torque (N,) N m of the plant's joint while it slides."""
    position, velocity = np.zeros((2, len(q), plant.arm.n))
    position[:, joint], velocity[:, joint] = q, v
    law = plant.friction.begin()(0.0, position, velocity, np.zeros_like(position))
    dry = np.where(velocity > 0, law.forward, -law.backward)
    return (dry + law.smooth)[:, joint]


def imu_rows(plant: Plant, stage: ImuStage) -> list[Row]:
    """Mountings as small rotations about the link's axes, deg; the truth is none.

    Angles that are not known, such as that about the only axis an IMU turns about, are left out.
    """
    rows = []
    for imu in plant.imus:
        if imu.name not in stage.imus:
            continue
        found = stage.imus[imu.name]
        off = Rotation.from_matrix(np.array(found.rotation) @ imu.rotation.T).as_rotvec()
        for axis, angle, error in zip("xyz", np.degrees(off), found.std_errors_deg, strict=True):
            if error < VAGUE_DEG:
                rows.append(row("imu", f"{imu.name} {axis}", angle, error, 0.0))
    return rows


def verdicts(stages: Stages) -> Mapping[str, bool]:
    """Whether all verdicts of each stage are good."""
    found: dict[str, bool] = {}
    for name in ("friction", "gravity", "imu", "inertia"):
        stage = getattr(stages, name)
        if stage is not None:
            found[name] = all(verdict.good for verdict in stage.verdicts)
    return found


def z_of(rows: Sequence[Row]) -> Array:
    """Errors over stated standard errors; infinite where an error is stated as none."""
    off = np.array([r["estimate"] - r["truth"] for r in rows])
    error = np.array([r["std_error"] for r in rows])
    with np.errstate(divide="ignore"):
        return np.where(error > 0, off / np.where(error > 0, error, 1.0), np.inf * np.sign(off))
