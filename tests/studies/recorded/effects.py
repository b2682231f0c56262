"""Recorded robots: what is added to the classical fit, and the error on logs that it never saw."""

import time
from argparse import Namespace
from dataclasses import dataclass
from pathlib import Path

from seqid_cli.discover.options import DiscoverOptions
from seqid_cli.discover.refinement.confirm import confirm
from seqid_cli.discover.refinement.rounds import refine
from seqid_cli.identify.rigid.simultaneous import identify_simultaneous
from seqid_cli.logs.read import read_recording
from seqid_cli.motion.options import MotionOptions
from seqid_cli.params.document import robot_id, with_stage
from seqid_cli.params.results.diagnosis import DiagnosisFile
from seqid_cli.params.schema import (
    ClosedLoop,
    EffectOfJoint,
    InputLog,
    RefinementRound,
    Stages,
)
from seqid_cli.robot.file import load_robot
from seqid_cli.robot.types import Robot
from tests.studies.recorded.asked import LOAD, Answer, Proved, diagnosed, echoes, ripple
from tests.studies.recorded.asked import rendered as answered
from tests.studies.recorded.classical import CASES, DATA, Case
from tests.studies.tables import number, table

MOST = 6  # effects, for six joints; every round costs a search of its own


LINE_AT = (1, 3, 4, 5, 6)  # joints of the UR10e with a line of order 2 in their torque's spectrum


@dataclass(frozen=True)
class Closed:
    """One robot: its joints, the diagnosis, the refined stages, errors before and after, CPU time.

    `seconds` are those of the refinement, `diagnosis_seconds` those of the diagnosis.
    """

    case: Case
    robot: Robot
    named: DiagnosisFile
    stages: Stages
    loop: ClosedLoop
    seconds: float
    diagnosis_seconds: float

    @property
    def proved(self) -> Proved:
        """What answers are taken from."""
        took = self.seconds + self.diagnosis_seconds
        return Proved(self.case.name, self.robot, self.named, self.loop, took)


def study(chosen: Namespace | None = None, data: Path = DATA) -> str:
    """What was asked and what came out, then one table per robot; there is no quick way to them.

    A robot whose logs are not there is named and left out.
    """
    del chosen
    answers: list[Answer] = []
    parts: list[str] = []
    for case, asked in zip(CASES, (_of_the_tx40, _of_the_ur10e), strict=True):
        folder = data / case.folder
        missing = [n for n in (*case.train, *case.held_out) if not (folder / n).is_file()]
        if missing:
            parts.append(f"{case.name}: left out, its logs are not beside the project.")
            continue
        found = closed(case, folder)
        answers += asked(found.proved)
        parts.append(rendered(found))
    answers += _single(data)
    note = (
        "RMSE in N m, of all samples of held-out logs; of the single log of the motor in A, on "
        "left-out stretches. Of ripples, which lie mostly above the low-pass, the share of a "
        "joint's squared residual that they take away there. The limits are what a fit outside "
        "this project, with its own low-pass, reached. Which joints have a line of order 2 is from "
        "the spectrum of the measured torque over the motor's angle, without any model."
    )
    return "\n\n".join([answered(answers), note, *parts])


def _of_the_tx40(found: Proved) -> list[Answer]:
    return [
        found.coupled("coupled wrist, joint 5", (4, 5), 4, 1.1),
        found.coupled("coupled wrist, joint 6", (4, 5), 5, 1.2),
        found.effect("load dependence, joint 3", LOAD, 2, float("nan")),
    ]


def _of_the_ur10e(found: Proved) -> list[Answer]:
    return [
        found.effect("load-dependent friction, joint 2", LOAD, 1, 2.7),
        found.effect("load-dependent friction, joint 3", LOAD, 2, 1.0),
        found.absent("no load coefficient, joint 6", LOAD, 5),
    ]


