"""An inspected log, gathered part by part: what moves, which stages it serves, its faults.

A short log is one part, and what is told of it is told of all its samples. Of the parts of a long
one counts, ranges and means are merged; a finding of several parts is told once, with its first
place and how many parts show it.
"""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import NamedTuple, TypeVar

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

TOGETHER = 0.1  # of the moving time, in which a joint that moves with others does


def _moves(robot: Robot, stretches: Sequence[Stretch]) -> Iterator[InspectedMoves]:
    """Summarise the constant-velocity stretches of each joint."""
    for j, name in enumerate(robot.joint_names):
        own = [s for s in stretches if s.joint == j]
        if own:
            yield InspectedMoves(
                joint=name,
                forward=sum(s.velocity > 0 for s in own),
                backward=sum(s.velocity <= 0 for s in own),
                slowest=min(abs(s.velocity) for s in own),
                fastest=max(abs(s.velocity) for s in own),
                postures=_postures(own, j),
            )


def _postures(stretches: list[Stretch], joint: int, *, same: float = 0.03) -> int:
    """Count the different postures of the locked joints."""
    found: list[Array] = []
    for stretch in stretches:
        others = np.delete(np.array(stretch.configuration), joint)
        if not any(np.abs(others - known).max(initial=0.0) < same for known in found):
            found.append(others)
    return len(found)


def _serves(
    robot: Robot,
    stretches: Sequence[Stretch],
    joints: Sequence[InspectedJoint],
    together: Sequence[str],
    *,
    imus: bool,
    min_speeds: int = 3,
    max_share: float = 0.25,  # of the speed limit, up to which moves show gravity well
) -> list[str]:
    """Return the stages that a log serves; `together` move joints with others."""
    stages: list[str] = []
    torque = any(joint.effort for joint in joints)
    for j, joint in enumerate(robot.joints):
        mine = [s for s in stretches if s.joint == j]
        speeds = [abs(s.velocity) for s in mine]
        if not torque or len({np.sign(s.velocity) for s in mine}) < 2:
            continue
        if _speeds(speeds) >= min_speeds:
            stages.append("friction")
        slow = max(speeds) < max_share * (joint.velocity_limit or 1.0)
        if robot.gravity.any() and (slow or _postures(mine, j) > 1):
            stages.append("gravity")
    if imus and sum(joint.moves for joint in joints) == 1:
        stages.append("imu-calib")
    if torque and (len(together) >= 2 or (robot.n == 1 and joints[0].moves)):
        stages.append("inertia")
    return list(dict.fromkeys(stages))


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


class Inspected(NamedTuple):
    """One log and its findings."""

    log: InspectedLog
    findings: tuple[InspectionFinding, ...]


Gap = tuple[float, float]
V = TypeVar("V", InspectedJoint, InspectedImu)


@dataclass(frozen=True)
class Part:
    """What one part of a log shows; times are those of the whole log, s."""

    health: Health
    partial: str
    samples: int  # that the part before has not seen
    gaps: list[Gap]  # of the time base, and those without a row
    row_gaps: list[Gap]
    joints: list[InspectedJoint]
    imus: list[InspectedImu]
    together: Array  # (n + 1,) samples: each joint with others, any
    findings: tuple[InspectionFinding, ...]


