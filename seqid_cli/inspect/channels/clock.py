"""Time of a log: unit, rate, gaps, stamps, holes of channels, and reader's warnings."""

import re
from collections.abc import Iterator

import numpy as np
from msgspec import structs

from seqid_cli.inspect.findings import finding_of
from seqid_cli.inspect.material import LogData
from seqid_cli.inspect.scales import likely_unit_of_time, remedy_of_time
from seqid_cli.logs.raw import Stamps, gap_limit
from seqid_cli.logs.timebase import JITTER_LIMIT
from seqid_cli.params.results.inspection import InspectionFinding
from seqid_cli.shares import percent

# Warnings of the reader by a pattern of their words, and the codes that they stand for;
# no code where a check of its own says it better.
_WARNING_CODES: tuple[tuple[str, str], ...] = (
    (r": a second publisher: ", "second_publisher"),
    (r"runs twice over the same time", "clock_set_back"),
    (r"steps back \d+ times", "stamps_backwards"),
    (r"samples are lost at \d+ places", "samples_lost"),
    (r"stamps are coarser than the samples", "stamps_coarse"),
    (r"repeat a stamp|share a stamp", "stamps_repeated"),
    (r"stamps span", "stamps_far_off"),
    (
        r"header stamps? .*zero|have no header stamp|without a usable time",
        "stamps_zero",
    ),
    (r"cannot resolve less than", "time_resolution"),
    (r"are infinite or beyond", "values_absurd"),
    (r"last line has no end and", "salvaged"),
    (r"position wraps by whole turns", "position_wraps"),
    (r"sign is taken from command minus position", "sign_by_command"),
    (r"it is a magnitude", "effort_unsigned"),
    (r"cannot be turned into torque", "drive_data_missing"),
    (r"do not overlap|covers \d+ % of the joints", "imu_no_overlap"),
    (r"is left out: .* has no", "imu_missing_values"),
    (r"hold either acceleration or angular velocity", "imu_alternates"),
    (r"read as (ms|us|ns)$", ""),
    (r": read beside .*, row by row$", ""),
)
# Holes that the reader lays between episodes [s].
_EPISODES = re.compile(r"episodes .* are read as stretches with a gap of ([0-9.e+]+) s")


def clock_findings(
    data: LogData,
    *,
    slow_hz: float = 20.0,
    min_hz: float = 5.0,
    max_hz: float = 50_000.0,
    min_delay_s: float = -0.005,
    max_delay_s: float = 5.0,
) -> Iterator[InspectionFinding]:
    """Check the clock of a log, and turn the reader's warnings into findings.

    Parameters
    ----------
    data : LogData
        The log.
    slow_hz : float
        Rate below which a log is slow [Hz].
    min_hz, max_hz : float
        Rates beyond which time is taken to be in another unit [Hz].
    min_delay_s, max_delay_s : float
        Times from header stamp to logging beyond which clocks differ [s].
    """
    health = data.recording.health
    rate_hz = health.rate_hz
    text = f"{rate_hz:.3g} samples per second"
    if not min_hz <= rate_hz <= max_hz:
        unit = likely_unit_of_time(rate_hz, slowest_hz=min_hz, fastest_hz=max_hz)
        text = f"{text}: the time column is not in seconds"
        text += f" but looks like {unit}" if unit else ""
        finding = finding_of("time_unit", text, channel="t")
        remedy = remedy_of_time(unit) if unit else finding.remedy
        yield structs.replace(finding, remedy=remedy)
    elif rate_hz < slow_hz:
        yield finding_of("rate_low", text)

    # Where intervals scatter, gaps are a part of that.
    if health.jitter > JITTER_LIMIT:
        share = percent(health.jitter, 0)
        text = f"the sample interval scatters by {share} of its median"
        if health.gaps:
            text += f", with {len(health.gaps)} gaps"
        yield finding_of("jitter", text)
    else:
        yield from _gap_findings(data)

    delay_s = health.log_minus_header_s
    if delay_s is not None and not min_delay_s <= delay_s <= max_delay_s:
        text = f"messages are logged {delay_s:.6g} s after their header stamp"
        yield finding_of("header_clock", text)
    yield from _warning_findings(data)


