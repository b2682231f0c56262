"""The paper's own rigs with the paper's encoders, at default settings, beside the
truth.

Errors are shares of the true value; those of `my` are shares of `mx`, as the paper has
them, and that of joint 1 of the planar rig is of the whole of Eq. 44's pi_1.
"""

import tempfile
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from seqid_cli.imu.link_acceleration import best_motion
from seqid_cli.logs.read import read_recording
from seqid_cli.motion.motion import Motion, estimate_motion
from seqid_cli.motion.options import MotionOptions
from seqid_cli.params.schema import RigidStage, Stages
from seqid_cli.robot.file import load_robot
from tests import Array
from tests.plants.arms.rigs import GEAR, one_joint, two_joint
from tests.plants.motions.experiments import Trial
from tests.plants.robotfile import robot_toml
from tests.plants.robots.lab import true_standard, true_value, write_log
from tests.plants.samples import one_joint_trials, two_joint_trials
from tests.plants.simulate import Log, Plant, simulate
from tests.studies.coverage.score import identified
from tests.studies.coverage.study import OPEN
from tests.studies.rigs.repetition import another
from tests.studies.rigs.two_joint import surface_error
from tests.studies.tables import number, rms, table
from tests.studies.truth.score import Row, verdict_row

STREAM = 640
COUNTS = (
    600,
    2400,
)  # a turn of the joint: 100 lines of the motor's encoder, single and fourfold
RIGS: Mapping[str, tuple[Callable[[], Plant], Callable[..., list[Trial]]]] = {
    "one joint": (one_joint, one_joint_trials),
    "two joints": (two_joint, two_joint_trials),
    # What rotors do to the links that carry them is a hundredth of the torque: it takes
    # minutes of moves to be told.
    "two joints, longer": (two_joint, partial(two_joint_trials, inertia_s=60.0)),
}
EVERY = 4  # control periods of 1 ms to a row of the log
PAPER = {  # errors in %, of Tables I, II and IV
    ("one joint", "mx_1"): "3.4",
    ("one joint", "my_1"): "1.1",
    ("one joint", "Izz_1"): "16",
    ("two joints", "Izz_1"): "2.1",
    ("two joints", "Izz_2"): "10.5",
    ("two joints", "mx_2"): "5.7",
    ("two joints", "my_2"): "1.1",
}


def label_of(rig: str, counts: int, seed: int) -> str:
    return f"{rig}, {counts} counts, seed {seed}"


def rig_row(rig: str, counts: int, seed: int) -> Row:
    """Record one rig's logs, run all stages, compare."""
    make, trials_of = RIGS[rig]
    rng = np.random.default_rng([STREAM, len(rig), counts, seed])
    plant = make()
    step = np.full(plant.arm.n, 2.0 * np.pi / counts)
    plant = another(replace(plant, encoder_step=step), rng)
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        logs = _recorded(plant, trials_of(plant, rng), folder, seed)
        started = time.process_time()
        stages, problem = identified(folder)
        row: Row = {
            "rig": rig,
            "counts": counts,
            "seed": seed,
            "failed": problem,
            "seconds": time.process_time() - started,
        }
        if problem or stages.inertia is None or stages.friction is None:
            return row
        errors = [
            surface_error(plant, stages.friction, j).rms for j in range(plant.arm.n)
        ]
        return row | {
            "parameters": _parameters(plant, stages),
            "friction": errors,
            "levels": _levels(stages),
            "cutoff_hz": stages.inertia.cutoff_hz,
            "sources": sorted({use.source for use in stages.inertia.motion_use}),
            "coupling": stages.inertia.rotor_coupling,
            "undecided": any(
                words in note for note in stages.inertia.notes for words in OPEN
            ),
            "acceleration": _accelerations(folder, stages, logs),
        }


def _recorded(
    plant: Plant, trials: Sequence[Trial], folder: Path, seed: int
) -> dict[Path, Log]:
    """Write all logs as a user has them; return those of the inertia stage with their
    truth.
    """
    (folder / "robot.toml").write_text(robot_toml("rig", plant), encoding="ascii")
    kept = {}
    for number_of, trial in enumerate(trials):
        log = simulate(
            plant,
            trial.reference,
            1000 * (seed + 1) + number_of,
            every=EVERY,
            imus=trial.imus,
        )
        path = folder / trial.stage / f"{trial.name}.parquet"
        write_log(path, plant, log)
        if trial.stage == "inertia":
            kept[path] = log
    return kept


