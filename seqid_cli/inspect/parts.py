"""An inspected log, gathered part by part: what moves, which stages it serves, its faults.

A short log is one part. Of the parts of a long one counts, ranges and means are merged;
a finding of several parts is told once, with its first place and how many parts show
it.
"""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import NamedTuple, TypeVar

import numpy as np
from msgspec import structs

from seqid_cli.errors import InputError
from seqid_cli.inspect.channels.positions import top_speed
from seqid_cli.inspect.channels.values import lattice
from seqid_cli.inspect.checks import check
from seqid_cli.inspect.findings import found, grouped, located, verdict_of
from seqid_cli.inspect.imu.motion import LinkFit
from seqid_cli.inspect.imu.readings import force_of, rest_rows
from seqid_cli.inspect.material import LogData
from seqid_cli.logs.raw import Stream
from seqid_cli.motion.segmentation import Stretch, constant_velocity
from seqid_cli.params.dates import recorded_between
from seqid_cli.params.results import inspection as schema
from seqid_cli.params.results.inspection import (
    InspectedImu,
    InspectedLog,
    InspectionFinding,
)
from seqid_cli.robot.types import Array, Robot


def _moves(
    robot: Robot, stretches: Sequence[Stretch]
) -> Iterator[schema.InspectedMoves]:
    """Summarise the constant-velocity stretches of each joint."""
    for j, name in enumerate(robot.joint_names):
        own = [s for s in stretches if s.joint == j]
        if own:
            yield schema.InspectedMoves(
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


def _moving_together(
    robot: Robot, counts: Array, *, min_share: float = 0.1
) -> list[str]:
    """Joints that move with others for a fair share of the samples (n + 1,) with motion."""
    *each, moving = counts
    names = zip(robot.joint_names, each, strict=True)
    return [name for name, count in names if count > min_share * max(moving, 1.0)]


def serve_together(
    logs: Sequence[InspectedLog], *, min_speeds: int = 3
) -> list[InspectedLog]:
    """Add `friction` to logs that serve it together, such as one log per speed.

    That is of joints for which no log serves it alone, by logs with a speed of them,
    both ways.
    """
    alone = {m.joint for log in logs if "friction" in log.serves for m in log.moves}
    speeds: dict[str, list[float]] = {}
    for move in (move for log in logs for move in _both_ways(log)):
        speeds.setdefault(move.joint, []).extend((move.slowest, move.fastest))
    added = {
        j for j, own in speeds.items() if j not in alone and _speeds(own) >= min_speeds
    }
    return [
        (
            structs.replace(log, serves=["friction", *log.serves])
            if any(move.joint in added for move in _both_ways(log))
            and "friction" not in log.serves
            else log
        )
        for log in logs
    ]


def _both_ways(log: InspectedLog) -> list[schema.InspectedMoves]:
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
    """One log, its findings, and its first and last stamp [s, its own clock]."""

    log: InspectedLog
    findings: tuple[InspectionFinding, ...]
    stamps_s: tuple[float, float] | None = None


V = TypeVar("V", InspectedLog, schema.InspectedJoint, InspectedImu)


@dataclass
class Gathered:
    """Takes the parts of a log in their order; each begins with the end of the one before."""

    robot: Robot
    modelled: bool = True
    begun: float = 0.0  # s, of the log's clock
    parts: list[InspectedLog] = field(default_factory=list)
    findings: list[InspectionFinding] = field(default_factory=list)
    stretches: list[Stretch] = field(default_factory=list)
    lost: list[InputError] = field(default_factory=list)
    together: Array | int = 0  # (n + 1,) samples: each joint with others, any

    @property
    def end(self) -> float:
        """End of the parts so far, s since the log's begin."""
        return self.parts[-1].seconds if self.parts else -1.0

    def push(self, data: LogData) -> None:
        """Take the next part; `seconds` of it is where it ends in the log."""
        recording, health, end = data.recording, data.recording.health, self.end
        self.begun = self.begun if self.parts else recording.start
        offset = recording.start - self.begun
        _, findings, following = check(data)
        self.findings += findings
        self._add_stretches(data, offset)
        several = data.moving & (data.moving.sum(axis=1, keepdims=True) >= 2)
        counts = np.append(several.sum(axis=0), data.moving.any(axis=1).sum())
        self.together = self.together + counts.astype(np.float64)
        part = InspectedLog(
            path=str(recording.path),
            sha256=recording.sha256,
            format=recording.format,
            verdict="",
            samples=int(np.count_nonzero(recording.t + offset > end)),
            seconds=offset + float(recording.t[-1]),
            rate_hz=health.rate_hz,
            jitter=health.jitter,
            gaps=[
                [a + offset, b + offset]
                for a, b in health.gaps
                if b + offset > end + 1e-6
            ],
            non_monotonic=health.non_monotonic,
            duplicates=health.duplicates,
            log_minus_header_s=health.log_minus_header_s,
            joints=[_joint(data, j) for j in range(self.robot.n)],
            imus=[*_imus(data, following)],
            partial=recording.partial,
        )
        self.parts.append(part)

    def failed(self, error: InputError, joints: Stream) -> None:
        """Take note of a part of no use."""
        first, last = (float(joints.stamp_ns[k]) * 1e-9 - self.begun for k in (0, -1))
        where = (
            f"from {first:.3f} to {last:.3f} s: " if self.parts else "at the start: "
        )
        self.lost.append(
            InputError(where + error.message, hint=error.hint, where=error.where)
        )

    def _add_stretches(self, data: LogData, offset: float) -> None:
        """Take stretches of constant velocity; one that the part before ends with goes on."""
        recording, rate = data.recording, data.recording.rate_hz
        rows = round(offset * rate)
        last = {s.joint: s for s in self.stretches}
        for one in constant_velocity(
            recording.q, rate, step=data.step, valid=recording.valid
        ):
            moved = replace(one, start=one.start + rows, stop=one.stop + rows)
            before = last.get(one.joint)
            goes_on = before is not None and before.velocity * one.velocity > 0.0
            if (
                before is None
                or not goes_on
                or moved.start > min(before.stop, self.end * rate)
            ):
                self.stretches.append(moved)

    def log(
        self, path: object, form: str, before: Sequence[InspectionFinding]
    ) -> Inspected:
        """Tell what is in the log, and its faults; raises InputError if no part is of use."""
        if not self.parts:
            raise self.lost[0]
        lost = (found("channel_hole", error.message) for error in self.lost)
        findings = located(
            (*before, *map(self._told, grouped(self.findings)), *lost), path
        )
        samples = [part.samples for part in self.parts]
        stamps_s = (self.begun, self.begun + self.end)
        each_joint = zip(*(part.joints for part in self.parts), strict=True)
        by_imu: dict[str, list[InspectedImu]] = {}
        for imu in (imu for part in self.parts for imu in part.imus):
            by_imu.setdefault(imu.name, []).append(imu)
        log = structs.replace(
            _merged(self.parts, samples),
            path=str(path),
            format=form,
            verdict=verdict_of(findings),
            seconds=self.end,
            recorded=recorded_between(*stamps_s),
            rate_hz=sum(samples)
            / float(np.sum(np.divide(samples, [p.rate_hz for p in self.parts]))),
            joints=[_merged(own, samples) for own in each_joint],
            imus=[_merged(own, [1] * len(own)) for own in by_imu.values()],
            moves=[*_moves(self.robot, self.stretches)],
            moving_together=_moving_together(self.robot, np.asarray(self.together)),
        )
        log.serves = self._serves(log) if self.modelled else []
        return Inspected(log, findings, stamps_s)

    def _serves(
        self, log: InspectedLog, *, min_speeds: int = 3, max_share: float = 0.25
    ) -> list[str]:
        """Return the stages that a log serves."""
        stages: list[str] = []
        torque = any(joint.effort for joint in log.joints)
        for j, joint in enumerate(self.robot.joints):
            mine = [s for s in self.stretches if s.joint == j]
            speeds = [abs(s.velocity) for s in mine]
            if not torque or len({np.sign(s.velocity) for s in mine}) < 2:
                continue
            if _speeds(speeds) >= min_speeds:
                stages.append("friction")
            slow = max(speeds) < max_share * (joint.velocity_limit or 1.0)
            if self.robot.gravity.any() and (slow or _postures(mine, j) > 1):
                stages.append("gravity")
        if log.imus and sum(joint.moves for joint in log.joints) == 1:
            stages.append("imu-calib")
        if torque and (
            len(log.moving_together) >= 2 or (self.robot.n == 1 and log.joints[0].moves)
        ):
            stages.append("inertia")
        return list(dict.fromkeys(stages))

    def _told(self, alike: Sequence[InspectionFinding]) -> InspectionFinding:
        """A finding of several parts, told once."""
        first, count = alike[0], len(self.parts)
        if all(one.message == first.message for one in alike) and len(alike) == count:
            return first
        message = f"{first.message} (of {count} parts of the log {len(alike)} show it)"
        return structs.replace(first, message=message)


def _joint(data: LogData, j: int) -> schema.InspectedJoint:
    """Describe what a part shows of a joint."""
    quantity, torques = data.effort() or ("", None)
    channels, moves = data.joints.channels, data.moves(j)
    given = (channels["position"], torques, channels.get("temperature"))
    columns = [np.zeros(0) if values is None else values[:, j] for values in given]
    q, values, warm = (column[np.isfinite(column)] for column in columns)
    return schema.InspectedJoint(
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


def _imus(data: LogData, following: Sequence[LinkFit]) -> Iterator[InspectedImu]:
    """Describe what a part shows of each IMU."""
    for imu in data.robot.imus:
        values = data.recording.accelerometers.get(imu.name)
        gyro = imu.name in data.recording.gyros
        if values is None and not gyro:
            continue
        streams = data.raw.imus.get(imu.name, ())
        spans = [float(np.median(np.diff(s.stamp_ns))) for s in streams if len(s) > 1]
        seen = values is not None and np.linalg.matrix_rank(imu.axes) == 3
        rest = (
            rest_rows(data, values) if values is not None and seen else np.zeros((0, 3))
        )
        yield InspectedImu(
            name=imu.name,
            accelerometers=0 if values is None else values.shape[1],
            gyro=gyro,
            rate_hz=1e9 / max(spans) if spans and max(spans) > 0 else 0.0,
            rest_norm=force_of(imu, rest) if len(rest) else None,
            delay_s=next((f.delay for f in following if f.imu.name == imu.name), None),
        )


def _rms(values: Sequence[float], samples: Sequence[int]) -> float:
    return float(np.sqrt(np.average(np.square(values), weights=samples)))


# How fields of parts become those of the log, its joints and IMUs: by value and
# samples.
_RULES: Mapping[str, Callable[..., object]] = {
    **dict.fromkeys(
        ("samples", "non_monotonic", "duplicates"), lambda own, _: sum(own)
    ),
    **dict.fromkeys(("high", "top_speed", "accelerometers"), lambda own, _: max(own)),
    **dict.fromkeys(("moves", "gyro"), lambda own, _: any(own)),
    **dict.fromkeys(
        ("log_minus_header_s", "encoder_step", "rate_hz", "rest_norm", "delay_s"),
        lambda own, _: float(np.median(own)),
    ),
    **dict.fromkeys(("jitter", "effort_rms"), _rms),
    "low": lambda own, _: min(own),
    "gaps": lambda own, _: [gap for gaps in own for gap in gaps],
    "partial": lambda own, _: "; ".join(filter(None, own)),
    "effort": lambda own, _: next(filter(None, own), ""),
    "temperature": lambda own, _: [
        min(low for low, _ in own),
        max(high for _, high in own),
    ],
}


def _merged(parts: Sequence[V], samples: Sequence[int]) -> V:
    """What all parts show of a log, a joint or an IMU; what a part does not know does not count."""
    fields: dict[str, object] = {}
    for name in _RULES.keys() & set(parts[0].__struct_fields__):
        pairs = zip((getattr(part, name) for part in parts), samples, strict=True)
        known = [(value, count) for value, count in pairs if value is not None]
        fields[name] = _RULES[name](*zip(*known, strict=True)) if known else None
    return structs.replace(parts[0], **fields)
