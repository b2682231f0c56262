"""IMUs by themselves: stuck, clipped, units, gravity at rest, axes of an array."""

from collections.abc import Iterator
from itertools import combinations

import numpy as np
from msgspec import structs

from seqid_cli.inspect.channels.values import clipped, equal_runs, missing
from seqid_cli.inspect.findings import found
from seqid_cli.inspect.material import LogData
from seqid_cli.logs.raw import ACCELEROMETERS, GYRO
from seqid_cli.motion.filters.differentiation import runs
from seqid_cli.motion.imu.array import layout
from seqid_cli.motion.segmentation import standing
from seqid_cli.params.results.inspection import InspectionFinding
from seqid_cli.robot.types import Array, Imu, Robot
from seqid_cli.shares import percent

STANDARD_GRAVITY = 9.80665
WRONG = 0.05  # of gravity
AXES = "xyz"


def layout_findings(robot: Robot) -> Iterator[InspectionFinding]:
    """Find arrays of the robot file that do not determine the angular acceleration."""
    for imu in robot.imus:
        count = len(imu.positions)
        triad = count == 3 and not imu.positions.any()
        if not (imu.gyro or triad or layout(imu).acceleration):
            text = f"its {count} accelerometers do not determine the angular acceleration"
            yield found("imu_layout", text, joint=imu.name)


def imu_findings(data: LogData) -> Iterator[InspectionFinding]:
    """Check the channels of every IMU in the log."""
    for imu in data.robot.imus:
        broken = [*_channels(data, imu)]
        yield from _together(broken)
        values = data.recording.accelerometers.get(imu.name)
        on_earth = abs(float(np.linalg.norm(data.robot.gravity)) - STANDARD_GRAVITY) <= 0.5
        if values is not None and on_earth and np.linalg.matrix_rank(imu.axes) == 3:
            yield from _force(data, imu, values, at_rest=data.modelled and not broken)
        gyro = data.recording.gyros.get(imu.name)
        if gyro is not None:
            yield from _gyro_bias(data, imu, gyro)


def _together(
    findings: list[InspectionFinding], *, max_channels: int = 3
) -> Iterator[InspectionFinding]:
    """Report a fault that many channels share once: it is the IMU's."""
    for code in dict.fromkeys(finding.code for finding in findings):
        alike = [finding for finding in findings if finding.code == code]
        if len(alike) <= max_channels:
            yield from alike
        else:
            names = ", ".join(finding.channel for finding in alike)
            yield structs.replace(alike[0], channel=names)


def channel_name(imu: Imu, quantity: str, k: int) -> str:
    """Name a channel as Parquet logs do: a1, a2, ... (ax, ay, az of a triad), gx, gy, gz."""
    if quantity == GYRO:
        return f"{imu.name}.g{AXES[k % 3]}"
    return f"{imu.name}.a{k + 1}"


def _channels(data: LogData, imu: Imu) -> Iterator[InspectionFinding]:
    first = {ACCELEROMETERS: 0, GYRO: 0}
    for stream in data.raw.imus.get(imu.name, ()):
        stamps = stream.stamp_ns
        seconds = float(np.median(np.diff(stamps))) * 1e-9 if len(stamps) > 1 else 0.0
        for quantity, values in stream.channels.items():
            present = [column[np.isfinite(column)] for column in values.T]
            live = any(len(column) and np.ptp(column) > 0 for column in present)
            for k in range(values.shape[1]):
                name = channel_name(imu, quantity, first[quantity] + k)
                finding = _channel(imu, name, values[:, k], seconds, others=live)
                if finding is not None:
                    yield finding
            first[quantity] += values.shape[1]


def _channel(
    imu: Imu,
    name: str,
    values: Array,
    seconds: float,
    *,
    others: bool,
    stuck_s: float = 0.5,
    stuck_samples: int = 50,
) -> InspectionFinding | None:
    present = values[np.isfinite(values)]
    if lost := next(missing(values, imu.name, name), None):
        return lost
    least = max(stuck_samples, int(stuck_s / max(seconds, 1e-9)))
    # A channel that repeats itself all the time is slow or coarse, not stuck.
    lively = len(present) > 2 and np.mean(np.diff(present) != 0) > 0.3
    for a, b in equal_runs(present, least) if others or lively else ():
        inner = lively and present[a] not in (present.max(), present.min())
        if inner or b - a == len(present):
            text = f"stays at {present[a]:.4g} for {(b - a) * seconds:.3g} s"
            return found("imu_stuck", text, joint=imu.name, channel=name)
    limit = clipped(present)
    if limit is not None:
        text = f"is at {limit[0]:.4g} in {percent(limit[1])} of the samples"
        return found("imu_saturated", text, joint=imu.name, channel=name)
    return None


