"""Time: units, rate, gaps, stamps, holes of single channels, and the reader's warnings."""

import re
from collections.abc import Iterator

import numpy as np

from seqid_cli.inspect.findings import found
from seqid_cli.inspect.material import LogData
from seqid_cli.logs.raw import gap_limit
from seqid_cli.logs.timebase import JITTER_LIMIT
from seqid_cli.params.results.inspection import InspectionFinding
from seqid_cli.shares import percent

# What the reader says in words, and the code that it stands for; empty where a check of
# its own says it better.
_SAID: tuple[tuple[str, str], ...] = (
    (r": a second publisher: ", "second_publisher"),
    (r"runs twice over the same time", "clock_set_back"),
    (r"steps back \d+ times", "stamps_backwards"),
    (r"samples are lost at \d+ places", "samples_lost"),
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
    (r"cannot be turned into torque", "drive_data_missing"),
    (r"do not overlap|covers \d+ % of the joints", "imu_no_overlap"),
    (r"is left out: .* has no", "imu_missing_values"),
    (r"read as (ms|us|ns)$", ""),
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
    """Check the clock of a log, and turn the reader's warnings into findings."""
    health = data.recording.health
    rate = health.rate_hz
    text = f"{rate:.3g} samples per second"
    if not min_hz <= rate <= max_hz:
        ms = " but looks like ms" if 0.02 <= rate <= min_hz else ""
        yield found(
            "time_unit", f"{text}: the time column is not in seconds{ms}", channel="t"
        )
    elif rate < slow_hz:
        yield found("rate_low", text)
    if health.jitter > JITTER_LIMIT:
        text = (
            f"the sample interval scatters by {percent(health.jitter, 0)} of its median"
        )
        yield found(
            "jitter", text + (f", with {len(health.gaps)} gaps" if health.gaps else "")
        )
    elif gaps := _gaps(data):
        a, b = max(gaps, key=lambda gap: gap[1] - gap[0])
        lost = sum(end - start for start, end in gaps)
        text = (
            f"{len(gaps)} gaps, {lost:.3g} s in all, the longest from {a:.3f} to"
            f" {b:.3f} s"
        )
        yield found("clock_gap", text)
    delay = health.log_minus_header_s
    if delay is not None and not min_delay_s <= delay <= max_delay_s:
        yield found(
            "header_clock",
            f"messages are logged {delay:.6g} s after their header stamp",
        )
    names = (*data.robot.joint_names, *(imu.name for imu in data.robot.imus))
    for text in health.warnings:
        subject, imu = text.partition(":")[0], re.search(r"IMU '([^']+)'", text)
        joint = imu[1] if imu else subject if subject in names else ""
        if code := next(
            (code for form, code in _SAID if re.search(form, text)), "reader"
        ):
            yield found(code, text, joint)


def _gaps(data: LogData) -> list[tuple[float, float]]:
    """Gaps without a row [s], but for the holes between episodes."""
    t, steps = data.t, np.diff(data.t)
    said = map(_EPISODES.search, data.recording.health.warnings)
    holes = [float(match[1]) for match in said if match]  # to three digits
    gaps = t[np.flatnonzero(steps > gap_limit(steps))[:, None] + (0, 1)].tolist()
    return [
        (a, b)
        for a, b in gaps
        if all(abs(b - a - hole) > 0.01 * hole for hole in holes)
    ]


def hole_findings(data: LogData) -> Iterator[InspectionFinding]:
    """Find holes in the position and the torque of every joint."""
    effort, t = data.effort(), data.t
    channels = [
        ("position", data.joints.channels["position"]),
        *([effort] if effort else []),
    ]
    for quantity, values in channels:
        for name, there in zip(
            data.robot.joint_names, np.isfinite(values).T, strict=True
        ):
            present = np.flatnonzero(there)
            if there.all() or len(present) < 3:
                continue
            steps, rows = np.diff(t[present]), np.diff(present)
            wide = (steps > gap_limit(steps)) & (rows > 2 * int(np.median(rows)))
            if count := np.count_nonzero(wide):
                k = int(np.where(wide, steps, 0.0).argmax())
                more = f" and {count - 1} more times" if count > 1 else ""
                text = (
                    f"has no values from {t[present[k]]:.3f} to {t[present[k + 1]]:.3f}"
                    f" s{more}"
                )
                yield found("channel_hole", text, name, quantity)
