"""What no stage can see: how wrong a robot file may be before anything says so, with
sizes.

One arm of two joints in the vertical plane is recorded once per seed. Its logs are
identified with the right robot file, and with files (or stamps) that are wrong in one
thing of a known size. Then with the same file once more that states the size as a
tolerance, where there is a key for it.
"""

import argparse
import re
import warnings
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from seqid_cli import identify
from seqid_cli.errors import SeqidWarning
from seqid_cli.params.document import worst_level
from seqid_cli.params.schema import Stages, Verdict
from tests import Array
from tests.plants.arms.vertical import vertical_two_joint
from tests.plants.motions import experiments
from tests.plants.robotfile import robot_toml
from tests.plants.robots.lab import true_standard, true_value, write_log
from tests.plants.simulate import Log, Plant, simulate
from tests.studies import tables
from tests.studies.coverage.score import friction_rows, identified

SEEDS = range(2)  # of noise and motion: tuning seeds
EVERY = 4  # control periods of 1 ms per row
STREAM = 2161
POSTURES = [np.array([0.3, angle]) for angle in (-1.2, 0.2, 1.4)]


@dataclass(frozen=True, kw_only=True)
class Mistake:
    """A robot file, or stamps, that are wrong in one thing.

    `believed` is the arm that the robot file describes. `tolerance` are keys of the
    robot file that state the size: those of all joints, then those of the arm. `rate`
    and `late_s` are of the stamps: a clock that is fast, and what all channels are late
    by.
    """

    name: str
    believed: Plant
    joint_tolerance: dict[str, float] = field(default_factory=dict)
    arm_tolerance: str = ""
    rate: float = 1.0
    late_s: float = 0.0


def mistakes(plant: Plant) -> list[Mistake]:
    """Return the mistakes, none first, in the sizes that a careful lab may make."""

    def geometry(joint: int, column: int, by: float) -> Plant:
        dh = plant.arm.dh.copy()
        dh[joint, column] += by
        return replace(plant, arm=replace(plant.arm, dh=dh))

    def constants(*factors: float) -> Plant:
        return replace(plant, torque_constant=plant.torque_constant * np.array(factors))

    degree = float(np.deg2rad(1.0))
    turned = Rotation.from_euler("y", 2.0 * degree).apply(plant.arm.gravity)
    tilted = replace(plant, arm=replace(plant.arm, gravity=turned))
    zero = {"position_zero_error": degree}
    drive = {"torque_constant_error": 0.05}
    place = "geometry_error = { position = 0.005 }"
    turn = f"geometry_error = {{ angle = {degree!r} }}"
    lean = f"gravity_error = {2.0 * degree!r}"
    return [
        Mistake(name="nothing", believed=plant),
        Mistake(
            name="link length, 5 mm",
            believed=geometry(1, 1, 0.005),
            arm_tolerance=place,
        ),
        Mistake(
            name="link twist, 1 deg",
            believed=geometry(1, 0, degree),
            arm_tolerance=turn,
        ),
        Mistake(name="gravity's direction, 2 deg", believed=tilted, arm_tolerance=lean),
        Mistake(
            name="zero of the first joint, 1 deg",
            believed=geometry(0, 3, degree),
            joint_tolerance=zero,
        ),
        Mistake(
            name="zero of the second joint, 1 deg",
            believed=geometry(1, 3, degree),
            joint_tolerance=zero,
        ),
        Mistake(
            name="torque constants, 5 %",
            believed=constants(1.05, 1.05),
            joint_tolerance=drive,
        ),
        Mistake(
            name="torque constant of the second joint, 5 %",
            believed=constants(1.0, 1.05),
            joint_tolerance=drive,
        ),
        Mistake(name="clock 1 % fast", believed=plant, rate=1.01),
        Mistake(name="all channels 5 ms late", believed=plant, late_s=0.005),
    ]


def recorded(plant: Plant, seed: int) -> dict[str, Log]:
    """Record the logs of one seed, by `<stage>/<name>`."""
    rng = np.random.default_rng([STREAM, seed])
    trials = [
        *experiments.friction_trials(plant, POSTURES[1], speeds=7, lowest=0.12),
        *experiments.gravity_trials(plant, POSTURES, speeds=(0.3,)),
        *experiments.inertia_trials(plant, POSTURES, rng, pairs=[(0, 1), (0, 1)]),
        *experiments.validation_trials(plant, rng, seconds=10.0, points=5),
    ]
    logs = {}
    for number, trial in enumerate(trials):
        state = np.random.SeedSequence([STREAM, seed, number]).generate_state(1)
        log = simulate(plant, trial.reference, int(state[0]), every=EVERY)
        logs[f"{trial.stage}/{trial.name}"] = log
    return logs


def robot_file(mistake: Mistake, *, stated: bool) -> str:
    """Return the text of the robot file, with its tolerance or without."""
    text = robot_toml("vertical", mistake.believed)
    if not stated:
        return text
    for key, value in mistake.joint_tolerance.items():
        text = re.sub(r"(?m)^(gear_ratio = .*)$", rf"\1\n{key} = {value!r}", text)
    return re.sub(
        r"(?m)^(gravity = .*)$", rf"\1\n{mistake.arm_tolerance}", text, count=1
    )


