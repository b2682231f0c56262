"""Recorded robots: what is asked of them, what is added to the classical fit, held-out errors."""

import time
from argparse import Namespace
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path

from seqid_cli.discover.diagnosis import diagnose
from seqid_cli.discover.options import DiscoverOptions
from seqid_cli.discover.refinement.confirm import confirm
from seqid_cli.discover.refinement.rounds import refine
from seqid_cli.discover.survey.usable import usable_logs
from seqid_cli.errors import InputError
from seqid_cli.identify.options import InertiaOptions
from seqid_cli.identify.rigid.simultaneous import identify_simultaneous
from seqid_cli.logs.read import read_recording
from seqid_cli.logs.recording import Recording
from seqid_cli.motion.options import MotionOptions
from seqid_cli.params.results.diagnosis import DiagnosisFile, FindingEntry
from seqid_cli.params.schema import ClosedLoop, EffectOfJoint, Stages
from seqid_cli.robot.file import load_robot
from seqid_cli.robot.types import Robot
from tests.studies.recorded.classical import CASES, DATA, Case, missing
from tests.studies.tables import number, table
from tests.studies.undeclared.refine import file_of

HEADER = ("data set", "asked", "found (confidence)", "before", "after", "limit", "met", "CPU s")
LOAD = frozenset({"load_dependent_friction", "gear_efficiency"})
COUPLING = frozenset({"transmission_coupling"})
RIPPLE = frozenset({"torque_ripple"})
LINES = 0.025  # cycles per motor turn, that half a turn of a joint at ratio 101 tells apart
ECHOES = {"gravity_compensation", "pd_1nm_torque_limited_swingup_failure"}
NAN = float("nan")


def row(
    data: str,
    asked: str,
    found: str,
    met: bool,
    seconds: float,
    before: float = NAN,
    after: float = NAN,
    limit: float = NAN,
) -> list[str]:
    """Cells of an answer: what was asked, what came out, RMSE [N m], CPU time [s]."""
    sizes = [number(x, 3) for x in (before, after, limit)]
    took = number(seconds) if seconds < 10 else f"{seconds:.0f}"
    return [data, asked, found, *sizes, "yes" if met else "no", took]


@dataclass(frozen=True)
class Asked:
    """A question about an arm: is one of the effects named at one of the joints (from 0)?"""

    text: str
    effects: frozenset[str]
    joints: tuple[int, ...]
    limit: float = NAN
    there: bool = True


@dataclass(frozen=True)
class Closed:
    """An arm that was diagnosed and refined: what was named and added, held-out errors, CPU s."""

    name: str
    robot: Robot
    named: DiagnosisFile
    effects: Sequence[EffectOfJoint]
    loop: ClosedLoop
    diagnosed_s: float
    refined_s: float

    def answer(self, asked: Asked) -> list[str]:
        names = [self.robot.joint_names[joint] for joint in asked.joints]
        found = [f for f in self.named.findings if f.effect in asked.effects and f.joint in names]
        given = (self.name, asked.text, _told(found))
        seconds = self.diagnosed_s + self.refined_s
        if not asked.there:
            kept = [r for r in self.loop.rounds if r.accepted and r.effect in asked.effects]
            met = not found and not any(r.joint in names for r in kept)
            return row(*given, met, seconds)
        before, after = (errors[names[0]].rmse for errors in (self.loop.before, self.loop.after))
        met = bool(found) and after < before and not after > asked.limit
        return row(*given, met, seconds, before, after, asked.limit)


def diagnosed(logs: Sequence[Recording], robot: Robot, most: int) -> DiagnosisFile:
    motion = MotionOptions()
    friction, inertia = identify_simultaneous(logs, robot, options=motion, offset=True)
    options = DiscoverOptions(InertiaOptions(motion), max_effects=most)
    return diagnose(logs, robot, Stages(friction=friction, inertia=inertia), options=options)


def ripple(
    data: str, log: Recording, robot: Robot, joint: int, order: float, *, there: bool
) -> list[str]:
    """Whether a ripple of `order` is named at a joint, from a single log."""
    start = time.process_time()
    alone, name = robot.n == 1, robot.joint_names[joint]
    found = diagnosed([log], robot, 4 if alone else 6)
    seconds = time.process_time() - start
    lines = [f for f in found.findings if f.effect in RIPPLE and f.joint == name]
    near = [f for f in lines if abs(f.settings["order"] - order) < _width(f)]
    asked = f"ripple of order {order:g}" if there else f"no line of order {order:g}: none named"
    left = found.joints[name]
    # The lines of several joints lie above the cut-off, where the model is not judged.
    sizes = (left.rmse, left.rmse_explained) if alone else ()
    return row(data, asked, _told(near), bool(near) == there, seconds, *sizes)


def _width(finding: FindingEntry) -> float:
    """Cycles per motor turn that count as the same line: of 72 per turn half of one."""
    return LINES if finding.settings["order"] < 10.0 else 0.5


def echoes(
    data: str, read: Callable[[Path], Recording], logs: Sequence[Path], robot: Robot
) -> list[str]:
    """Whether just the logs whose torque echoes the command are refused."""
    start, refused = time.process_time(), set()
    for path in logs:
        try:
            usable_logs([read(path)], robot)
        except InputError:
            refused.add(path.stem)
    told = f"refused: {', '.join(sorted(refused)) or 'none'} of {len(logs)}"
    took, asked = time.process_time() - start, "logs with an echo refused, no others"
    return row(data, asked, told, refused == ECHOES, took)


def _told(findings: Sequence[FindingEntry]) -> str:
    """Findings with their confidence; of ripples the order and the lag."""
    return "; ".join(f"{f.effect}{_at(f)} ({f.confidence:.2f})" for f in findings) or "-"


