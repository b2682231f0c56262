"""An inspected log, gathered part by part: what moves, which stages it serves, its faults.

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
from seqid_cli.inspect.channels.positions import top_speed
from seqid_cli.inspect.channels.values import lattice
from seqid_cli.inspect.checks import check
from seqid_cli.inspect.findings import found, grouped, located, verdict_of
from seqid_cli.inspect.imu.motion import Following
from seqid_cli.inspect.imu.readings import force_of, rest_rows
from seqid_cli.inspect.material import LogData
from seqid_cli.logs.raw import Stream
from seqid_cli.logs.recording import Health
from seqid_cli.motion.segmentation import Stretch, constant_velocity
from seqid_cli.params.results.inspection import (
    InspectedImu,
    InspectedJoint,
    InspectedLog,
    InspectedMoves,
    InspectionFinding,
)
from seqid_cli.robot.types import Array, Robot


def joint_summaries(data: LogData) -> list[InspectedJoint]:
    """Describe what the log shows of each joint."""
    quantity, torques = data.effort() or ("", None)
    channels = data.joints.channels
    result = []
    for j, name in enumerate(data.robot.joint_names):
        given = (channels["position"], torques, channels.get("temperature"))
        columns = [np.zeros(0) if values is None else values[:, j] for values in given]
        q, values, warm = (column[np.isfinite(column)] for column in columns)
        result.append(
            InspectedJoint(
                name=name,
                moves=data.moves(j),
                low=float(q.min()),
                high=float(q.max()),
                top_speed=top_speed(data, j) if data.moves(j) else 0.0,
                encoder_step=lattice(q) or None,
                effort=quantity if len(values) else "",
                effort_rms=float(np.sqrt(np.mean(values**2))) if len(values) else None,
                temperature=[float(warm.min()), float(warm.max())] if len(warm) else None,
            )
        )
    return result


def imu_summaries(data: LogData, following: Sequence[Following]) -> list[InspectedImu]:
    """Describe what the log shows of each IMU."""
    result = []
    for imu in data.robot.imus:
        streams = data.raw.imus.get(imu.name, ())
        values = data.recording.accelerometers.get(imu.name)
        gyro = imu.name in data.recording.gyros
        if values is None and not gyro:
            continue
        spans = [float(np.median(np.diff(s.stamp_ns))) for s in streams if len(s) > 1]
        norm = None
        if values is not None and np.linalg.matrix_rank(imu.axes) == 3:
            rest = rest_rows(data, values)
            norm = force_of(imu, rest) if len(rest) else None
        result.append(
            InspectedImu(
                name=imu.name,
                accelerometers=0 if values is None else values.shape[1],
                gyro=gyro,
                rate_hz=1.0 / (max(spans) * 1e-9) if spans and max(spans) > 0 else 0.0,
                rest_norm=norm,
                delay_s=next((f.fit.delay for f in following if f.imu.name == imu.name), None),
            )
        )
    return result


def moves_of(robot: Robot, stretches: Sequence[Stretch]) -> list[InspectedMoves]:
    """Summarise the constant-velocity stretches of each joint."""
    mine = {j: [s for s in stretches if s.joint == j] for j in range(robot.n)}
    return [
        InspectedMoves(
            joint=robot.joint_names[j],
            forward=sum(s.velocity > 0 for s in own),
            backward=sum(s.velocity <= 0 for s in own),
            slowest=min(abs(s.velocity) for s in own),
            fastest=max(abs(s.velocity) for s in own),
            postures=_postures(own, j),
        )
        for j, own in mine.items()
        if own
    ]


def _postures(stretches: list[Stretch], joint: int, *, same: float = 0.03) -> int:
    """Count the different postures of the locked joints."""
    found: list[Array] = []
    for stretch in stretches:
        others = np.delete(np.array(stretch.configuration), joint)
        if not any(np.abs(others - known).max(initial=0.0) < same for known in found):
            found.append(others)
    return len(found)


def moving_together(robot: Robot, counts: Array, *, min_share: float = 0.1) -> tuple[str, ...]:
    """Joints that move with others for a fair share of the samples (n + 1,) with motion."""
    share = counts[:-1] / max(counts[-1], 1.0)
    names = zip(robot.joint_names, share, strict=True)
    return tuple(name for name, part in names if part > min_share)


def serves(
    robot: Robot,
    stretches: Sequence[Stretch],
    moving: Sequence[bool],
    several: Sequence[str],
    *,
    torque: bool,
    imus: bool,
    min_speeds: int = 3,
    max_share: float = 0.25,  # of the speed limit, up to which moves show gravity well
) -> tuple[str, ...]:
    """Return the stages that a log serves: joints `moving`, `several` with others."""
    stages: list[str] = []
    limits = [joint.velocity_limit for joint in robot.joints]
    for j in range(robot.n):
        mine = [s for s in stretches if s.joint == j]
        ways = {np.sign(s.velocity) for s in mine}
        if not torque or len(ways) < 2:
            continue
        if _speeds([abs(s.velocity) for s in mine]) >= min_speeds:
            stages.append("friction")
        slow = max(abs(s.velocity) for s in mine) < max_share * (limits[j] or 1.0)
        if robot.gravity.any() and (slow or _postures(mine, j) > 1):
            stages.append("gravity")
    if imus and sum(moving) == 1:
        stages.append("imu-calib")
    if torque and (len(several) >= 2 or (robot.n == 1 and moving[0])):
        stages.append("inertia")
    return tuple(dict.fromkeys(stages))


def serve_together(logs: Sequence[InspectedLog], *, min_speeds: int = 3) -> list[InspectedLog]:
    """Add `friction` to logs that serve it together, such as one log per speed.

    That is of joints for which no log serves it alone, by logs with a speed of them, both ways.
    """
    alone = {m.joint for log in logs if "friction" in log.serves for m in log.moves}
    speeds: dict[str, list[float]] = {}
    for log in logs:
        for move in _both_ways(log):
            speeds.setdefault(move.joint, []).extend((move.slowest, move.fastest))
    added = {j for j, own in speeds.items() if j not in alone and _speeds(own) >= min_speeds}
    return [
        structs.replace(log, serves=["friction", *log.serves])
        if any(move.joint in added for move in _both_ways(log)) and "friction" not in log.serves
        else log
        for log in logs
    ]


def _both_ways(log: InspectedLog) -> list[InspectedMoves]:
    """Moves at constant speed, both ways, of joints with a torque."""
    driven = {joint.name for joint in log.joints if joint.effort}
    return [m for m in log.moves if m.forward and m.backward and m.joint in driven]


def _speeds(speeds: Sequence[float], *, different: float = 1.25) -> int:
    """Count the speeds that differ."""
    count, last = 0, 0.0
    for speed in sorted(speeds):
        if speed > different * last:
            count, last = count + 1, speed
    return count


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
    _together: list[Array] = field(default_factory=list)  # samples: each with others, any (n + 1,)
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
        q, rate, where = recording.q, health.rate_hz, recording.valid
        self._add_stretches(constant_velocity(q, rate, step=data.step, valid=where), offset, rate)
        several = data.moving.sum(axis=1, keepdims=True) >= 2
        moves = np.hstack([data.moving & several, data.moving.any(axis=1, keepdims=True)])
        self._together.append(moves.sum(axis=0).astype(np.float64))
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

    def _add_stretches(self, found_now: Sequence[Stretch], offset: float, rate_hz: float) -> None:
        """Take stretches of constant velocity; one that the part before ends with goes on."""
        known, rows = self.end * rate_hz, round(offset * rate_hz)
        last = {s.joint: s for s in self._stretches}
        for one in found_now:
            moved = replace(one, start=one.start + rows, stop=one.stop + rows)
            before = last.get(one.joint)
            same_way = before is not None and before.velocity * one.velocity > 0.0
            if before is None or not same_way or moved.start > min(before.stop, known):
                self._stretches.append(moved)

    def log(self, path: object, form: str, before: Sequence[InspectionFinding]) -> Inspected:
        """Tell what is in the log, and its faults; `before` are those that were found first.

        Raises InputError: no part is of use.
        """
        if not self._health:
            raise self.lost[0]
        lost = (found("channel_hole", error.message) for error in self.lost)
        findings = located((*before, *map(self._told, grouped(self._findings)), *lost), path)
        health, count = self._health, np.array(self._samples, dtype=np.float64)
        rates, jitters = np.array([(one.rate_hz, one.jitter) for one in health]).T
        delays = [one.log_minus_header_s for one in health if one.log_minus_header_s is not None]
        joints = [_joint(some, count) for some in zip(*self._joints, strict=True)]
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
            rate_hz=float(count.sum() / (count / rates).sum()),
            jitter=float(np.sqrt(np.average(jitters**2, weights=count))),
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

    def _told(self, alike: Sequence[InspectionFinding]) -> InspectionFinding:
        """A finding of several parts, told once."""
        first, parts = alike[0], len(self._health)
        if first.code == "clock_gap":
            return gap_finding(self._row_gaps)
        if all(one.message == first.message for one in alike) and len(alike) == parts:
            return first
        message = f"{first.message} (of {parts} parts of the log {len(alike)} show it)"
        return structs.replace(first, message=message)


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
