"""Recorded robots: the classical fit, what is asked of them, what is added, held-out
errors.
"""

import time
from argparse import Namespace
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from seqid_cli.discover.diagnosis import diagnose
from seqid_cli.discover.options import DiscoverOptions
from seqid_cli.discover.refinement.confirm import confirm
from seqid_cli.discover.refinement.rounds import refine
from seqid_cli.discover.scenes import usable_logs
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
from tests import ROOT
from tests.plants.robots.identified import HeldOut, held_out, simultaneous
from tests.studies.tables import number, table
from tests.studies.undeclared.refine import file_of

DATA = ROOT / ".." / "shared" / "data"


@dataclass(frozen=True)
class Case:
    """One robot: its folder, what to fit, what to predict, and the published fit's RMSE
    (N m).
    """

    name: str
    folder: Path
    train: tuple[str, ...]
    held_out: tuple[str, ...]
    baseline: tuple[float, ...]
    baseline_cutoff_hz: float

    def logs(self) -> tuple[Robot, list[Recording], list[Recording]]:
        robot = load_robot(self.folder / "robot.toml")
        train, rest = (
            [read_recording(path, robot) for path in part] for part in self._paths
        )
        return robot, train, rest

    @property
    def _paths(self) -> list[list[Path]]:
        parts = (self.train, self.held_out)
        return [[self.folder / f"{name}.parquet" for name in part] for part in parts]

    @property
    def missing(self) -> str:
        there = all(path.is_file() for part in self._paths for path in part)
        return (
            ""
            if there
            else f"{self.name}: left out, its logs are not beside the project."
        )


UR10E = DATA / "ur10e_innopolis"
STAUBLI_RMSE, UR10E_RMSE = (
    (1.88, 4.28, 1.07, 0.62, 5.27, 2.20),
    (2.58, 3.77, 1.18, 0.39, 0.81, 0.63),
)
NAMES = ("12-50sec_12harm", "12-40sec_12harm", "10-30sec_12harm", "19_15harm50sec")
TRIALS = tuple(f"identification__ur-20_02_{name}" for name in NAMES)
CASES = (
    Case(
        "Staubli TX40",
        DATA / "staubli_tx40",
        ("train",),
        ("holdout",),
        STAUBLI_RMSE,
        40.0,
    ),
    Case("UR10e", UR10E, TRIALS[:3], TRIALS[3:], UR10E_RMSE, 5.0),
)


def classical(chosen: Namespace) -> str:
    """The classical fit on one part of the logs, its prediction of the rest, a table
    per robot.
    """
    return "\n\n".join(case.missing or _classical(case) for case in CASES)


def predicted(case: Case, cutoff_hz: float | None = None) -> HeldOut:
    """Fit the training logs, predict the held-out ones; the cut-off is chosen if not
    given.
    """
    robot, train, rest = case.logs()
    stages = simultaneous(train, robot, cutoff_hz=cutoff_hz)
    return held_out(
        rest, robot, stages, InertiaOptions(motion=MotionOptions(cutoff_hz=cutoff_hz))
    )


def _classical(case: Case) -> str:
    same, found = predicted(case, case.baseline_cutoff_hz), predicted(case)
    theirs = f"{case.baseline_cutoff_hz:g} Hz"
    sizes = {
        f"fit to compare with, {theirs}": case.baseline,
        "all samples": found.every,
        f"all samples, {theirs}": same.every,
        "sliding samples": found.sliding,
    }
    rows = [
        [name, *(number(float(x), 3) for x in values)] for name, values in sizes.items()
    ]
    rows.append(
        ["share sliding, %", *(f"{100 * float(x):.0f}" for x in found.sliding_share)]
    )
    joints = [f"joint {k + 1}" for k in range(len(case.baseline))]
    cutoffs = ", ".join(f"{hz:.1f}" for hz in found.cutoff_hz)
    note = f"{case.name}: cut-off chosen for the held-out log {cutoffs} Hz."
    return f"{table([f'{case.name}, held-out RMSE, N m', *joints], rows)}\n\n{note}"


HEADER = (
    "data set",
    "asked",
    "found (confidence)",
    "before",
    "after",
    "limit",
    "met",
    "CPU s",
)
LOAD = frozenset({"load_dependent_friction", "gear_efficiency"})
COUPLING = frozenset({"transmission_coupling"})
RIPPLE = frozenset({"torque_ripple"})
# cycles per motor turn, that half a turn of a joint at ratio 101 tells apart
LINES = 0.025
ECHOES = {"gravity_compensation", "pd_1nm_torque_limited_swingup_failure"}
NAN = float("nan")


