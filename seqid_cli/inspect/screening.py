"""The checks of `seqid inspect` on a log that a stage reads, without its damaged samples.

A log that is passed over is looked through for damaged positions block by block; torque
and motion are compared with each other in some pieces of it, so that memory does not
grow with the log.
"""

from collections.abc import Iterator
from copy import deepcopy
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

import numpy as np

from seqid_cli.inspect.channels.positions import Break, breaks_of
from seqid_cli.inspect.checks import check, without
from seqid_cli.inspect.findings import grouped, located
from seqid_cli.inspect.material import LogData
from seqid_cli.logs.long import READERS, Block, Bridge
from seqid_cli.logs.raw import GAP_INTERVALS, GAP_LEAST_S, RawLog, Stream, TimeSource
from seqid_cli.logs.read import read_both
from seqid_cli.logs.recording import Health, Recording
from seqid_cli.logs.tables.parquet import BLOCK_ROWS
from seqid_cli.motion.blocks import SurveyedLog, joined, overlapping
from seqid_cli.params.results.inspection import InspectionFinding
from seqid_cli.robot.types import Robot

Findings = tuple[InspectionFinding, ...]


class Screened(NamedTuple):
    """A log without its damaged samples, and the findings."""

    recording: Recording
    findings: Findings


def sound(recording: Recording, raw: RawLog, robot: Robot) -> Recording:
    """Return a log, or a piece of one, as `read_both` gives it, without its damaged samples."""
    data = LogData(recording, raw, robot)
    return without(
        data, breaks_of(robot, data.t, data.joints.channels["position"])
    ).recording


def read_screened(
    path: Path, robot: Robot, *, time_source: TimeSource = "header", imus: bool = True
) -> Screened:
    """Read and check a log as a whole, its IMUs if they are used; see `read_recording`."""
    data = LogData(*read_both(path, robot, time_source=time_source), robot)
    sound, findings, _ = check(data, imus=imus, quality=False)
    return Screened(sound.recording, located(findings, data.recording.path))


def screened_long(
    log: SurveyedLog,
    robot: Robot,
    *,
    pieces: int = 8,
    piece_s: float = 20,
    overlap_s: float = 1.0,
) -> tuple[SurveyedLog, Findings]:
    """Check a log that is passed over; see `read_screened`.

    Torque and motion are compared in `pieces` of `piece_s`; breaks are looked for with
    `overlap_s` on either side of a block as well [s].
    """
    first = next(
        iter(READERS[log.format](log.file, replace(robot, imus=()), log.time_source))
    )
    size = min(log.samples, max(64, int(piece_s * log.rate_hz)))
    starts = np.linspace(0, log.samples - size, pieces)
    kept: dict[int, list[Block]] = {int(start): [] for start in starts}
    findings: list[InspectionFinding] = []
    bridges: list[Bridge] = []
    margin = max(16, int(overlap_s * log.rate_hz))
    for window, low, high in overlapping(log.blocks(), BLOCK_ROWS, margin):
        t = np.asarray(
            (window.start + np.arange(window.samples)) * log.step_s, dtype=np.float64
        )
        for each in breaks_of(robot, t, window.q):
            findings.append(each.finding)
            bridges += _bridged(each, window, log.rate_hz)
        for start, parts in kept.items():
            at = start - window.start
            if max(at, low) < min(at + size, high):
                parts.append(
                    deepcopy(window.part(slice(max(at, low), min(at + size, high))))
                )
    sound, warnings = replace(log, bridges=tuple(bridges)), log.warnings
    for piece in map(joined, kept.values()):
        for bridge in bridges:
            bridge.laid(piece)
        data = LogData(*_held(piece, log, first, warnings), robot)
        findings += check(data, imus=False, quality=False)[1]
        warnings = ()  # they are the log's, and said once
    return sound, located([first for first, *_ in grouped(findings)], log.path)


def _bridged(damage: Break, window: Block, rate_hz: float) -> Iterator[Bridge]:
    """Bridge damaged samples of a window, runs of them together."""
    most = max(GAP_INTERVALS, GAP_LEAST_S * rate_hz)
    q, rows = window.q[:, damage.joint], damage.rows
    for run in (
        np.split(rows, np.flatnonzero(np.diff(rows) > 1) + 1) if len(rows) else ()
    ):
        start, stop = int(run[0]), int(run[-1]) + 1
        after = float(q[min(stop, len(q) - 1)])
        before = float(q[start - 1]) if start else after
        ends = window.start + start, window.start + stop
        yield Bridge(damage.joint, *ends, before, after, stop - start < most)


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
    effort = (
        {"current": piece.tau / np.array(factor)} if currents else {"torque": piece.tau}
    )
    joints = Stream("joints", stamps, {"position": piece.q, **effort})
    return recording, RawLog(joints, prefer_current=first.prefer_current)