def scored(
    mistake: Mistake, logs: dict[str, Log], seed: int, *, stated: bool
) -> dict[str, Any]:
    """Identify the logs with a wrong robot file;
    compare with the arm that they are of.
    """
    plant = vertical_plant()
    with TemporaryDirectory(prefix="seqid-unseen-") as name:
        folder = Path(name)
        (folder / "robot.toml").write_text(
            robot_file(mistake, stated=stated), encoding="ascii"
        )
        for label, log in logs.items():
            stamped = replace(log, t=log.t * mistake.rate + mistake.late_s)
            write_log(folder / f"{label}.parquet", plant, stamped)
        stages, problem = identified(folder)
        assert not problem, problem
        with warnings.catch_warnings(action="ignore", category=SeqidWarning):
            prediction = identify.predict(
                [str(folder / "validation")],
                folder / "robot.toml",
                folder / "inertia.json",
            )
    assert stages.friction is not None
    rng = np.random.default_rng([STREAM, seed])
    rows = friction_rows(plant, stages.friction, rng)
    z = [(row["estimate"] - row["truth"]) / row["std_error"] for row in rows]
    relative = [(row["estimate"] - row["truth"]) / row["truth"] for row in rows]
    verdicts = [verdict for stage in stages_of(stages) for verdict in stage]
    found: dict[str, Any] = {
        "inside": tables.share_within(z, 1.96),
        "friction": tables.rms(relative),
        "held_out": max(
            joint.relative_rmse or 0.0 for joint in prediction.joints.values()
        ),
        "verdict": worst_level([*verdicts, *prediction.verdicts]),
    }
    for stage in ("gravity", "inertia"):
        found |= parameter_errors(stage, plant, stages)
    return found


def vertical_plant() -> Plant:
    """The arm: no accelerometers, which would know gravity by themselves."""
    return replace(vertical_two_joint(), imus=())


def stages_of(stages: Stages) -> list[list[Verdict]]:
    """Return the verdicts of the stages that are there."""
    found = (stages.friction, stages.gravity, stages.inertia)
    return [list(stage.verdicts) for stage in found if stage is not None]


def parameter_errors(name: str, plant: Plant, stages: Stages) -> dict[str, float]:
    """Return the worst error of a stage, over its stated error and over the largest of
    its unit.
    """
    standard = true_standard(plant)
    parameters = getattr(stages, name).parameters
    truths = np.array([true_value(p.terms, standard) for p in parameters])
    errors = np.array([p.value for p in parameters]) - truths
    stated = np.array([p.std_error for p in parameters])
    largest = np.array(
        [
            max(
                abs(t)
                for t, q in zip(truths, parameters, strict=True)
                if q.unit == p.unit
            )
            for p in parameters
        ]
    )
    # A wrong twist frees parameters that the right arm has not: nothing is known of
    # them.
    known = stated < largest
    return {
        f"{name}_z": float(np.abs(errors / stated).max()),
        f"{name}_error": float(np.abs(errors / largest)[known].max()),
    }


def study(_: argparse.Namespace | None = None) -> str:
    """Return the table of all mistakes, medians over the seeds."""
    plant = vertical_plant()
    logs = {seed: recorded(plant, seed) for seed in SEEDS}
    rows = []
    for mistake in mistakes(plant):
        found = [scored(mistake, logs[seed], seed, stated=False) for seed in SEEDS]
        cells = [mistake.name, *cells_of(found)]
        has_tolerance = bool(mistake.joint_tolerance or mistake.arm_tolerance)
        stated = [
            scored(mistake, logs[seed], seed, stated=True)
            for seed in SEEDS
            if has_tolerance
        ]
        both = ("gravity_z", "inertia_z")
        cells += [tables.number(median(stated, key)) if stated else "-" for key in both]
        rows.append(cells)
    titles = [
        "wrong",
        "friction off",
        "friction inside 95 %",
        "gravity off",
        "z",
        "inertia off",
        "z",
        "held out",
        "verdict",
        "gravity z, stated",
        "inertia z, stated",
    ]
    about = (
        f"{len(SEEDS)} tuning seeds, {SEEDS[0]} to {SEEDS[-1]}; medians of them.\n\n"
    )
    return about + tables.table(titles, rows)


def cells_of(found: Sequence[dict[str, Any]]) -> list[str]:
    """Return the medians of a mistake's numbers, and its worst verdicts, as text."""

    def percent(key: str) -> str:
        return f"{tables.number(100.0 * median(found, key))} %"

    verdicts = " ".join(dict.fromkeys(str(item["verdict"]) for item in found))
    numbers = [
        percent("friction"),
        f"{100.0 * median(found, 'inside'):.0f} %",
        percent("gravity_error"),
        tables.number(median(found, "gravity_z")),
        percent("inertia_error"),
        tables.number(median(found, "inertia_z")),
        percent("held_out"),
    ]
    return [*numbers, verdicts]


def median(found: Sequence[dict[str, Any]], key: str) -> float:
    """Return the median of one number over the seeds."""
    values: Array = np.array([item[key] for item in found])
    return float(np.median(values))