def _single(data: Path) -> list[Answer]:
    """Joint-by-joint trials, the cogging motor, the pendulum: as far as they are there."""
    answers: list[Answer] = []
    folder = data / "ur10e_innopolis"
    for k in range(6):
        trial = folder / f"jointwise__ur-20_01_22-joint_{k + 1}.parquet"
        if trial.is_file():
            robot = load_robot(folder / "robot.toml")
            there = k + 1 in LINE_AT
            name = f"UR10e, trial of joint {k + 1}"
            answers.append(ripple(name, [read_recording(trial, robot)], robot, k, 2.0, there=there))
    trial = data / "laas_cogging" / "stopped_data.parquet"
    if trial.is_file():
        robot = load_robot(trial.parent / "robot.toml")
        logs = [read_recording(trial, robot)]
        answers.append(ripple("LAAS motor, holding", logs, robot, 0, 72.0, there=True))
    folder = data / "dfki_simple_pendulum"
    logs_of_it = sorted(folder.glob("*.parquet"))
    if logs_of_it:
        robot = load_robot(folder / "robot.toml")
        answers.append(
            echoes("DFKI pendulum", lambda p: read_recording(p, robot), logs_of_it, robot)
        )
    return answers


def closed(case: Case, folder: Path) -> Closed:
    """Fit the training logs, refine with them, look at the held-out ones."""
    robot = load_robot(folder / "robot.toml")
    train = [read_recording(folder / name, robot) for name in case.train]
    rest = [read_recording(folder / name, robot) for name in case.held_out]
    friction, inertia = identify_simultaneous(train, robot, options=MotionOptions(), offset=True)
    inputs = [
        InputLog(path=str(r.path), sha256=r.sha256, samples=len(r.t), stage="friction")
        for r in train
    ]
    file = with_stage(None, robot_id(robot), inputs, friction=friction, inertia=inertia)
    start = time.process_time()
    named = diagnosed(train, robot, MOST)
    middle = time.process_time()
    options = DiscoverOptions(max_effects=MOST)
    decided = refine(train, robot, file, earlier={"friction": train}, options=options)
    stages, loop = decided.stages, confirm(decided, rest)
    took = time.process_time() - middle
    return Closed(case, robot, named, stages, loop, took, middle - start)


def rendered(found: Closed) -> str:
    """Table of one robot, and what was refused."""
    header = [f"{found.case.name}, joint", "added", "before", "after", "gain, %", "noise floor"]
    loop = found.loop
    entries = found.stages.effects or []
    rows = [
        [
            str(k + 1),
            "; ".join(_named(e) for e in entries if e.joint == joint) or "-",
            number(loop.before[joint].rmse, 3),
            number(loop.after[joint].rmse, 3),
            _gain(loop, joint),
            number(loop.noise_floor[joint], 3),
        ]
        for k, joint in enumerate(found.robot.joint_names)
    ]
    whole = [_named(e) for e in entries if e.joint is None]
    lines = [table(header, rows), ""]
    lines.append("Held-out RMSE, N m; gain in mean square with its 95 % interval.")
    if whole:
        lines.append(f"Of the whole arm: {'; '.join(whole)}.")
    refused = [_tried(r) for r in loop.refused]
    if refused:
        lines.append(f"Refused: {', '.join(refused)}.")
    lines.append(f"CPU time of refine {found.seconds:.0f} s.")
    return "\n".join(lines)


def _named(entry: EffectOfJoint) -> str:
    """Effect with its parameters and their standard errors."""
    values = [
        f"{p.name} {number(p.value)} +- {number(p.std_error)} {p.unit}" for p in entry.parameters
    ]
    return f"{entry.effect} ({', '.join(values)})"


def _gain(loop: ClosedLoop, joint: str) -> str:
    if joint not in loop.gain_interval:
        return "-"
    low, high = loop.gain_interval[joint]
    gain = 1.0 - (loop.after[joint].rmse / max(loop.before[joint].rmse, 1e-300)) ** 2
    return f"{100 * gain:.0f} ({100 * low:.0f} to {100 * high:.0f})"


def _tried(tried: RefinementRound) -> str:
    return f"{tried.effect} at {tried.joint or 'the whole arm'}"
