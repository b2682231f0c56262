"""Checks of a log that a stage reads, which then goes on without damaged samples.

A log that is passed over is looked through for damaged positions block by block; torque
and motion are compared with each other in some pieces of it, so that memory does not
grow with the log.
"""

from collections.abc import Iterable, Iterator, Sequence
from copy import deepcopy
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

import numpy as np

from seqid_cli.errors import InputError
from seqid_cli.inspect.channels.clock import clock_findings
from seqid_cli.inspect.channels.positions import Break, breaks_of
from seqid_cli.inspect.checks import check, without
from seqid_cli.inspect.findings import grouped, located
from seqid_cli.inspect.material import LogData
from seqid_cli.inspect.settings import InspectSettings
from seqid_cli.logs.long import Bridge, LongLog, open_if_long
from seqid_cli.logs.raw import GAP_INTERVALS, GAP_LEAST_S, RawLog, Stream
from seqid_cli.logs.read import read_both
from seqid_cli.logs.reading import HEADER_STAMPS, Reading
from seqid_cli.logs.recording import Block, Health, Recording
from seqid_cli.logs.tables.parquet import BLOCK_ROWS
from seqid_cli.motion.blocks import joined, overlapping
from seqid_cli.params.results.inspection import InspectionFinding
from seqid_cli.robot.types import Robot
from seqid_cli.typing import Index

Findings = tuple[InspectionFinding, ...]


class Screened(NamedTuple):
    """A log without its damaged samples, and the findings."""

    recording: Recording
    findings: Findings


class Opened(NamedTuple):
    """A log without its damaged samples, held or passed over, and the findings."""

    log: Recording | LongLog
    findings: Findings


def sound(recording: Recording, raw: RawLog, robot: Robot) -> Recording:
    """Return a log, or a piece of one, without its damaged samples.

    Parameters
    ----------
    recording : Recording
        The log on one time base.
    raw : RawLog
        The same as it was logged; `read_both` gives both.
    robot : Robot
        The arm.
    """
    data = LogData(recording=recording, raw=raw, robot=robot)
    breaks = breaks_of(robot, data.t, data.joints.channels["position"])
    return without(data, breaks).recording


def read_screened(
    path: Path,
    robot: Robot,
    *,
    reading: Reading = HEADER_STAMPS,
    imus: bool = True,
    settings: InspectSettings = InspectSettings(),
) -> Screened:
    """Read and check a log as a whole.

    Parameters
    ----------
    path : Path
        A log of any format that can be read.
    robot : Robot
        The arm.
    reading : Reading
        By which stamps logs are read, and which part of them.
    imus : bool
        Whether its IMUs are used, and hence checked.
    settings : InspectSettings
        Numbers that decide; stages have the defaults.

    Returns
    -------
    Screened
        The log without damaged samples, and the findings.

    Raises
    ------
    InputError
        As `read_recording`, or its time is in another unit.
    """
    recording, raw = read_both(path, robot, reading=reading)
    data = LogData(recording=recording, raw=raw, robot=robot, settings=settings)
    checked, findings, _ = check(data, imus=imus, quality=False)
    _refuse_other_time(findings, path)
    return Screened(checked.recording, located(findings, data.recording.path))


def _refuse_other_time(findings: Sequence[InspectionFinding], path: Path) -> None:
    """Raise InputError where time is in another unit: no speed is right then."""
    for finding in findings:
        if finding.code == "time_unit":
            raise InputError(finding.message, hint=finding.remedy, where=str(path))


def open_screened(
    path: Path,
    robot: Robot,
    *,
    reading: Reading = HEADER_STAMPS,
    imus: bool = True,
    checks: bool = True,
    pass_over_from: int | None = None,
) -> Opened:
    """Open and check a log, as every stage does.

    Parameters
    ----------
    path : Path
        A local log of any format that can be read.
    robot : Robot
        The arm.
    reading : Reading
        By which stamps logs are read, and which part of them.
    imus : bool
        Whether its IMUs are used, and hence checked, where it is held.
    checks : bool
        Whether it is checked where it is held. Damaged samples are taken out in any
        case.
    pass_over_from : int, optional
        Samples from which on a log is passed over where it can be; None holds all.
    """
    if pass_over_from is not None:
        long = open_if_long(path, robot, reading=reading, least=pass_over_from)
        if long is not None:
            return Opened(*screened_long(long, robot))
    if not checks:
        recording, raw = read_both(path, robot, reading=reading)
        data = LogData(recording=recording, raw=raw, robot=robot)
        _refuse_other_time([*clock_findings(data)], path)
        return Opened(sound(recording, raw, robot), ())
    return Opened(*read_screened(path, robot, reading=reading, imus=imus))


