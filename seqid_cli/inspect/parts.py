"""An inspected log, gathered part by part: what moves in it, and its faults.

A short log is one part. Of the parts of a long one counts, ranges and means are merged;
a finding of several parts is reported once, with its first place and how many parts
show it.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace
from typing import NamedTuple

import numpy as np
from msgspec import structs

from seqid_cli.errors import InputError
from seqid_cli.inspect.channels.commands import commands_of
from seqid_cli.inspect.channels.positions import top_speed
from seqid_cli.inspect.channels.values import lattice
from seqid_cli.inspect.checks import check
from seqid_cli.inspect.findings import finding_of, grouped, located, verdict_of
from seqid_cli.inspect.imu.motion import LinkFit
from seqid_cli.inspect.imu.readings import force_of, rest_rows
from seqid_cli.inspect.material import LogData
from seqid_cli.inspect.merging import merged
from seqid_cli.inspect.serves import moves_of, moving_together, served_stages
from seqid_cli.logs.raw import Stream
from seqid_cli.motion.segmentation import Stretch, constant_velocity
from seqid_cli.params.dates import recorded_between
from seqid_cli.params.results.inspection import (
    InspectedImu,
    InspectedJoint,
    InspectedLog,
    InspectionFinding,
)
from seqid_cli.robot.types import Array, Imu, Robot


class Inspected(NamedTuple):
    """One log and what was found in it.

    Attributes
    ----------
    log : InspectedLog
        What it holds.
    findings : tuple of InspectionFinding
        What is wrong with it.
    stamps_s : tuple of float, optional
        Its first and last stamp [s, its own clock].
    names : frozenset of str
        Joints in the messages of all parts; empty where these are not known.
    """

    log: InspectedLog
    findings: tuple[InspectionFinding, ...]
    stamps_s: tuple[float, float] | None = None
    names: frozenset[str] = frozenset()


@dataclass(kw_only=True)
class Gathered:
    """The parts of a log so far, taken in their order.

    Each part begins with the end of the one before. `modelled`: whether the robot's
    geometry is known.
    """

    robot: Robot
    modelled: bool = True
    start_s: float = 0.0  # of the log, on its own clock
    parts: list[InspectedLog] = field(default_factory=list)
    findings: list[InspectionFinding] = field(default_factory=list)
    stretches: list[Stretch] = field(default_factory=list)
    lost: list[InputError] = field(default_factory=list)  # parts of no use
    # (n + 1,) samples: each joint with others, any joint
    moving_counts: Array | int = 0

    @property
    def end(self) -> float:
        """End of the parts so far, s since the log's begin."""
        return self.parts[-1].seconds if self.parts else -1.0

    def push(self, data: LogData) -> None:
        """Take the next part; its `seconds` are where it ends in the log."""
        recording = data.recording
        health = recording.health
        if not self.parts:
            self.start_s = recording.start
        offset = recording.start - self.start_s
        end = self.end

        _, findings, link_fits = check(data)
        self.findings += findings
        self._add_stretches(data, offset)
        self._count_moving(data)
        # What the part before has shown already does not count twice.
        n_new_samples = int(np.count_nonzero(recording.t + offset > end))
        new_gaps = [
            [a + offset, b + offset] for a, b in health.gaps if b + offset > end + 1e-6
        ]
        part = InspectedLog(
            path=str(recording.path),
            sha256=recording.sha256,
            format=recording.format,
            verdict="",
            samples=n_new_samples,
            seconds=offset + float(recording.t[-1]),
            rate_hz=health.rate_hz,
            jitter=health.jitter,
            gaps=new_gaps,
            non_monotonic=health.non_monotonic,
            duplicates=health.duplicates,
            log_minus_header_s=health.log_minus_header_s,
            joints=[_joint(data, j) for j in range(self.robot.n)],
            imus=[*_imus(data, link_fits)],
            partial=recording.partial,
        )
        self.parts.append(part)

    def failed(self, error: InputError, joints: Stream) -> None:
        """Take note of a part of no use, which holds these joint samples."""
        first_s = float(joints.stamp_ns[0]) * 1e-9 - self.start_s
        last_s = float(joints.stamp_ns[-1]) * 1e-9 - self.start_s
        where = "at the start: "
        if self.parts:
            where = f"from {first_s:.3f} to {last_s:.3f} s: "
        self.lost.append(
            InputError(where + error.message, hint=error.hint, where=error.where)
        )

    def _add_stretches(self, data: LogData, offset: float) -> None:
        """Take stretches of constant velocity, those anew that begin in this part."""
        recording = data.recording
        rate_hz = recording.rate_hz
        offset_rows = round(offset * rate_hz)
        last_of_joint = {stretch.joint: stretch for stretch in self.stretches}
        for stretch in constant_velocity(
            recording.q,
            rate_hz,
            step=data.step,
            valid=recording.valid,
            moving=data.moving,
        ):
            moved = replace(
                stretch,
                start=stretch.start + offset_rows,
                stop=stretch.stop + offset_rows,
            )
            last = last_of_joint.get(stretch.joint)
            if last is None or not self._goes_on(last, moved, rate_hz):
                self.stretches.append(moved)

    def _goes_on(self, last: Stretch, stretch: Stretch, rate_hz: float) -> bool:
        """Return whether a stretch is the one that the part before has ended with."""
        same_direction = last.velocity * stretch.velocity > 0.0
        return same_direction and stretch.start <= min(last.stop, self.end * rate_hz)

    def _count_moving(self, data: LogData) -> None:
        """Count samples at which joints move with others, and at which any moves."""
        n_moving = data.moving.sum(axis=1, keepdims=True)
        with_others = data.moving & (n_moving >= 2)
        any_moves = data.moving.any(axis=1)
        counts = np.append(with_others.sum(axis=0), any_moves.sum())
        self.moving_counts = self.moving_counts + counts.astype(np.float64)

    def log(
        self, path: object, form: str, earlier_findings: Sequence[InspectionFinding]
    ) -> Inspected:
        """Return what is in the log, and its faults.

        Parameters
        ----------
        path : path
            The log, as it was given.
        form : str
            Its format.
        earlier_findings : sequence of InspectionFinding
            Findings from before it was read.

        Raises
        ------
        InputError
            No part is of use.
        """
        if not self.parts:
            raise self.lost[0]
        of_parts = [self._once(group) for group in grouped(self.findings)]
        of_lost = [finding_of("channel_hole", error.message) for error in self.lost]
        findings = located((*earlier_findings, *of_parts, *of_lost), path)

        samples = [part.samples for part in self.parts]
        seconds_of_parts = np.divide(samples, [part.rate_hz for part in self.parts])
        stamps_s = (self.start_s, self.start_s + self.end)
        log = structs.replace(
            merged(self.parts, samples),
            path=str(path),
            format=form,
            verdict=verdict_of(findings),
            seconds=self.end,
            recorded=recorded_between(*stamps_s),
            rate_hz=sum(samples) / float(np.sum(seconds_of_parts)),
            joints=self._merged_joints(samples),
            imus=self._merged_imus(),
            moves=[*moves_of(self.robot, self.stretches)],
            moving_together=moving_together(self.robot, np.asarray(self.moving_counts)),
        )
        if self.modelled:
            log.serves = served_stages(self.robot, log, self.stretches)
        return Inspected(log, findings, stamps_s)

    def _merged_joints(self, samples: Sequence[int]) -> list[InspectedJoint]:
        """Return what all parts show of each joint."""
        by_joint = zip(*(part.joints for part in self.parts), strict=True)
        return [merged(of_joint, samples) for of_joint in by_joint]

    def _merged_imus(self) -> list[InspectedImu]:
        """Return what all parts show of each IMU, which not every part need have."""
        by_imu: dict[str, list[InspectedImu]] = {}
        for part in self.parts:
            for imu in part.imus:
                by_imu.setdefault(imu.name, []).append(imu)
        return [merged(of_imu, [1] * len(of_imu)) for of_imu in by_imu.values()]

    def _once(self, group: Sequence[InspectionFinding]) -> InspectionFinding:
        """Return a finding of several parts as one."""
        first = group[0]
        count = len(self.parts)
        same_message = all(finding.message == first.message for finding in group)
        if same_message and len(group) == count:
            return first
        message = f"{first.message} (of {count} parts of the log {len(group)} show it)"
        return structs.replace(first, message=message)


