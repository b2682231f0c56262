"""What is known of the recorded robots, asked for one by one: found or not, how surely."""

import time
from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass
from pathlib import Path

from seqid_cli.discover.diagnosis import diagnose
from seqid_cli.discover.options import DiscoverOptions
from seqid_cli.discover.survey.usable import usable_logs
from seqid_cli.errors import InputError
from seqid_cli.identify.options import InertiaOptions
from seqid_cli.identify.rigid.simultaneous import identify_simultaneous
from seqid_cli.logs.recording import Recording
from seqid_cli.motion.options import MotionOptions
from seqid_cli.params.results.diagnosis import DiagnosisFile, FindingEntry
from seqid_cli.params.schema import ClosedLoop, Stages
from seqid_cli.robot.types import Robot
from tests.studies.tables import number, table

HEADER = ("data set", "asked", "found (confidence)", "before", "after", "limit", "met", "CPU s")
LOAD = frozenset({"load_dependent_friction", "gear_efficiency"})
COUPLING = frozenset({"transmission_coupling"})
RIPPLE = frozenset({"torque_ripple"})
LINES = 0.025  # cycles per motor turn, that half a turn of a joint at ratio 101 tells apart
ECHOES = {"gravity_compensation", "pd_1nm_torque_limited_swingup_failure"}


@dataclass(frozen=True)
class Answer:
    """One row: what was asked, what came out; RMSE [N m] before and after, the CPU time [s]."""

    data: str
    asked: str
    found: str
    met: bool
    before: float = float("nan")
    after: float = float("nan")
    limit: float = float("nan")
    seconds: float = float("nan")

    def row(self) -> list[str]:
        """Cells of the table."""
        sizes = [number(x, 3) for x in (self.before, self.after, self.limit)]
        took = number(self.seconds) if self.seconds < 10 else f"{self.seconds:.0f}"
        seconds = took if self.seconds == self.seconds else "-"
        return [self.data, self.asked, self.found, *sizes, "yes" if self.met else "no", seconds]


@dataclass(frozen=True)
class Proved:
    """An arm that was diagnosed and refined: what was named, and errors on held-out logs."""

    name: str
    robot: Robot
    named: DiagnosisFile
    loop: ClosedLoop
    seconds: float

    def effect(self, asked: str, effects: Collection[str], joint: int, limit: float) -> Answer:
        """Whether one of the effects is named at a joint, and its held-out error within `limit`."""
        name = self.robot.joint_names[joint]
        there = [f for f in self.named.findings if f.effect in effects and f.joint == name]
        return self._judged(asked, there, joint, limit)

    def coupled(self, asked: str, pair: tuple[int, int], joint: int, limit: float) -> Answer:
        """The same of a coupling, which may be named at either of its joints."""
        names = {self.robot.joint_names[k] for k in pair}
        there = [f for f in self.named.findings if f.effect in COUPLING and f.joint in names]
        return self._judged(asked, there, joint, limit)

    def absent(self, asked: str, effects: Collection[str], joint: int) -> Answer:
        """Whether none of the effects is named or kept at a joint."""
        name = self.robot.joint_names[joint]
        there = [f for f in self.named.findings if f.effect in effects and f.joint == name]
        kept = [r for r in self.loop.rounds if r.accepted and r.effect in effects]
        met = not there and not any(r.joint == name for r in kept)
        return Answer(self.name, asked, _told(there), met, seconds=self.seconds)

    def _judged(
        self, asked: str, there: Sequence[FindingEntry], joint: int, limit: float
    ) -> Answer:
        name = self.robot.joint_names[joint]
        before, after = self.loop.before[name].rmse, self.loop.after[name].rmse
        met = bool(there) and after < before and not after > limit
        told = _told(there)
        return Answer(self.name, asked, told, met, before, after, limit, self.seconds)


def diagnosed(logs: Sequence[Recording], robot: Robot, most: int) -> DiagnosisFile:
    """What the classical fit of these logs lacks on them."""
    motion = MotionOptions()
    friction, inertia = identify_simultaneous(logs, robot, options=motion, offset=True)
    options = DiscoverOptions(InertiaOptions(motion), max_effects=most)
    return diagnose(logs, robot, Stages(friction=friction, inertia=inertia), options=options)


def ripple(
    data: str, logs: Sequence[Recording], robot: Robot, joint: int, order: float, *, there: bool
) -> Answer:
    """Whether a ripple of `order` is named at a joint, from a single log."""
    start = time.process_time()
    alone = len(robot.joint_names) == 1
    found = diagnosed(logs, robot, 4 if alone else 6)
    seconds = time.process_time() - start
    name = robot.joint_names[joint]
    near = [
        f
        for f in found.findings
        if f.effect in RIPPLE and f.joint == name and abs(f.settings["order"] - order) < _width(f)
    ]
    asked = f"ripple of order {order:g}" if there else f"no line of order {order:g}: none named"
    met = bool(near) == there
    if not alone:  # the lines lie above the cut-off, where the model is not judged
        return Answer(data, asked, _told(near), met, seconds=seconds)
    left = found.joints[name]
    sizes = (left.rmse, left.rmse_explained)
    return Answer(data, asked, _told(near), met, *sizes, seconds=seconds)


def _width(finding: FindingEntry) -> float:
    """Cycles per motor turn that count as the same line: of 72 per turn half of one."""
    return LINES if finding.settings["order"] < 10.0 else 0.5


def echoes(
    data: str, read: Callable[[Path], Recording], logs: Sequence[Path], robot: Robot
) -> Answer:
    """Whether just the logs whose torque echoes the command are refused."""
    start = time.process_time()
    refused = set()
    for path in logs:
        try:
            usable_logs([read(path)], robot)
        except InputError:
            refused.add(path.stem)
    told = f"refused: {', '.join(sorted(refused)) or 'none'} of {len(logs)}"
    took = time.process_time() - start
    return Answer(
        data, "logs with an echo refused, no others", told, refused == ECHOES, seconds=took
    )


def rendered(answers: Sequence[Answer]) -> str:
    """All answers in one table."""
    return table(HEADER, [answer.row() for answer in answers])


def _told(findings: Sequence[FindingEntry]) -> str:
    """Findings with their confidence; of ripples the order and the lag."""
    return "; ".join(f"{f.effect}{_at(f)} ({f.confidence:.2f})" for f in findings) or "-"


def _at(finding: FindingEntry) -> str:
    if finding.effect not in RIPPLE:
        return f" at {finding.joint}"
    lag = 1e3 * finding.settings["lag"]
    return f" of order {number(finding.settings['order'], 4)}" + (
        f", {lag:.0f} ms late" * (lag > 0)
    )
