"""The stages that a log serves, by what moves in it and how."""

from collections.abc import Iterator, Sequence

import numpy as np
from msgspec import structs

from seqid_cli.motion.segmentation import Stretch
from seqid_cli.params.results.inspection import InspectedLog, InspectedMoves
from seqid_cli.robot.types import Array, Robot


def moves_of(robot: Robot, stretches: Sequence[Stretch]) -> Iterator[InspectedMoves]:
    """Summarise the constant-velocity stretches of each joint."""
    for j, name in enumerate(robot.joint_names):
        of_joint = [stretch for stretch in stretches if stretch.joint == j]
        if not of_joint:
            continue
        speeds = [abs(stretch.velocity) for stretch in of_joint]
        n_forward = sum(stretch.velocity > 0 for stretch in of_joint)
        yield InspectedMoves(
            joint=name,
            forward=n_forward,
            backward=len(of_joint) - n_forward,
            slowest=min(speeds),
            fastest=max(speeds),
            postures=_postures(of_joint, j),
        )


def _postures(stretches: Sequence[Stretch], joint: int, *, same: float = 0.03) -> int:
    """Count the postures of the locked joints that are `same` rad (m) apart or more."""
    postures: list[Array] = []
    for stretch in stretches:
        posture = np.delete(np.array(stretch.configuration), joint)
        distances = [np.abs(posture - earlier).max(initial=0.0) for earlier in postures]
        if not any(distance < same for distance in distances):
            postures.append(posture)
    return len(postures)


def moving_together(
    robot: Robot, counts: Array, *, min_share: float = 0.1
) -> list[str]:
    """Return the joints that move with others for a fair share of the moving time.

    Parameters
    ----------
    robot : Robot
        The arm, of n joints.
    counts : (n + 1,) array
        Samples at which each joint moves with others, and at which any joint moves.
    min_share : float
        Share of the moving time.
    """
    n_moving = max(counts[-1], 1.0)
    return [
        name
        for name, count in zip(robot.joint_names, counts[:-1], strict=True)
        if count > min_share * n_moving
    ]


def served_stages(
    robot: Robot,
    log: InspectedLog,
    stretches: Sequence[Stretch],
    *,
    min_speeds: int = 3,
    max_share: float = 0.25,
) -> list[str]:
    """Return the stages that a log serves.

    Parameters
    ----------
    robot : Robot
        The arm.
    log : InspectedLog
        What was seen in the log.
    stretches : sequence of Stretch
        Its stretches of constant velocity.
    min_speeds : int
        Speeds of a joint that friction needs.
    max_share : float
        Share of the speed limit below which moves are slow enough for gravity.
    """
    stages: list[str] = []
    has_torque = any(joint.effort for joint in log.joints)
    for j, joint in enumerate(robot.joints):
        of_joint = [stretch for stretch in stretches if stretch.joint == j]
        directions = {np.sign(stretch.velocity) for stretch in of_joint}
        # One way alone does not part friction from gravity.
        if not has_torque or len(directions) < 2:
            continue
        speeds = [abs(stretch.velocity) for stretch in of_joint]
        if _speeds(speeds) >= min_speeds:
            stages.append("friction")
        is_slow = max(speeds) < max_share * (joint.velocity_limit or 1.0)
        if robot.gravity.any() and (is_slow or _postures(of_joint, j) > 1):
            stages.append("gravity")

    if log.imus and sum(joint.moves for joint in log.joints) == 1:
        stages.append("imu-calib")
    single_joint = robot.n == 1 and log.joints[0].moves
    if has_torque and (len(log.moving_together) >= 2 or single_joint):
        stages.append("inertia")
    return list(dict.fromkeys(stages))


def serve_together(
    logs: Sequence[InspectedLog], *, min_speeds: int = 3
) -> list[InspectedLog]:
    """Add `friction` to logs that serve it together, such as one log per speed.

    That is of joints for which no log serves it alone, by logs with a speed of them,
    both ways.
    """
    served_alone = {
        move.joint for log in logs if "friction" in log.serves for move in log.moves
    }
    speeds: dict[str, list[float]] = {}
    for log in logs:
        for move in _both_ways(log):
            speeds.setdefault(move.joint, []).extend((move.slowest, move.fastest))
    served_together = {
        joint
        for joint, of_joint in speeds.items()
        if joint not in served_alone and _speeds(of_joint) >= min_speeds
    }

    changed = []
    for log in logs:
        joints = {move.joint for move in _both_ways(log)}
        if joints & served_together and "friction" not in log.serves:
            log = structs.replace(log, serves=["friction", *log.serves])
        changed.append(log)
    return changed


def _both_ways(log: InspectedLog) -> list[InspectedMoves]:
    """Return moves at constant speed, both ways, of joints with a torque."""
    driven = {joint.name for joint in log.joints if joint.effort}
    return [
        move
        for move in log.moves
        if move.forward and move.backward and move.joint in driven
    ]


def _speeds(speeds: Sequence[float], *, different: float = 1.25) -> int:
    """Count the speeds that are `different` times the one below, or more."""
    count = 0
    last_counted = 0.0
    for speed in sorted(speeds):
        if speed > different * last_counted:
            count += 1
            last_counted = speed
    return count