def _gap_findings(data: LogData) -> Iterator[InspectionFinding]:
    """Find gaps without a row."""
    gaps = _gaps(data)
    if gaps:
        start, stop = max(gaps, key=lambda gap: gap[1] - gap[0])
        lost_s = sum(stop - start for start, stop in gaps)
        text = (
            f"{len(gaps)} gaps, {lost_s:.3g} s in all, the longest from {start:.3f} to"
            f" {stop:.3f} s"
        )
        yield finding_of("clock_gap", text)


def _gaps(data: LogData) -> list[tuple[float, float]]:
    """Return gaps without a row [s], but for those of episodes and of a user's word."""
    matches = map(_EPISODES.search, data.recording.health.warnings)
    holes_s = [float(match[1]) for match in matches if match]  # to three digits
    t = data.t
    steps = np.diff(t)
    gaps = []
    for k in np.flatnonzero(steps > gap_limit(steps)):
        start = float(t[k])
        stop = float(t[k + 1])
        length = stop - start
        stamps_ns = data.joints.stamp_ns[k : k + 2]
        if any(_covers(cut_ns, stamps_ns) for cut_ns in data.raw.cuts_ns):
            continue
        if not any(abs(length - hole) <= 0.01 * hole for hole in holes_s):
            gaps.append((start, stop))
    return gaps


def _covers(cut_ns: tuple[int, int], gap_ns: Stamps, *, share: float = 0.5) -> bool:
    """Tell whether what was left out on purpose is most of a gap between two stamps."""
    start_ns, stop_ns = gap_ns.tolist()
    common_ns = min(stop_ns, cut_ns[1]) - max(start_ns, cut_ns[0])
    return bool(common_ns > share * (stop_ns - start_ns))


def _warning_findings(data: LogData) -> Iterator[InspectionFinding]:
    """Turn the reader's warnings into findings."""
    robot = data.robot
    names = {*robot.joint_names, *(imu.name for imu in robot.imus)}
    for text in data.recording.health.warnings:
        subject = text.partition(":")[0]
        imu = re.search(r"IMU '([^']+)'", text)
        if imu:
            subject = imu[1]
        elif subject not in names:
            subject = ""
        code = _code_of(text)
        if code:
            yield finding_of(code, text, subject)


def _code_of(warning: str) -> str:
    """Return the code of a warning; empty where another check says it better."""
    for pattern, code in _WARNING_CODES:
        if re.search(pattern, warning):
            return code
    return "reader"


def hole_findings(data: LogData) -> Iterator[InspectionFinding]:
    """Find holes in the position and the torque of every joint."""
    channels = [("position", data.joints.channels["position"])]
    effort = data.effort()
    if effort is not None:
        channels.append(effort)
    t = data.t
    for quantity, values in channels:
        for j, name in enumerate(data.robot.joint_names):
            is_present = np.isfinite(values[:, j])
            present = np.flatnonzero(is_present)
            if is_present.all() or len(present) < 3:
                continue

            # A slower channel has values in every few rows: that is no hole.
            steps = np.diff(t[present])
            rows = np.diff(present)
            is_hole = (steps > gap_limit(steps)) & (rows > 2 * int(np.median(rows)))
            n_holes = np.count_nonzero(is_hole)
            if not n_holes:
                continue
            widest = int(np.where(is_hole, steps, 0.0).argmax())
            start = t[present[widest]]
            stop = t[present[widest + 1]]
            text = f"has no values from {start:.3f} to {stop:.3f} s"
            if n_holes > 1:
                text += f" and {n_holes - 1} more times"
            yield finding_of("channel_hole", text, name, quantity)