def screened_long(
    log: LongLog,
    robot: Robot,
    *,
    pieces: int = 8,
    piece_s: float = 20,
    overlap_s: float = 1.0,
) -> tuple[LongLog, Findings]:
    """Check a log that is passed over.

    Parameters
    ----------
    log : LongLog
        A log that is too long to be held.
    robot : Robot
        The arm.
    pieces, piece_s : int, float
        Pieces in which torque and motion are compared, spread over the log, and their
        length [s].
    overlap_s : float
        Time on either side of a block [s] in which breaks are looked for as well.

    Returns
    -------
    log : LongLog
        The log with bridges over damaged samples.
    findings : tuple of InspectionFinding
        Each code once per joint and channel.
    """
    # The samples as they were logged say which channels there are.
    without_imus = replace(robot, imus=())
    first_block = next(log.file.blocks(without_imus))

    breaks = _BreakSearch(log, robot, pieces=pieces, piece_s=piece_s)
    margin = max(16, int(overlap_s * log.rate_hz))
    for window, low, high in overlapping(log.blocks(), BLOCK_ROWS, margin):
        breaks.look_through(window, low, high)

    findings = breaks.findings
    warnings = log.warnings
    for blocks in breaks.pieces.values():
        piece = joined(blocks)
        for bridge in breaks.bridges:
            bridge.laid(piece)
        recording, raw = _as_recording(piece, log, first_block, warnings)
        data = LogData(recording=recording, raw=raw, robot=robot)
        findings += check(data, imus=False, quality=False)[1]
        _refuse_other_time(findings, log.path)
        warnings = ()  # they are the log's, and reported once
    first_of_each = [group[0] for group in grouped(findings)]
    bridged = replace(log, bridges=tuple(breaks.bridges))
    return bridged, located(first_of_each, log.path)


class _BreakSearch:
    """A search for damaged positions in a long log, which keeps pieces of it.

    `pieces` holds the blocks of each piece by its first sample.
    """

    def __init__(
        self, log: LongLog, robot: Robot, *, pieces: int, piece_s: float
    ) -> None:
        self.log = log
        self.robot = robot
        self.findings: list[InspectionFinding] = []
        self.bridges: list[Bridge] = []
        self.piece_rows = min(log.samples, max(64, int(piece_s * log.rate_hz)))
        starts = np.linspace(0, log.samples - self.piece_rows, pieces)
        self.pieces: dict[int, list[Block]] = {int(start): [] for start in starts}

    def look_through(self, window: Block, low: int, high: int) -> None:
        """Look for breaks in a window; keep rows [low, high) of it that are wanted."""
        rows = window.start + np.arange(window.samples)
        t = np.asarray(rows * self.log.base.step_s, dtype=np.float64)
        for damage in breaks_of(self.robot, t, window.q):
            self.findings.append(damage.finding)
            self.bridges += _bridges(damage, window, self.log.rate_hz)

        for start, blocks in self.pieces.items():
            first = max(start - window.start, low)
            last = min(start - window.start + self.piece_rows, high)
            if first < last:
                # The window is overwritten by the next one.
                blocks.append(deepcopy(window.part(slice(first, last))))


def _bridges(damage: Break, window: Block, rate_hz: float) -> Iterator[Bridge]:
    """Yield a bridge over each run of damaged samples of a window."""
    # A longer hole is a gap: a straight line over it is no measurement.
    most_samples = max(GAP_INTERVALS, GAP_LEAST_S * rate_hz)
    q = window.q[:, damage.joint]
    for run in _consecutive(damage.rows):
        start = int(run[0])
        stop = int(run[-1]) + 1
        after = float(q[min(stop, len(q) - 1)])
        before = float(q[start - 1]) if start else after
        yield Bridge(
            joint=damage.joint,
            start=window.start + start,
            stop=window.start + stop,
            before=before,
            after=after,
            valid=stop - start < most_samples,
        )


def _consecutive(rows: Index) -> Iterable[Index]:
    """Split row numbers into runs without a hole."""
    if not len(rows):
        return ()
    return np.split(rows, np.flatnonzero(np.diff(rows) > 1) + 1)


def _as_recording(
    piece: Block, log: LongLog, first_block: RawLog, warnings: tuple[str, ...]
) -> tuple[Recording, RawLog]:
    """Make a recording of a piece, and the raw log of it."""
    rows = piece.start + np.arange(len(piece.q))
    stamps = log.base.start_ns + np.rint(rows * log.base.step_s * 1e9).astype(np.int64)
    recording = Recording(
        path=log.path,
        sha256="",
        format=log.format,
        t=(rows - rows[0]) * log.base.step_s,
        q=piece.q,
        valid=piece.valid,
        health=Health(log.rate_hz, log.base.jitter, warnings=warnings),
        tau=piece.tau,
        start=float(stamps[0]) * 1e-9,
        partial=log.partial,
    )

    # Messages of the checks speak of the quantity that was logged.
    logged = first_block.joints.channels
    effort = {"torque": piece.tau}
    if "current" in logged and (first_block.prefer_current or "torque" not in logged):
        torque_per_ampere = np.array(
            [joint.torque_per_ampere or np.nan for joint in log.robot.joints]
        )
        effort = {"current": piece.tau / torque_per_ampere}
    joints = Stream("joints", stamps, {"position": piece.q, **effort})
    return recording, RawLog(joints, prefer_current=first_block.prefer_current)