@dataclass
class Gathered:
    """Takes the parts of a log in their order."""

    robot: Robot
    modelled: bool = True
    begun: float = 0.0  # s, of the log's clock
    end: float = -1.0  # of the parts so far, s since then
    sha256: str = ""
    parts: list[Part] = field(default_factory=list)
    lost: list[InputError] = field(default_factory=list)
    stretches: list[Stretch] = field(default_factory=list)

    def push(self, data: LogData) -> None:
        """Take the next part."""
        recording, known = data.recording, self.end
        if not self.parts:
            self.begun, self.sha256 = recording.start, recording.sha256
        offset = recording.start - self.begun
        self.end = offset + float(recording.t[-1])
        checked = check(data)
        self._add_stretches(data, offset, known)
        moved = [(start + offset, stop + offset) for start, stop in recording.health.gaps]
        several = data.moving & (data.moving.sum(axis=1, keepdims=True) >= 2)
        part = Part(
            health=recording.health,
            partial=recording.partial,
            samples=int(np.count_nonzero(recording.t + offset > known)),
            gaps=[gap for gap in moved if gap[1] > known + 1e-6],
            row_gaps=[gap for gap in gaps_of(data) if gap[1] > known + 1e-6],
            joints=[_joint(data, j) for j in range(self.robot.n)],
            imus=[*_imus(data, checked.following)],
            together=np.append(several.sum(axis=0), data.moving.any(axis=1).sum()),
            findings=checked.findings,
        )
        self.parts.append(part)

    def failed(self, error: InputError, joints: Stream) -> None:
        """Take note of a part of no use."""
        first, last = (float(joints.stamp_ns[k]) * 1e-9 - self.begun for k in (0, -1))
        where = f"from {first:.3f} to {last:.3f} s: " if self.parts else "at the start: "
        self.lost.append(InputError(where + error.message, hint=error.hint, where=error.where))

    def _add_stretches(self, data: LogData, offset: float, known: float) -> None:
        """Take stretches of constant velocity; one that the part before ends with goes on."""
        recording, rate = data.recording, data.recording.rate_hz
        rows = round(offset * rate)
        last = {s.joint: s for s in self.stretches}
        for one in constant_velocity(recording.q, rate, step=data.step, valid=recording.valid):
            moved = replace(one, start=one.start + rows, stop=one.stop + rows)
            before = last.get(one.joint)
            goes_on = before is not None and before.velocity * one.velocity > 0.0
            if before is None or not goes_on or moved.start > min(before.stop, known * rate):
                self.stretches.append(moved)

    def log(self, path: object, form: str, before: Sequence[InspectionFinding]) -> Inspected:
        """Tell what is in the log, and its faults; `before` are those that were found first.

        Raises InputError: no part is of use.
        """
        if not self.parts:
            raise self.lost[0]
        parts = self.parts
        same = grouped(finding for part in parts for finding in part.findings)
        lost = (found("channel_hole", error.message) for error in self.lost)
        findings = located((*before, *map(self._told, same), *lost), path)
        health, samples = [part.health for part in parts], [part.samples for part in parts]
        delays = [h.log_minus_header_s for h in health if h.log_minus_header_s is not None]
        by_joint = zip(*(part.joints for part in parts), strict=True)
        joints = [_merged(own, samples, _JOINT) for own in by_joint]
        by_imu: dict[str, list[InspectedImu]] = {}
        for imu in (imu for part in parts for imu in part.imus):
            by_imu.setdefault(imu.name, []).append(imu)
        imus = [_merged(own, [1] * len(own), _IMU) for own in by_imu.values()]
        *each, moving = np.sum([part.together for part in parts], axis=0)
        together = [
            name
            for name, count in zip(self.robot.joint_names, each, strict=True)
            if count > TOGETHER * max(moving, 1.0)
        ]
        serves = _serves(self.robot, self.stretches, joints, together, imus=bool(imus))
        log = InspectedLog(
            path=str(path),
            sha256=self.sha256,
            format=form,
            verdict=verdict_of(findings),
            samples=sum(samples),
            seconds=self.end,
            rate_hz=sum(samples) / sum(n / h.rate_hz for n, h in zip(samples, health, strict=True)),
            jitter=_rms([h.jitter for h in health], samples),
            gaps=[list(gap) for part in parts for gap in part.gaps],
            non_monotonic=sum(h.non_monotonic for h in health),
            duplicates=sum(h.duplicates for h in health),
            log_minus_header_s=float(np.median(delays)) if delays else None,
            joints=joints,
            imus=imus,
            moves=[*_moves(self.robot, self.stretches)],
            moving_together=together,
            serves=serves if self.modelled else [],
            partial="; ".join(part.partial for part in parts if part.partial),
        )
        return Inspected(log, findings)

    def _told(self, alike: Sequence[InspectionFinding]) -> InspectionFinding:
        """A finding of several parts, told once."""
        first, count = alike[0], len(self.parts)
        if first.code == "clock_gap":
            return gap_finding([gap for part in self.parts for gap in part.row_gaps])
        if all(one.message == first.message for one in alike) and len(alike) == count:
            return first
        message = f"{first.message} (of {count} parts of the log {len(alike)} show it)"
        return structs.replace(first, message=message)


