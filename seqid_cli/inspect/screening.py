"""The checks of `seqid inspect` on a log that a stage reads, without its damaged samples.

A log that is held is checked as a whole. One that is passed over is looked through for damaged
positions block by block; torque and motion are compared with each other in some pieces of it, so
that memory does not grow with the log.
"""

from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import NamedTuple

import numpy as np

from seqid_cli.inspect.channels.positions import Break, breaks_of
from seqid_cli.inspect.checks import check, without
from seqid_cli.inspect.findings import located
from seqid_cli.inspect.material import log_data
from seqid_cli.logs.clocks import GAP_INTERVALS, GAP_LEAST_S
from seqid_cli.logs.long import READERS, Block, Bridge
from seqid_cli.logs.raw import RawLog, Stream, TimeSource
from seqid_cli.logs.read import read_both
from seqid_cli.logs.recording import Health, Recording
from seqid_cli.motion.blocks import SurveyedLog
from seqid_cli.params.results.inspection import InspectionFinding
from seqid_cli.robot.types import Array, Robot

Findings = tuple[InspectionFinding, ...]


class Screened(NamedTuple):
    """A log without its damaged samples, and the findings."""

    recording: Recording
    findings: Findings


def screened(recording: Recording, raw: RawLog, robot: Robot, *, imus: bool) -> Screened:
    """Check a log that is held.

    `recording`, `raw`: the log as `read_both` gives it. `imus`: whether its IMUs are used, and
    hence checked.
    """
    checked = check(log_data(recording, raw, robot, modelled=True), imus=imus, quality=False)
    return Screened(checked.data.recording, located(checked.findings, recording.path))


def sound(recording: Recording, raw: RawLog, robot: Robot) -> Recording:
    """Return a log, or a piece of one, without its damaged samples; see `screened`."""
    data = log_data(recording, raw, robot, modelled=True)
    return without(data, breaks_of(robot, data.t, data.joints.channels["position"])).recording


def read_screened(
    path: Path, robot: Robot, *, time_source: TimeSource = "header", imus: bool = True
) -> Screened:
    """Read and check a log; see `read_recording` and `screened`.

    Raises InputError: the file cannot be read, lacks a channel or is too short.
    """
    recording, raw = read_both(path, robot, time_source=time_source)
    return screened(recording, raw, robot, imus=imus)


def screened_long(log: SurveyedLog, robot: Robot) -> tuple[SurveyedLog, Findings]:
    """Check a log that is passed over; see `screened`."""
    first = next(iter(READERS[log.format](log.file, replace(robot, imus=()), log.time_source)))
    look = _Look(log, robot)
    for block in log.blocks():
        look.push(block)
    sound = replace(log, bridges=tuple(look.bridges))
    findings = list(look.findings)
    warnings = log.warnings
    for piece in look.pieces():
        for bridge in sound.bridges:
            bridge.laid(piece)
        data = log_data(*_held(piece, log, first, warnings), robot, modelled=True)
        findings += check(data, imus=False, quality=False).findings
        warnings = ()  # they are the log's, and said once
    unique = {(f.code, f.joint, f.channel): f for f in reversed(findings)}
    return sound, located([*unique.values()][::-1], log.path)


@dataclass
class _Look:
    """Takes the blocks of a log: finds breaks, bridges their samples, and keeps some pieces."""

    log: SurveyedLog
    robot: Robot
    findings: list[InspectionFinding] = field(default_factory=list)
    bridges: list[Bridge] = field(default_factory=list)
    _kept: dict[int, list[Block]] = field(default_factory=dict)
    _tail: Array | None = None  # of the positions before the next block

    def push(self, block: Block, *, overlap_s: float = 1.0) -> None:
        """Take the next block."""
        self._keep(block)
        overlap = max(16, int(overlap_s * self.log.rate_hz))
        wide = block.q if self._tail is None else np.concatenate([self._tail, block.q])
        start = block.start + len(block.q) - len(wide)
        t = np.asarray((start + np.arange(len(wide))) * self.log.step_s, dtype=np.float64)
        known = {finding.joint for finding in self.findings}
        for each in breaks_of(self.robot, t, wide):
            if len(each.rows) or each.finding.joint not in known:
                self.findings.append(each.finding)
                self.bridges += self._bridged(each, wide, start)
        self._tail = wide[-overlap:].copy()

    def _bridged(self, damage: Break, q: Array, first: int) -> Iterator[Bridge]:
        """Bridge damaged samples, runs of them together; `first` is the number of q's first."""
        most = max(GAP_INTERVALS, GAP_LEAST_S * self.log.rate_hz)
        rows = damage.rows
        for run in np.split(rows, np.flatnonzero(np.diff(rows) > 1) + 1) if len(rows) else ():
            start, stop = int(run[0]), int(run[-1]) + 1
            after = float(q[min(stop, len(q) - 1), damage.joint])
            before = float(q[start - 1, damage.joint]) if start else after
            known = stop - start < most
            yield Bridge(damage.joint, first + start, first + stop, before, after, known)

    def _keep(self, block: Block) -> None:
        for number, (low, high) in enumerate(self._ranges()):
            a, b = max(low, block.start), min(high, block.start + len(block.q))
            if a < b:
                part = slice(a - block.start, b - block.start)
                own = Block(a, block.q[part].copy(), block.tau[part].copy(), block.valid[part])
                self._kept.setdefault(number, []).append(own)

    def _ranges(self, *, pieces: int = 8, piece_s: float = 20.0) -> list[tuple[int, int]]:
        size = min(self.log.samples, max(64, int(piece_s * self.log.rate_hz)))
        starts = np.linspace(0, self.log.samples - size, pieces).astype(int)
        return [(int(start), int(start) + size) for start in starts]

    def pieces(self) -> Iterator[Block]:
        """Yield the pieces that were kept."""
        for parts in self._kept.values():
            arrays = [np.concatenate([getattr(p, k) for p in parts]) for k in ("q", "tau", "valid")]
            yield Block(parts[0].start, *arrays)


def _held(
    piece: Block, log: SurveyedLog, first: RawLog, warnings: tuple[str, ...]
) -> tuple[Recording, RawLog]:
    """Make a recording of a piece, and the raw log of it."""
    rows = piece.start + np.arange(len(piece.q))
    stamps = log.start_ns + np.rint(rows * log.step_s * 1e9).astype(np.int64)
    recording = Recording(
        path=log.path,
        sha256="",
        format=log.format,
        t=(rows - rows[0]) * log.step_s,
        q=piece.q,
        valid=piece.valid,
        health=Health(log.rate_hz, log.jitter, warnings=warnings),
        tau=piece.tau,
        start=float(stamps[0]) * 1e-9,
        partial=log.partial,
    )
    logged = first.joints.channels
    factor = [joint.torque_per_ampere or np.nan for joint in log.robot.joints]
    currents = "current" in logged and (first.prefer_current or "torque" not in logged)
    effort = {"current": piece.tau / np.array(factor)} if currents else {"torque": piece.tau}
    joints = Stream("joints", stamps, {"position": piece.q, **effort})
    return recording, RawLog(joints, prefer_current=first.prefer_current)
