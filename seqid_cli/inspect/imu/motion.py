"""IMUs against the encoders: delay, link, axes, gyro.

Whatever the mounting, an accelerometer on a link reads a linear function of the link's specific
force (3), angular acceleration (3) and products of angular velocity (6) in the link's frame, a gyro
one of the angular velocity (3), at the IMU's own time. Both sides go through the same low-pass; the
linear function is fitted to each channel for a range of time shifts.
"""

from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from seqid_cli.inspect.findings import found
from seqid_cli.inspect.imu.link_fit import FOLLOWS, SIGMAS, LinkFit, fit_link, scan
from seqid_cli.inspect.imu.readings import odd_channel
from seqid_cli.inspect.material import LogData
from seqid_cli.params.results.inspection import InspectionFinding
from seqid_cli.shares import percent

TELLS = 0.1  # of the variance, that may be left where a map is to tell axes
MAPPED = 0.03  # standard error of the map that tells axes


def follow(data: LogData) -> list[LinkFit]:
    """Fit every IMU of a log to the motion of its link; empty where nothing turns."""
    sources = (data.recording.accelerometers, data.recording.gyros)
    if not data.modelled or not any(sources) or data.motion is None:
        return []
    result = []
    for imu in data.robot.imus:
        for gyro, source in zip((False, True), sources, strict=True):
            if (values := source.get(imu.name)) is not None:
                result.append(fit_link(data.robot, data.motion, values, imu, gyro=gyro))
    return [fit for fit in result if fit is not None]


def motion_findings(
    data: LogData,
    following: list[LinkFit],
    *,
    min_delay_s: float = 0.005,
    min_delay_samples: float = 2.0,
) -> Iterator[InspectionFinding]:
    """Judge how the IMUs follow the encoders."""
    for item in following:
        name = item.imu.name
        if better := _better(data, item):
            yield better
            continue
        if item.left > FOLLOWS:
            left = percent(item.left, 0)
            text = f"the motion of its link leaves {left} of its variance unexplained"
            yield found("imu_not_moving", text, name)
            continue
        least, delay = max(min_delay_s, min_delay_samples / data.recording.rate_hz), item.delay
        error = float(np.hypot(item.delay_error, _resolution_s(data, item.imu.after_joint)))
        if abs(delay) > least and abs(delay) > SIGMAS * error:
            text = f"its readings are {1e3 * delay:.1f} +- {1e3 * error:.1g} ms behind the encoders"
            yield found("imu_delay", text, name)
        yield from _gyro(item) if item.gyro else _axes(data, item)


def _resolution_s(data: LogData, link: int) -> float:
    """Time that the fastest joint before a link takes for the error of its encoder, s."""
    # Joints rest anywhere within a count, on one side going forward and on the other going back.
    assert data.motion is not None
    dq, moving = data.motion.dq, data.motion.moving
    there = [j for j in range(link + 1) if moving[:, j].any()]
    speeds = [float(np.sqrt(np.mean(dq[moving[:, j], j] ** 2))) / data.step[j] for j in there]
    return float(1.0 / np.sqrt(12.0) / max([*speeds, 1e-9]))  # the error is even within one step


def _better(
    data: LogData, item: LinkFit, *, max_ratio: float = 0.25, min_left: float = 0.01
) -> InspectionFinding | None:
    """Find another link, or a joint reversed, that the IMU follows far better than its own link."""
    motion, robot = data.motion, data.robot
    if item.left < min_left or motion is None:
        return None
    name, own = item.imu.name, item.imu.after_joint
    values = (data.recording.gyros if item.gyro else data.recording.accelerometers)[name]
    names = robot.joint_names
    tried = [(-1, k) for k in range(robot.n) if k != own]  # the joint that is reversed, the link
    tried += [(j, own) for j in range(own + 1) if data.moves(j)]
    best = (max_ratio * item.left, -1, own)
    for joint, link in tried:
        sign = np.where(np.arange(robot.n) == joint, -1.0, 1.0)
        moved = replace(motion, q=motion.q * sign, dq=motion.dq * sign, ddq=motion.ddq * sign)
        if scanned := scan(robot, moved, values, link, gyro=item.gyro):
            best = min(best, (scanned.share, joint, link))
    share, joint, link = best
    text = f"{percent(share)} of its variance is left against {percent(item.left, 0)}"
    if joint >= 0:
        text = f"by IMU {name} it turns the other way round: {text}"
        return found("axis_flipped", text, names[joint], "position")
    text = f"follows the link after {names[link]}, not the one after {names[own]}: {text}"
    return None if link == own else found("imu_wrong_link", text, name)


def _gyro(item: LinkFit) -> Iterator[InspectionFinding]:
    size, name = item.gain, item.imu.name
    text = f"reads {size:.3g} times the link's angular velocity"
    if item.left > TELLS:
        return
    if abs(size / np.degrees(1.0) - 1.0) < 0.2:
        yield found("gyro_in_degrees", text, name)
    elif item.map_error < MAPPED and np.linalg.det(item.map) < 0.0:
        text = "its gyro fits the link's motion as a mirror image only"
        yield found("imu_left_handed", text, name, f"{name}.g")
    elif abs(size - 1.0) > 0.15:
        yield found("gyro_scale", text, name)


def _axes(
    data: LogData, item: LinkFit, *, max_scale_error: float = 0.05
) -> Iterator[InspectionFinding]:
    """Judge the axes by the map of specific force, which must be a rotation behind the axes."""
    force, imu = item.map[:, :3], item.imu
    size = float(np.linalg.svd(force, compute_uv=False)[0])
    other_unit = not 0.5 < size / np.sqrt(max(len(imu.axes) / 3.0, 1.0)) < 2.0
    if item.map_error > MAPPED or item.left > TELLS or other_unit:
        return
    gravity = float(np.linalg.norm(data.robot.gravity)) or 9.81
    if odd := odd_channel(imu, gravity * force.T, gravity):
        yield odd
        return
    turned = np.linalg.pinv(imu.axes) @ force
    sizes = np.linalg.svd(turned, compute_uv=False)
    scale, evenness = float(np.mean(sizes)), sizes[2] / sizes[0]
    if np.linalg.det(turned) < 0.0 and evenness > 0.7:
        text = "its accelerometers fit the link's motion as a mirror image only"
        yield found("imu_left_handed", text, imu.name)
    elif abs(scale - 1.0) > max_scale_error and evenness > 0.9:
        text = f"reads {scale:.3g} times the link's specific force"
        yield found("imu_gravity", text, imu.name)