def _joint(data: LogData, j: int) -> InspectedJoint:
    """Describe what a part shows of a joint."""
    quantity, torques = data.effort() or ("", None)
    channels, moves = data.joints.channels, data.moves(j)
    given = (channels["position"], torques, channels.get("temperature"))
    columns = [np.zeros(0) if values is None else values[:, j] for values in given]
    q, values, warm = (column[np.isfinite(column)] for column in columns)
    return InspectedJoint(
        name=data.robot.joint_names[j],
        moves=moves,
        low=float(q.min()),
        high=float(q.max()),
        top_speed=top_speed(data, j) if moves else 0.0,
        encoder_step=lattice(q) or None,
        effort=quantity if len(values) else "",
        effort_rms=float(np.sqrt(np.mean(values**2))) if len(values) else None,
        temperature=[float(warm.min()), float(warm.max())] if len(warm) else None,
    )


def _imus(data: LogData, following: Sequence[Following]) -> Iterator[InspectedImu]:
    """Describe what a part shows of each IMU."""
    for imu in data.robot.imus:
        values = data.recording.accelerometers.get(imu.name)
        gyro = imu.name in data.recording.gyros
        if values is None and not gyro:
            continue
        streams = data.raw.imus.get(imu.name, ())
        spans = [float(np.median(np.diff(s.stamp_ns))) for s in streams if len(s) > 1]
        seen = values is not None and np.linalg.matrix_rank(imu.axes) == 3
        rest = rest_rows(data, values) if values is not None and seen else np.zeros((0, 3))
        yield InspectedImu(
            name=imu.name,
            accelerometers=0 if values is None else values.shape[1],
            gyro=gyro,
            rate_hz=1e9 / max(spans) if spans and max(spans) > 0 else 0.0,
            rest_norm=force_of(imu, rest) if len(rest) else None,
            delay_s=next((f.fit.delay for f in following if f.imu.name == imu.name), None),
        )


def _rms(values: Sequence[float], samples: Sequence[int]) -> float:
    return float(np.sqrt(np.average(np.square(values), weights=samples)))


def _median(values: Sequence[float], samples: Sequence[int]) -> float:
    return float(np.median(values))


# How the fields of parts become those of the log: by their values and numbers of samples.
_JOINT: Mapping[str, Callable[..., object]] = {
    "moves": lambda moves, _: any(moves),
    "low": lambda low, _: min(low),
    "high": lambda high, _: max(high),
    "top_speed": lambda speeds, _: max(speeds),
    "encoder_step": _median,
    "effort": lambda quantities, _: next(filter(None, quantities), ""),
    "effort_rms": _rms,
    "temperature": lambda spans, _: [min(s[0] for s in spans), max(s[1] for s in spans)],
}
_IMU: Mapping[str, Callable[..., object]] = {
    "accelerometers": lambda counts, _: max(counts),
    "gyro": lambda there, _: any(there),
    "rate_hz": _median,
    "rest_norm": _median,
    "delay_s": _median,
}


def _merged(
    parts: Sequence[V], samples: Sequence[int], rules: Mapping[str, Callable[..., object]]
) -> V:
    """One joint or IMU of all parts; what a part does not know does not count."""
    fields: dict[str, object] = {}
    for name, rule in rules.items():
        pairs = zip((getattr(part, name) for part in parts), samples, strict=True)
        known = [(value, count) for value, count in pairs if value is not None]
        fields[name] = rule(*zip(*known, strict=True)) if known else None
    return structs.replace(parts[0], **fields)