def _at(finding: FindingEntry) -> str:
    if finding.effect not in RIPPLE:
        return f" at {finding.joint}"
    lag = 1e3 * finding.settings["lag"]
    late = f", {lag:.0f} ms late" if lag > 0 else ""
    return f" of order {number(finding.settings['order'], 4)}{late}"


MOST = 6  # effects, for six joints; every round costs a search of its own
LINE_AT = (1, 3, 4, 5, 6)  # joints of the UR10e with a line of order 2 in their torque's spectrum
ASKED = {
    "Staubli TX40": [
        Asked("coupled wrist, joint 5", COUPLING, (4, 5), 1.1),
        Asked("coupled wrist, joint 6", COUPLING, (5, 4), 1.2),
        Asked("load dependence, joint 3", LOAD, (2,)),
    ],
    "UR10e": [
        Asked("load-dependent friction, joint 2", LOAD, (1,), 2.7),
        Asked("load-dependent friction, joint 3", LOAD, (2,), 1.0),
        Asked("no load coefficient, joint 6", LOAD, (5,), there=False),
    ],
}
NOTE = (
    "RMSE in N m, of all samples of held-out logs; of the single log of the motor in A, on "
    "left-out stretches. Of ripples, which lie mostly above the low-pass, the share of a "
    "joint's squared residual that they take away there. The limits are what a fit outside "
    "this project, with its own low-pass, reached. Which joints have a line of order 2 is from "
    "the spectrum of the measured torque over the motor's angle, without any model."
)


def study(chosen: Namespace | None = None, data: Path = DATA) -> str:
    del chosen
    answers: list[list[str]] = []
    parts: list[str] = []
    for case in CASES:
        said = missing(case, data / case.folder)
        if not said:
            found = closed(case, data / case.folder)
            answers += [found.answer(asked) for asked in ASKED[case.name]]
        parts.append(said or rendered(found))
    answers += _single(data)
    return "\n\n".join([table(HEADER, answers), NOTE, *parts])


def _single(data: Path) -> list[list[str]]:
    """Joint-by-joint trials, the cogging motor, the pendulum: as far as they are there."""
    ur10e, laas = data / "ur10e_innopolis", data / "laas_cogging"
    asked = [
        (f"jointwise__ur-20_01_22-joint_{k + 1}", f"UR10e, trial of joint {k + 1}", k, 2.0)
        for k in range(6)
    ]
    trials = [(ur10e / f"{stem}.parquet", *rest) for stem, *rest in asked]
    trials.append((laas / "stopped_data.parquet", "LAAS motor, holding", 0, 72.0))
    answers: list[list[str]] = []
    for path, name, k, order in trials:
        if path.is_file():
            robot = load_robot(path.parent / "robot.toml")
            there = path.parent == laas or k + 1 in LINE_AT
            log = read_recording(path, robot)
            answers.append(ripple(name, log, robot, k, order, there=there))
    folder = data / "dfki_simple_pendulum"
    if logs := sorted(folder.glob("*.parquet")):
        robot = load_robot(folder / "robot.toml")
        answers.append(echoes("DFKI pendulum", partial(read_recording, robot=robot), logs, robot))
    return answers


def closed(case: Case, folder: Path) -> Closed:
    """Fit the training logs, refine with them, look at the held-out ones."""
    robot = load_robot(folder / "robot.toml")
    train, rest = (
        [read_recording(folder / name, robot) for name in names]
        for names in (case.train, case.held_out)
    )
    friction, inertia = identify_simultaneous(train, robot, options=MotionOptions(), offset=True)
    earlier = {"friction": train}
    file = file_of(robot, Stages(friction=friction, inertia=inertia), earlier)
    start = time.process_time()
    named = diagnosed(train, robot, MOST)
    between = time.process_time()
    options = DiscoverOptions(max_effects=MOST)
    decided = refine(train, robot, file, earlier=earlier, options=options)
    loop = confirm(decided, rest)
    took = between - start, time.process_time() - between
    return Closed(case.name, robot, named, decided.stages.effects or [], loop, *took)


def rendered(found: Closed) -> str:
    loop, rows = found.loop, []
    for k, joint in enumerate(found.robot.joint_names):
        before, after = loop.before[joint].rmse, loop.after[joint].rmse
        gain = "-"
        if joint in loop.gain_interval:
            low, high = loop.gain_interval[joint]
            share = 1.0 - (after / max(before, 1e-300)) ** 2
            gain = f"{100 * share:.0f} ({100 * low:.0f} to {100 * high:.0f})"
        sizes = [number(before, 3), number(after, 3), gain, number(loop.noise_floor[joint], 3)]
        rows.append([str(k + 1), _named(found, joint) or "-", *sizes])
    header = [f"{found.name}, joint", "added", "before", "after", "gain, %", "noise floor"]
    lines = [table(header, rows), ""]
    lines.append("Held-out RMSE, N m; gain in mean square with its 95 % interval.")
    if whole := _named(found, None):
        lines.append(f"Of the whole arm: {whole}.")
    if refused := [f"{r.effect} at {r.joint or 'the whole arm'}" for r in loop.refused]:
        lines.append(f"Refused: {', '.join(refused)}.")
    lines.append(f"CPU time of refine {found.refined_s:.0f} s.")
    return "\n".join(lines)


def _named(found: Closed, joint: str | None) -> str:
    """Effects at a joint with their parameters and standard errors."""

    def said(entry: EffectOfJoint) -> str:
        values = [
            f"{p.name} {number(p.value)} +- {number(p.std_error)} {p.unit}"
            for p in entry.parameters
        ]
        return f"{entry.effect} ({', '.join(values)})"

    return "; ".join(said(entry) for entry in found.effects if entry.joint == joint)
