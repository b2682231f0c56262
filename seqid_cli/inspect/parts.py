"""An inspected log, gathered part by part: what was in it, and its faults.

A short log is one part, and what is told of it is told of all its samples. Of the parts of a long
one counts, ranges and means are merged; a finding of several parts is told once, with its first
place and how many parts show it.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import NamedTuple

import numpy as np
from msgspec import structs

from seqid_cli.errors import InputError
from seqid_cli.inspect.channels.clock import gap_finding, gaps_of
from seqid_cli.inspect.checks import check
from seqid_cli.inspect.findings import found, grouped, located, verdict_of
from seqid_cli.inspect.material import LogData
from seqid_cli.inspect.moves import (
    imu_summaries,
    joint_summaries,
    moves_of,
    moving_together,
    serves,
    stretches_of,
    together,
)
from seqid_cli.logs.raw import Stream
from seqid_cli.logs.recording import Health
from seqid_cli.motion.segmentation import Stretch
from seqid_cli.params.results.inspection import (
    InspectedImu,
    InspectedJoint,
    InspectedLog,
    InspectionFinding,
)
from seqid_cli.robot.types import Array, Robot

Gap = tuple[float, float]


class Inspected(NamedTuple):
    """One log and its findings."""

    log: InspectedLog
    findings: tuple[InspectionFinding, ...]


@dataclass
class Gathered:
    """Takes the parts of a log in their order."""

    robot: Robot
    modelled: bool = True
    begun: float = 0.0  # s, of the log's clock
    end: float = 0.0  # of the parts so far, s since then
    lost: list[InputError] = field(default_factory=list)
    _health: list[Health] = field(default_factory=list)
    _partial: list[str] = field(default_factory=list)
    _samples: list[int] = field(default_factory=list)
    _gaps: list[Gap] = field(default_factory=list)  # of the time base
    _row_gaps: list[Gap] = field(default_factory=list)  # without a row
    _joints: list[list[InspectedJoint]] = field(default_factory=list)
    _imus: list[InspectedImu] = field(default_factory=list)
    _stretches: list[Stretch] = field(default_factory=list)
    _together: list[Array] = field(default_factory=list)
    _findings: list[InspectionFinding] = field(default_factory=list)
    _torque: bool = False
    _accelerated: bool = False  # an IMU is there
    _sha256: str = ""

    def push(self, data: LogData) -> None:
        """Take the next part."""
        recording, health = data.recording, data.recording.health
        first = not self._health
        if first:
            self.begun, self._sha256 = recording.start, recording.sha256
        offset = recording.start - self.begun
        checked = check(data)
        self._findings += checked.findings
        self._gaps += self._new(health.gaps, offset)
        self._row_gaps += self._new(gaps_of(data), 0.0)
        self._joints.append(joint_summaries(data))
        self._imus += imu_summaries(data, checked.following)
        self._add_stretches(stretches_of(data), round(offset * health.rate_hz), health.rate_hz)
        self._together.append(together(data.moving))
        self._torque |= recording.tau is not None
        self._accelerated |= bool(recording.accelerometers or recording.gyros)
        new = len(recording.t) if first else np.count_nonzero(recording.t + offset > self.end)
        self._samples.append(int(new))
        self.end = offset + float(recording.t[-1])
        self._health.append(health)
        self._partial += [recording.partial] if recording.partial else []

    def failed(self, error: InputError, joints: Stream) -> None:
        """Take note of a part of no use."""
        first, last = (float(joints.stamp_ns[k]) * 1e-9 - self.begun for k in (0, -1))
        where = f"from {first:.3f} to {last:.3f} s: " if self._health else "at the start: "
        self.lost.append(InputError(where + error.message, hint=error.hint, where=error.where))

    def _new(self, gaps: Sequence[Gap], offset: float) -> list[Gap]:
        """Gaps that the part before has not seen."""
        moved = [(start + offset, end + offset) for start, end in gaps]
        return [gap for gap in moved if gap[1] > self.end + 1e-6]

    def _add_stretches(self, found_now: Sequence[Stretch], offset: int, rate_hz: float) -> None:
        """Take stretches of constant velocity; one that the part before ends with goes on."""
        known = self.end * rate_hz
        last = {s.joint: s for s in self._stretches}
        for one in found_now:
            before = last.get(one.joint)
            goes_on = (
                before is not None
                and one.start + offset <= min(before.stop, known)
                and before.velocity * one.velocity > 0.0
            )
            if not goes_on:
                self._stretches.append(
                    replace(one, start=one.start + offset, stop=one.stop + offset)
                )

    def log(self, path: object, form: str, before: Sequence[InspectionFinding]) -> Inspected:
        """Tell what is in the log, and its faults; `before` are those that were found first.

        Raises InputError: no part is of use.
        """
        if not self._health:
            raise self.lost[0]
        findings = located((*before, *self._merged()), path)
        health, count = self._health, np.array(self._samples, dtype=np.float64)
        rate, jitter = _clock(health, count)
        delays = [one.log_minus_header_s for one in health if one.log_minus_header_s is not None]
        joints = _joints(self._joints, count)
        moving = [joint.moves for joint in joints]
        several = moving_together(self.robot, np.sum(self._together, axis=0))
        there = {"torque": self._torque, "imus": self._accelerated}
        stages = serves(self.robot, self._stretches, moving, several, **there)
        log = InspectedLog(
            path=str(path),
            sha256=self._sha256,
            format=form,
            verdict=verdict_of(findings),
            samples=sum(self._samples),
            seconds=self.end,
            rate_hz=rate,
            jitter=jitter,
            gaps=[list(gap) for gap in self._gaps],
            non_monotonic=sum(one.non_monotonic for one in health),
            duplicates=sum(one.duplicates for one in health),
            log_minus_header_s=float(np.median(delays)) if delays else None,
            joints=joints,
            imus=_imus(self._imus),
            moves=moves_of(self.robot, self._stretches),
            moving_together=list(several),
            serves=list(stages) if self.modelled else [],
            partial="; ".join(self._partial),
        )
        return Inspected(log, findings)

    def _merged(self) -> list[InspectionFinding]:
        """Each finding once, where it was first."""
        result = map(self._told, grouped(self._findings))
        return [*result, *(found("channel_hole", error.message) for error in self.lost)]

    def _told(self, alike: Sequence[InspectionFinding]) -> InspectionFinding:
        first, parts = alike[0], len(self._health)
        if parts == 1:
            return first
        if first.code == "clock_gap":
            return gap_finding(self._row_gaps)
        if all(one.message == first.message for one in alike) and len(alike) == parts:
            return first
        message = f"{first.message} (of {parts} parts of the log {len(alike)} show it)"
        return structs.replace(first, message=message)


def _clock(health: Sequence[Health], samples: Array) -> tuple[float, float]:
    """Rate [Hz] and jitter of all parts."""
    if len(health) == 1:
        return health[0].rate_hz, health[0].jitter
    rates = np.array([one.rate_hz for one in health])
    jitter = np.sqrt(np.average([one.jitter**2 for one in health], weights=samples))
    return float(samples.sum() / (samples / rates).sum()), float(jitter)


def _joints(parts: Sequence[Sequence[InspectedJoint]], samples: Array) -> list[InspectedJoint]:
    if len(parts) == 1:
        return list(parts[0])
    return [_joint(some, samples) for some in zip(*parts, strict=True)]


def _joint(parts: Sequence[InspectedJoint], samples: Array) -> InspectedJoint:
    """One joint of all parts; its encoder's step is the median of theirs."""
    steps = [part.encoder_step for part in parts if part.encoder_step is not None]
    effort = np.array([np.nan if p.effort_rms is None else p.effort_rms for p in parts])
    known = np.isfinite(effort)
    power = np.average(effort[known] ** 2, weights=samples[known]) if known.any() else 0.0
    warm = [part.temperature for part in parts if part.temperature is not None]
    return InspectedJoint(
        name=parts[0].name,
        moves=any(part.moves for part in parts),
        low=min(part.low for part in parts),
        high=max(part.high for part in parts),
        top_speed=max(part.top_speed for part in parts),
        encoder_step=float(np.median(steps)) if steps else None,
        effort=next((part.effort for part in parts if part.effort), ""),
        effort_rms=float(np.sqrt(power)) if known.any() else None,
        temperature=[min(w[0] for w in warm), max(w[1] for w in warm)] if warm else None,
    )


def _imus(parts: Sequence[InspectedImu]) -> list[InspectedImu]:
    """Each IMU once; what is measured is the median of the parts."""
    alike: dict[str, list[InspectedImu]] = {}
    for part in parts:
        alike.setdefault(part.name, []).append(part)

    def middle(values: Sequence[float | None]) -> float | None:
        known = [value for value in values if value is not None]
        return float(np.median(known)) if known else None

    return [
        structs.replace(
            some[0],
            accelerometers=max(one.accelerometers for one in some),
            gyro=any(one.gyro for one in some),
            rate_hz=middle([one.rate_hz for one in some]) or 0.0,
            rest_norm=middle([one.rest_norm for one in some]),
            delay_s=middle([one.delay_s for one in some]),
        )
        for some in alike.values()
    ]