def rest_rows(data: LogData, values: Array, *, min_rest_s: float = 0.2) -> Array:
    """Average readings (N, K) over each rest of the whole arm; (R, K)."""
    still = standing(data.moving, data.recording.rate_hz).all(axis=1) & data.recording.valid
    least = min_rest_s * data.recording.rate_hz
    means = [values[a:b].mean(axis=0) for a, b in runs(still, len(still)) if b - a >= least]
    return np.array(means).reshape(-1, values.shape[1])


def force_of(imu: Imu, readings: Array) -> float:
    """Median size of the specific force by readings (R, K)."""
    return float(np.median(np.linalg.norm(readings @ np.linalg.pinv(imu.axes).T, axis=1)))


def _force(data: LogData, imu: Imu, values: Array, *, at_rest: bool) -> Iterator[InspectionFinding]:
    """Check the size of the specific force, and at rest what the channels say of gravity."""
    rows = values[data.recording.valid & np.isfinite(values).all(axis=1)]
    size = force_of(imu, rows) if len(rows) else 0.0
    unit = next((u for u, g in (("g", 1.0), ("mg", 1e3)) if 0.8 * g < size < 1.2 * g), "")
    if unit:
        text = f"reads {size:.3g} in the median: it looks like {unit}, m/s^2 are expected"
        yield found("imu_in_g", text, joint=imu.name)
        return
    gravity = float(np.linalg.norm(data.robot.gravity))
    rest = rest_rows(data, values)
    if not at_rest or not len(rest):
        return
    norm, odd = force_of(imu, rest), odd_channel(imu, rest, gravity)
    if odd is not None:
        yield odd
    elif abs(norm / gravity - 1.0) > WRONG:
        text = f"reads {norm:.4g} m/s^2 at rest, gravity is {gravity:.4g}"
        yield found("imu_gravity", text, joint=imu.name)


def odd_channel(
    imu: Imu,
    rest: Array,
    gravity: float,
    *,
    max_left: float = 0.1,
    max_repaired: float = 4.0,  # times the squared error without the channel
) -> InspectionFinding | None:
    """Find the one change with which the accelerometers of an array agree on gravity (Eq. 29).

    `rest` (R, K): readings [m/s^2] to specific force alone. `gravity`: its size [m/s^2].
    """
    count = rest.shape[1]
    if count <= 3:
        return None
    error = _disagreement(rest, imu.axes)
    if np.sqrt(error) < WRONG * gravity:
        return None
    every = np.arange(count)
    tried: list[tuple[float, float, str, tuple[int, ...]]] = []  # the first is what decides
    for k in every.tolist():
        left = _disagreement(rest * np.where(every == k, -1.0, 1.0), imu.axes)
        tried.append((left, left, "imu_channel_flipped", (k,)))
        axes = imu.axes[every != k]
        if np.linalg.matrix_rank(axes) == 3:  # leaving it out does even where it is only reversed
            left = _disagreement(rest[:, every != k], axes)
            tried.append((max_repaired * left, left, "imu_channel_wrong", (k,)))
    for pair in combinations(range(count), 2):
        order = every.copy()
        order[list(pair)] = pair[::-1]
        left = _disagreement(rest[:, order], imu.axes)
        tried.append((left, left, "imu_channels_swapped", pair))
    _, left, code, channels = min(tried)
    if left > max_left * error:
        return None
    names = ", ".join(channel_name(imu, ACCELEROMETERS, k) for k in channels)
    alike = sum(other < 1.05 * left and c == code for _, other, c, _ in tried) - 1
    text = (
        f"the accelerometers disagree on gravity by {np.sqrt(error):.3g} m/s^2, "
        f"{np.sqrt(left):.3g} once this is mended"
        + (f"; {alike} other pairs would do as well" if alike else "")
    )
    return found(code, text, joint=imu.name, channel=names)


def _disagreement(rest: Array, axes: Array) -> float:
    """Mean square (m/s^2)^2 of readings (R, K) that no specific force along the axes explains."""
    P = np.eye(len(axes)) - axes @ np.linalg.pinv(axes)
    return float(np.mean(np.sum((rest @ P) ** 2, axis=1)))


def _gyro_bias(
    data: LogData, imu: Imu, gyro: Array, *, max_bias: float = 0.1
) -> Iterator[InspectionFinding]:
    rest = rest_rows(data, gyro)
    bias = rest.mean(axis=0) if len(rest) else np.zeros(3)
    size, worst = float(np.linalg.norm(bias)), int(np.abs(bias).argmax())
    if size > max_bias:
        text, channel = f"reads {size:.3g} rad/s at rest", channel_name(imu, GYRO, worst)
        yield found("gyro_bias", text, joint=imu.name, channel=channel)
