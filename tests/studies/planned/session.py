"""A whole planned session on the six-joint plant against the sample logs' motions, as long.

`plan all` with nothing known but the URDF; both sessions go through friction, gravity, imu-calib
and inertia, and predict validation motions of both kinds. Errors are of the predicted torque
against the plant's own torque, which holds no noise.
"""

from __future__ import annotations

from argparse import Namespace
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from seqid_cli.identify.options import InertiaOptions
from seqid_cli.logs.recording import Recording
from seqid_cli.params.schema import Stages
from seqid_cli.plan.limits import limits_of
from seqid_cli.plan.make import make_plan
from seqid_cli.plan.options import PlanOptions
from tests.plants.arms.rigs import six_joint
from tests.plants.motions.experiments import Trial
from tests.plants.planned import FOLDERS, reference_of
from tests.plants.robots.identified import held_out, sequential
from tests.plants.robots.lab import Experiment, recording_of, run, true_standard, true_value
from tests.plants.robots.sample import sample_robot
from tests.plants.samples import six_joint_recipe
from tests.plants.simulate import Plant
from tests.studies.tables import number, rms, table

OPTIONS = PlanOptions(duration_s=92.0, ramp_s=0.2)
EVERY = 4  # control periods per row: 250 Hz
ORDER = ("friction", "gravity", "imu", "inertia")


@dataclass(frozen=True)
class Session:
    """What a session lasted, s by stage, and what came of it."""

    seconds: Mapping[str, float]
    stages: Stages


def study(chosen: Namespace) -> str:
    """Duration and errors of both; there is no quick way to them."""
    del chosen
    plant = six_joint()
    trials = {"planned": planned_trials(plant), "sample motions": six_joint_recipe().trials}
    sessions = {name: session(plant, own) for name, own in trials.items()}
    validations = {name: truth_of(plant, own) for name, own in trials.items()}
    return "\n\n".join([durations(sessions), errors(plant, sessions, validations)])


def planned_trials(plant: Plant) -> list[Trial]:
    """The moves of `plan all`, as trials."""
    robot = sample_robot("six_joint")
    limits = limits_of(robot, ramp_s=OPTIONS.ramp_s)
    plan = make_plan("all", robot, limits, Stages(), OPTIONS)
    return [
        Trial(FOLDERS.get(m.stage, m.stage), m.name, reference_of(m, plant), imus=imus_of(m.stage))
        for m in plan.moves
    ]


def imus_of(stage: str) -> bool:
    """Whether the arrays are recorded, as in the sample logs."""
    return stage in ("imu-calib", "inertia", "validation")


def session(plant: Plant, trials: Sequence[Trial]) -> Session:
    """Record trials and identify all stages."""
    kept = [t for t in trials if t.stage in ORDER]
    experiment = run("six_joint", plant, kept, 1, every=EVERY)
    experiment = replace(experiment, robot=sample_robot("six_joint"))
    seconds = {
        stage: sum(t.reference.duration for t in kept if t.stage == stage) for stage in ORDER
    }
    return Session(seconds, sequential(experiment.recordings, experiment.robot))


def truth_of(plant: Plant, trials: Sequence[Trial]) -> list[Recording]:
    """Validation logs whose torque is the plant's own."""
    kept = [t for t in trials if t.stage == "validation"]
    found: Experiment = run("six_joint", plant, kept, 3, every=EVERY)
    logs = found.logs["validation"]
    drive = plant.torque_per_ampere
    exact = [replace(log, current=log.truth.tau / drive) for log in logs]
    return [recording_of(plant, t.name, log) for t, log in zip(kept, exact, strict=True)]


def durations(sessions: Mapping[str, Session]) -> str:
    """Seconds by stage, and the rank of the inertia stage."""
    rows = []
    for name, made in sessions.items():
        inertia = made.stages.inertia
        assert inertia is not None
        seconds = [f"{made.seconds[stage]:.0f}" for stage in ORDER]
        total = f"{sum(made.seconds.values()):.0f}"
        rows.append([name, *seconds, total, f"{inertia.rank} of {inertia.structural_rank}"])
    return table(["session, s", *ORDER, "all", "rank"], rows)


def errors(
    plant: Plant, sessions: Mapping[str, Session], validations: Mapping[str, Sequence[Recording]]
) -> str:
    """Errors of torque and parameters, and the ratios of both sessions."""
    robot, standard = sample_robot("six_joint"), true_standard(plant)
    rows, ratios = [], []
    for kind, logs in validations.items():
        found = [
            held_out(logs, robot, made.stages, InertiaOptions()).sliding
            for made in sessions.values()
        ]
        for joint, *pair in zip(robot.joint_names, *found, strict=True):
            label = f"torque of {joint}, {kind} validation, N m"
            rows.append([label, *(number(x, 3) for x in pair), number(pair[0] / pair[1])])
            ratios.append(pair[0] / pair[1])
    rows.append(["torque, RMS of the ratios", "", "", number(rms(ratios))])
    made = [parameter_errors(one.stages, standard) for one in sessions.values()]
    for label, pair in zip(("errors", "standard errors"), zip(*made, strict=True), strict=True):
        rows.append([f"parameters, mean of the {label}", "", "", number(pair[0] / pair[1])])
    return table(["error", *sessions, "ratio"], rows)


def parameter_errors(stages: Stages, standard: Mapping[str, float]) -> tuple[float, float]:
    """Geometric means of the errors and standard errors of gravity's and inertia's parameters."""
    assert stages.inertia is not None
    assert stages.gravity is not None
    parameters = [*stages.gravity.parameters, *stages.inertia.parameters]
    off = [abs(p.value - true_value(p.terms, standard)) for p in parameters]
    stated = [p.std_error for p in parameters]
    return float(np.exp(np.mean(np.log(off)))), float(np.exp(np.mean(np.log(stated))))