def row(
    *said: str, met: bool, seconds: float, sizes: Sequence[float] = ()
) -> list[str]:
    """Data, asked, found, RMSE [N m] before and after, its limit, whether that is met,
    CPU time.
    """
    cells = [number(x, 3) for x in (*sizes, NAN, NAN, NAN)[:3]]
    took = number(seconds) if seconds < 10 else f"{seconds:.0f}"
    return [*said, *cells, "yes" if met else "no", took]


@dataclass(frozen=True)
class Asked:
    """Is one of the effects named at one of the joints (from 0)?"""

    text: str
    effects: frozenset[str]
    joints: tuple[int, ...]
    limit: float = NAN  # N m, of the held-out error of the first of the joints
    there: bool = True  # where not, none is to be named or kept


@dataclass(frozen=True)
class Closed:
    """An arm that was diagnosed and refined: what was named and added, held-out errors,
    CPU s.
    """

    name: str
    robot: Robot
    named: DiagnosisFile
    effects: Sequence[EffectOfJoint]
    loop: ClosedLoop
    diagnosed_s: float
    refined_s: float

    def answer(self, asked: Asked) -> list[str]:
        names, sizes = [self.robot.joint_names[joint] for joint in asked.joints], ()
        found, kept = (
            [x for x in every if x.effect in asked.effects and x.joint in names]
            for every in (
                self.named.findings,
                [r for r in self.loop.rounds if r.accepted],
            )
        )
        if asked.there:
            before, after = (
                x[names[0]].rmse for x in (self.loop.before, self.loop.after)
            )
            sizes = (before, after, asked.limit)
            met = bool(found) and after < before and not after > asked.limit
        else:
            met = not found and not kept
        seconds = self.diagnosed_s + self.refined_s
        return row(
            self.name, asked.text, _told(found), met=met, seconds=seconds, sizes=sizes
        )


def diagnosed(logs: Sequence[Recording], robot: Robot, most: int) -> DiagnosisFile:
    motion = MotionOptions()
    friction, inertia = identify_simultaneous(logs, robot, options=motion, offset=True)
    options = DiscoverOptions(InertiaOptions(motion=motion), max_effects=most)
    return diagnose(
        logs, robot, Stages(friction=friction, inertia=inertia), options=options
    )


def ripple(
    data: str, path: Path, joint: int, order: float, *, there: bool
) -> list[str]:
    """Whether a ripple of `order` is named at a joint, from a single log."""
    robot = load_robot(path.parent / "robot.toml")
    log, start = read_recording(path, robot), time.process_time()
    alone, name = robot.n == 1, robot.joint_names[joint]
    found = diagnosed([log], robot, 4 if alone else 6)
    seconds = time.process_time() - start
    here = [f for f in found.findings if f.effect in RIPPLE and f.joint == name]
    lines = [(f, f.settings["order"]) for f in here]
    # Of 72 cycles per turn half of one counts as the same line.
    near = [f for f, at in lines if abs(at - order) < (LINES if at < 10.0 else 0.5)]
    asked = (
        f"ripple of order {order:g}"
        if there
        else f"no line of order {order:g}: none named"
    )
    left = found.joints[name]
    # The lines of several joints lie above the cut-off, where the model is not judged.
    sizes = (left.rmse, left.rmse_explained) if alone else ()
    met = bool(near) == there
    return row(data, asked, _told(near), met=met, seconds=seconds, sizes=sizes)


def echoes(data: str, logs: Sequence[Path], robot: Robot) -> list[str]:
    """Whether just the logs whose torque echoes the command are refused."""
    start, refused = time.process_time(), set()
    for path in logs:
        try:
            usable_logs([read_recording(path, robot)], robot)
        except InputError:
            refused.add(path.stem)
    told = f"refused: {', '.join(sorted(refused)) or 'none'} of {len(logs)}"
    took, asked = time.process_time() - start, "logs with an echo refused, no others"
    return row(data, asked, told, met=refused == ECHOES, seconds=took)


def _told(findings: Sequence[FindingEntry]) -> str:
    """Findings with their confidence; of ripples the order and the lag."""
    said = []
    for f in findings:
        at = f"at {f.joint}"
        if f.effect in RIPPLE:
            lag = 1e3 * f.settings["lag"]
            late = f", {lag:.0f} ms late" if lag > 0 else ""
            at = f"of order {number(f.settings['order'], 4)}{late}"
        said.append(f"{f.effect} {at} ({f.confidence:.2f})")
    return "; ".join(said) or "-"