def _joint(data: LogData, j: int) -> InspectedJoint:
    """Describe what a part shows of a joint."""
    quantity, efforts = data.effort() or ("", None)
    q = _finite(data.joints.channels["position"], j)
    effort = _finite(efforts, j)
    temperature = _finite(data.joints.channels.get("temperature"), j)
    moves = data.moves(j)

    return InspectedJoint(
        name=data.robot.joint_names[j],
        moves=moves,
        low=float(q.min()),
        high=float(q.max()),
        top_speed=top_speed(data, j) if moves else 0.0,
        encoder_step=lattice(q) or None,
        effort=quantity if len(effort) else "",
        effort_rms=float(np.sqrt(np.mean(effort**2))) if len(effort) else None,
        temperature=(
            [float(temperature.min()), float(temperature.max())]
            if len(temperature)
            else None
        ),
        command=commands_of(data, j),
    )


def _finite(values: Array | None, j: int) -> Array:
    """Return the finite values (K,) of a joint; none where there is no such channel."""
    if values is None:
        return np.zeros(0)
    column = values[:, j]
    return np.asarray(column[np.isfinite(column)])


def _imus(data: LogData, link_fits: Sequence[LinkFit]) -> Iterator[InspectedImu]:
    """Describe what a part shows of each IMU."""
    for imu in data.robot.imus:
        values = data.recording.accelerometers.get(imu.name)
        has_gyro = imu.name in data.recording.gyros
        if values is None and not has_gyro:
            continue
        delays = [fit.delay for fit in link_fits if fit.imu.name == imu.name]
        yield InspectedImu(
            name=imu.name,
            accelerometers=0 if values is None else values.shape[1],
            gyro=has_gyro,
            rate_hz=data.recording.health.imu_rates_hz.get(imu.name, 0.0),
            rest_norm=_rest_norm(data, imu, values),
            delay_s=delays[0] if delays else None,
        )


def _rest_norm(data: LogData, imu: Imu, values: Array | None) -> float | None:
    """Return the specific force at rest, m/s^2; None where the axes do not give it."""
    if values is None or np.linalg.matrix_rank(imu.axes) != 3:
        return None
    rest = rest_rows(data, values)
    return force_of(imu, rest) if len(rest) else None