def _parameters(plant: Plant, stages: Stages) -> list[Row]:
    """Error and stated error of every parameter that gravity and inertia determine."""
    standard = true_standard(plant)
    scale = dict(standard)
    for k in range(1, plant.arm.n + 1):
        scale[f"my_{k}"] = standard[f"mx_{k}"]
    if plant.arm.n == 2:
        length = float(plant.arm.dh[1, 1])
        whole = {"Izz_1": 1.0, "m_2": length**2, "Ia_1": GEAR**2}
        scale["Izz_1"] = true_value(whole, standard)
    rows = []
    rigid: list[RigidStage | None] = [stages.gravity, stages.inertia]
    for stage in filter(None, rigid):
        for p in stage.parameters:
            off = p.value - true_value(p.terms, standard)
            rows.append(
                {
                    "name": p.name,
                    "error": off / scale[p.name],
                    "std_error": p.std_error / scale[p.name],
                }
            )
    return rows


def _levels(stages: Stages) -> dict[str, str]:
    found = {}
    for name in ("friction", "gravity", "imu", "inertia"):
        stage = getattr(stages, name)
        if stage is not None:
            found[name] = str(verdict_row(stage.verdicts, Path())["level"])
    return found


def _accelerations(
    folder: Path, stages: Stages, logs: Mapping[Path, Log]
) -> dict[str, list[float]]:
    """RMS errors (n,) rad/s^2 of encoder's and fused acceleration at the stage's
    cut-off.
    """
    robot = load_robot(folder / "robot.toml")
    assert stages.inertia is not None
    options = MotionOptions(cutoff_hz=stages.inertia.cutoff_hz)
    squares: dict[str, list[Array]] = {"encoder": [], "fused": []}
    for path, log in logs.items():
        recording = read_recording(path, robot)
        encoder = estimate_motion(recording, robot, options)
        fused = best_motion(recording, robot, stages.imu, encoder, source="fused")
        for name, motion in (("encoder", encoder), ("fused", fused)):
            off = _off(motion, log)
            squares[name].append(np.mean(off**2, axis=0))
    return {name: np.sqrt(np.mean(x, axis=0)).tolist() for name, x in squares.items()}


def _off(motion: Motion, log: Log) -> Array:
    """Errors (N, n) of the acceleration against the truth below the same cut-off."""
    truth = motion.lowpass(log.truth.ddq, np.ones(len(log.t), dtype=bool))
    return np.asarray((motion.ddq - truth)[motion.usable])


def rig_tables(rows: Sequence[Row]) -> str:
    """A table of parameters, and one of what else was asked."""
    groups: dict[tuple[str, int], list[Row]] = {}
    for row in rows:
        groups.setdefault((row["rig"], row["counts"]), []).append(row)
    parameters: list[list[str]] = []
    others: list[list[str]] = []
    for (rig, counts), some in groups.items():
        title = f"{rig}, {counts} counts"
        done = [row for row in some if not row["failed"]]
        parameters += _parameter_cells(title, rig, done)
        others.append(_other_cells(title, some, done))
    header = ["parameter", "median error %", "worst %", "rms z", "worst z", "paper %"]
    other = ["rig", "rigs", "within 1 %", "kappa right", "friction RMS %, worst"]
    other += ["cut-off Hz", "encoder / fused, median", "least", "all stages good"]
    return "\n\n".join([table(header, parameters), table(other, others)])


def _parameter_cells(title: str, rig: str, rows: Sequence[Row]) -> list[list[str]]:
    by_name: dict[str, list[Row]] = {}
    for p in (p for row in rows for p in row["parameters"]):
        by_name.setdefault(p["name"], []).append(p)
    cells = []
    for name, found in by_name.items():
        errors = 100.0 * np.abs([p["error"] for p in found])
        z = np.array([p["error"] / p["std_error"] for p in found])
        sizes = [
            float(np.median(errors)),
            float(errors.max()),
            rms(z),
            float(np.abs(z).max()),
        ]
        paper = PAPER.get((rig, name), "")
        cells.append([f"{title}: {name}", *map(number, sizes), paper])
    return cells


def _other_cells(title: str, every: Sequence[Row], rows: Sequence[Row]) -> list[str]:
    def share(which: Callable[[Row], Any]) -> str:
        return f"{sum(bool(which(row)) for row in rows)} of {len(every)}"

    # The rotors of these rigs turn with their own joints alone.
    def decided(row: Row) -> bool:
        return row["coupling"] == "diagonal" and not row["undecided"]

    ratios = [
        encoder / fused
        for row in rows
        for encoder, fused in zip(*map(row["acceleration"].get, SOURCES), strict=True)
    ]
    cutoffs = [row["cutoff_hz"] for row in rows]
    friction = [100.0 * x for row in rows for x in row["friction"]]
    return [
        title,
        str(len(every)),
        share(lambda row: all(abs(p["error"]) < 0.01 for p in row["parameters"])),
        share(decided) if "two" in title else "-",
        number(max(friction)),
        f"{number(min(cutoffs))} to {number(max(cutoffs))}",
        number(float(np.median(ratios))),
        number(min(ratios)),
        share(lambda row: set(row["levels"].values()) == {"good"}),
    ]


SOURCES = ("encoder", "fused")
