"""Which joints move how, and which stage a log serves."""

from collections.abc import Sequence

import numpy as np
from msgspec.structs import replace

from seqid_cli.inspect.channels.positions import top_speed
from seqid_cli.inspect.channels.values import lattice
from seqid_cli.inspect.imu.motion import Following
from seqid_cli.inspect.imu.readings import force_of, rest_rows
from seqid_cli.inspect.material import LogData, Mask
from seqid_cli.motion.segmentation import Stretch
from seqid_cli.params.results.inspection import (
    InspectedImu,
    InspectedJoint,
    InspectedLog,
    InspectedMoves,
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
