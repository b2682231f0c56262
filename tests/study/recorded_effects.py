"""Recorded robots: what is added to the classical fit, and the error on logs that it never saw."""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from seqid_cli.discover.options import DiscoverOptions
from seqid_cli.discover.refine import refine
from seqid_cli.discover.results import ClosedLoop, Round
from seqid_cli.identify.simultaneous import identify_simultaneous
from seqid_cli.logs.read import read_recordings
from seqid_cli.logs.recording import Recording
from seqid_cli.motion.options import MotionOptions
from seqid_cli.params.document import robot_id, with_stage
from seqid_cli.params.schema import EffectOfJoint, InputLog, ParameterFile, Stages
from seqid_cli.robot.file import load_robot
from seqid_cli.robot.types import Robot
from tests.study.recorded import CASES, DATA, Case
from tests.study.tables import number, table

DOCUMENT = Path(__file__).parents[2] / "docs" / "effects_study.md"
MOST = 6  # effects, for six joints; every round costs a search of its own


@dataclass(frozen=True)
class Closed:
    """One robot: its joints, the refined stages, errors before and after, CPU time."""

    case: Case
    robot: Robot
    stages: Stages
    loop: ClosedLoop
    seconds: float


def study(data: Path = DATA) -> str:
    """One table per robot; a robot whose logs are not there is named and left out."""
    return "\n\n".join(_part(case, data / case.folder) for case in CASES)


def _part(case: Case, folder: Path) -> str:
    missing = [n for n in (*case.train, *case.held_out) if not (folder / n).is_file()]
    if missing:
        return f"{case.name}: left out, its logs are not beside the project."
    return rendered(closed(case, folder))


def closed(case: Case, folder: Path, most: int = MOST) -> Closed:
    """Fit the training logs, refine with them, judge by the held-out ones."""
    robot = load_robot(folder / "robot.toml")
    train = list(read_recordings([folder / name for name in case.train], robot))
    rest = list(read_recordings([folder / name for name in case.held_out], robot))
    file = fitted(train, robot)
    start = time.process_time()
    options = DiscoverOptions(max_effects=most)
    stages, loop = refine(train, rest, robot, file, earlier={"friction": train}, options=options)
    return Closed(case, robot, stages, loop, time.process_time() - start)


def fitted(logs: Sequence[Recording], robot: Robot) -> ParameterFile:
    """The file of rigid body, Coulomb, viscous friction and offset in one least squares."""
    friction, inertia = identify_simultaneous(logs, robot, options=MotionOptions(), offset=True)
    inputs = [
        InputLog(path=str(r.path), sha256=r.sha256, samples=len(r.t), stage="friction")
        for r in logs
    ]
    return with_stage(None, robot_id(robot), inputs, friction=friction, inertia=inertia)


def rendered(found: Closed) -> str:
    """Table of one robot, and what was refused."""
    header = [f"{found.case.name}, joint", "added", "before", "after", "gain, %", "noise floor"]
    loop = found.loop
    entries = found.stages.effects or []
    rows = [
        [
            str(k + 1),
            "; ".join(_named(e) for e in entries if e.joint == joint) or "-",
            number(loop.before[joint], 3),
            number(loop.after[joint], 3),
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
    refused = [_tried(r) for r in loop.rounds if not r.accepted]
    if refused:
        lines.append(f"Refused by the held-out logs: {', '.join(refused)}.")
    lines.append(f"CPU time {found.seconds:.0f} s.")
    return "\n".join(lines)


def _named(entry: EffectOfJoint) -> str:
    """Effect with its parameters and their standard errors."""
    values = [
        f"{p.name} {number(p.value)} +- {number(p.std_error)} {p.unit}" for p in entry.parameters
    ]
    return f"{entry.effect} ({', '.join(values)})"


def _gain(loop: ClosedLoop, joint: str) -> str:
    low, high = loop.gain_interval[joint]
    gain = 1.0 - (loop.after[joint] / max(loop.before[joint], 1e-300)) ** 2
    return f"{100 * gain:.0f} ({100 * low:.0f} to {100 * high:.0f})"


def _tried(tried: Round) -> str:
    return f"{tried.effect} at {tried.joint or 'the whole arm'}"
