"""Which joints move how, and which stage a log serves."""

from collections.abc import Sequence

import numpy as np
from msgspec.structs import replace

from seqid_cli.inspect.channels.positions import top_speed
from seqid_cli.inspect.channels.values import lattice
from seqid_cli.inspect.imu.motion import Following
from seqid_cli.inspect.imu.readings import force_of, rest_rows
from seqid_cli.inspect.material import LogData, Mask
from seqid_cli.motion.segmentation import Stretch, constant_velocity
from seqid_cli.params.results.inspection import (
    InspectedImu,
    InspectedJoint,
    InspectedLog,
    InspectedMoves,
)
from seqid_cli.robot.types import Array, Robot


def stretches_of(data: LogData) -> list[Stretch]:
    """Find the constant-velocity stretches of a log."""
    recording = data.recording
    return constant_velocity(recording.q, recording.rate_hz, step=data.step, valid=recording.valid)


def joint_summaries(data: LogData) -> list[InspectedJoint]:
    """Describe what the log shows of each joint."""
    effort = data.effort()
    temperature = data.joints.channels.get("temperature")
    result = []
    for j, name in enumerate(data.robot.joint_names):
        q = data.joints.channels["position"][:, j]
        q = q[np.isfinite(q)]
        values = effort[1][:, j] if effort else np.zeros(0)
        values = values[np.isfinite(values)]
        warm = (
            temperature[np.isfinite(temperature[:, j]), j]
            if temperature is not None
            else values[:0]
        )
        result.append(
            InspectedJoint(
                name=name,
                moves=data.moves(j),
                low=float(q.min()),
                high=float(q.max()),
                top_speed=top_speed(data, j) if data.moves(j) else 0.0,
                encoder_step=lattice(q) or None,
                effort=effort[0] if effort and len(values) else "",
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
        spans = [np.median(np.diff(s.stamp_ns)) * 1e-9 for s in streams if len(s) > 1]
        norm = None
        if values is not None and np.linalg.matrix_rank(imu.axes) == 3:
            rest = rest_rows(data, values)
            norm = force_of(imu, rest) if len(rest) else None
        delay = next((f.fit.delay for f in following if f.imu.name == imu.name), None)
        count = 0 if values is None else values.shape[1]
        rate = 1.0 / float(max(spans)) if spans and max(spans) > 0 else 0.0
        result.append(
            InspectedImu(
                name=imu.name,
                accelerometers=count,
                gyro=gyro,
                rate_hz=rate,
                rest_norm=norm,
                delay_s=delay,
            )
        )
    return result


def moves_of(robot: Robot, stretches: Sequence[Stretch]) -> list[InspectedMoves]:
    """Summarise the constant-velocity stretches of each joint."""
    result = []
    for j, name in enumerate(robot.joint_names):
        mine = [s for s in stretches if s.joint == j]
        if mine:
            speeds = [abs(s.velocity) for s in mine]
            forward = sum(s.velocity > 0 for s in mine)
            result.append(
                InspectedMoves(
                    joint=name,
                    forward=forward,
                    backward=len(mine) - forward,
                    slowest=min(speeds),
                    fastest=max(speeds),
                    postures=len(_postures(mine, j)),
                )
            )
    return result


def _postures(stretches: list[Stretch], joint: int, *, same: float = 0.03) -> list[Array]:
    """List the different postures of the locked joints."""
    found: list[Array] = []
    for stretch in stretches:
        others = np.delete(np.array(stretch.configuration), joint)
        if not any(np.abs(others - known).max(initial=0.0) < same for known in found):
            found.append(others)
    return found


def together(moving: Mask) -> Array:
    """Count the samples at which each joint moves with others, and at which any moves, (n + 1,)."""
    several = moving.sum(axis=1) >= 2
    with_others = (moving & several[:, None]).sum(axis=0)
    return np.append(with_others, moving.any(axis=1).sum()).astype(np.float64)


def moving_together(robot: Robot, counts: Array, *, min_share: float = 0.1) -> tuple[str, ...]:
    """Return the joints that move with others for a fair share of the time, by `together`."""
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
) -> tuple[str, ...]:
    """Return the stages that a log serves.

    `moving`: which joints move. `several`: those that move with others. `torque`, `imus`: whether
    the log has them.
    """
    stages: list[str] = []
    for j in range(robot.n):
        mine = [s for s in stretches if s.joint == j]
        ways = {np.sign(s.velocity) for s in mine}
        if not torque or len(ways) < 2:
            continue
        if _speeds([abs(s.velocity) for s in mine]) >= min_speeds:
            stages.append("friction")
        if robot.gravity.any() and (len(_postures(mine, j)) > 1 or _is_slow(robot, j, mine)):
            stages.append("gravity")
    if imus and sum(moving) == 1:
        stages.append("imu-calib")
    if torque and (len(several) >= 2 or (robot.n == 1 and moving[0])):
        stages.append("inertia")
    return tuple(dict.fromkeys(stages))


def serve_together(logs: Sequence[InspectedLog], *, min_speeds: int = 3) -> list[InspectedLog]:
    """Add `friction` to logs that serve it together, such as one log per speed.

    That is of joints for which no log serves it by itself: logs that hold at least one speed of
    such a joint, both ways, with its torque. Together they need `min_speeds`.
    """
    alone = {m.joint for log in logs if "friction" in log.serves for m in log.moves}
    speeds: dict[str, list[float]] = {}
    for log in logs:
        for move in _both_ways(log):
            speeds.setdefault(move.joint, []).extend((move.slowest, move.fastest))
    added = {j for j, own in speeds.items() if j not in alone and _speeds(own) >= min_speeds}
    return [
        replace(log, serves=["friction", *log.serves])
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


def _is_slow(robot: Robot, j: int, stretches: list[Stretch], *, max_share: float = 0.25) -> bool:
    limit = robot.joints[j].velocity_limit or 1.0
    return max(abs(s.velocity) for s in stretches) < max_share * limit