MOST = 6  # effects, for six joints; every round costs a search of its own
# joints of the UR10e with a line of order 2 in their torque's spectrum
LINE_AT = (1, 3, 4, 5, 6)
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
    "RMSE in N m, of all samples of held-out logs; of the single log of the motor in A,"
    " on left-out stretches. Of ripples, which lie mostly above the low-pass, the share"
    " of a joint's squared residual that they take away there. The limits are what a"
    " fit outside this project, with its own low-pass, reached. Which joints have a"
    " line of order 2 is from the spectrum of the measured torque over the motor's"
    " angle, without any model."
)


def effects(chosen: Namespace) -> str:
    """What was asked and what came out,
    then one table per robot whose logs are there.
    """
    found = {case.name: closed(case) for case in CASES if not case.missing}
    answers = [
        one.answer(asked) for name, one in found.items() for asked in ASKED[name]
    ]
    parts = [case.missing or rendered(found[case.name]) for case in CASES]
    for k in range(1, 7):
        path = UR10E / f"jointwise__ur-20_01_22-joint_{k}.parquet"
        if path.is_file():
            there = k in LINE_AT
            answers.append(
                ripple(f"UR10e, trial of joint {k}", path, k - 1, 2.0, there=there)
            )
    motor = DATA / "laas_cogging" / "stopped_data.parquet"
    if motor.is_file():
        answers.append(ripple("LAAS motor, holding", motor, 0, 72.0, there=True))
    folder = DATA / "dfki_simple_pendulum"
    if logs := sorted(folder.glob("*.parquet")):
        answers.append(echoes("DFKI pendulum", logs, load_robot(folder / "robot.toml")))
    return "\n\n".join([table(HEADER, answers), NOTE, *parts])


def closed(case: Case) -> Closed:
    robot, train, rest = case.logs()
    friction, inertia = identify_simultaneous(
        train, robot, options=MotionOptions(), offset=True
    )
    earlier = {"friction": train}
    file = file_of(robot, Stages(friction=friction, inertia=inertia), earlier)
    start = time.process_time()
    named = diagnosed(train, robot, MOST)
    between = time.process_time()
    options = DiscoverOptions(max_effects=MOST)
    decided = refine(train, robot, file, earlier=earlier, options=options)
    done = confirm(decided, rest)
    took = between - start, time.process_time() - between
    return Closed(case.name, robot, named, done.stages.effects or [], done.loop, *took)


def rendered(found: Closed) -> str:
    """Table of one robot, and what was refused."""
    loop, rows = found.loop, []
    for k, joint in enumerate(found.robot.joint_names):
        before, after = loop.before[joint].rmse, loop.after[joint].rmse
        gain = "-"
        if joint in loop.gain_interval:
            low, high = loop.gain_interval[joint]
            share = 1.0 - (after / max(before, 1e-300)) ** 2
            gain = f"{100 * share:.0f} ({100 * low:.0f} to {100 * high:.0f})"
        sizes = [
            number(before, 3),
            number(after, 3),
            gain,
            number(loop.noise_floor[joint], 3),
        ]
        rows.append([str(k + 1), _named(found, joint) or "-", *sizes])
    header = [
        f"{found.name}, joint",
        "added",
        "before",
        "after",
        "gain, %",
        "noise floor",
    ]
    note = "Held-out RMSE, N m; gain in mean square with its 95 % interval."
    lines = [table(header, rows), "", note]
    if whole := _named(found, None):
        lines.append(f"Of the whole arm: {whole}.")
    if gone := [
        f"{r.effect} at {r.joint or 'the whole arm'}" for r in loop.unconfirmed
    ]:
        lines.append(f"Not confirmed, and taken out: {', '.join(gone)}.")
    if refused := [f"{r.effect} at {r.joint or 'the whole arm'}" for r in loop.refused]:
        lines.append(f"Refused: {', '.join(refused)}.")
    lines.append(f"CPU time of refine {found.refined_s:.0f} s.")
    return "\n".join(lines)


def _named(found: Closed, joint: str | None) -> str:
    """Effects at a joint with their parameters and standard errors."""
    said = []
    for entry in (entry for entry in found.effects if entry.joint == joint):
        values = [
            f"{p.name} {number(p.value)} +- {number(p.std_error)} {p.unit}"
            for p in entry.parameters
        ]
        said.append(f"{entry.effect} ({', '.join(values)})")
    return "; ".join(said)
