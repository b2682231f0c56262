"""IMUs by themselves: stuck, clipped, units, gravity at rest, axes of an array."""

from collections.abc import Iterator
from itertools import combinations

import numpy as np

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


def layout_findings(robot: Robot) -> Iterator[InspectionFinding]:
    """Find arrays of the robot file that do not determine the angular acceleration."""
    for imu in robot.imus:
        count = len(imu.positions)
        triad = count == 3 and not imu.positions.any()
        if not (imu.gyro or triad or layout(imu).acceleration):
            text = (
                f"its {count} accelerometers do not determine the angular acceleration"
            )
            yield found("imu_layout", text, imu.name)


def imu_findings(
    data: LogData, *, max_bias: float = 0.1
) -> Iterator[InspectionFinding]:
    """Check the channels of every IMU in the log; `max_bias` of a gyro at rest, rad/s."""
    for imu in data.robot.imus:
        broken = [*_channels(data, imu)]
        yield from broken
        values = data.recording.accelerometers.get(imu.name)
        on_earth = (
            abs(float(np.linalg.norm(data.robot.gravity)) - STANDARD_GRAVITY) <= 0.5
        )
        if values is not None and on_earth and np.linalg.matrix_rank(imu.axes) == 3:
            yield from _force(data, imu, values, at_rest=data.modelled and not broken)
        gyro = data.recording.gyros.get(imu.name)
        rest = rest_rows(data, gyro) if gyro is not None else np.zeros((0, 3))
        bias = rest.mean(axis=0) if len(rest) else np.zeros(3)
        if np.linalg.norm(bias) > max_bias:
            channel = channel_name(imu, GYRO, int(np.abs(bias).argmax()))
            text = f"reads {np.linalg.norm(bias):.3g} rad/s at rest"
            yield found("gyro_bias", text, imu.name, channel)


def channel_name(imu: Imu, quantity: str, k: int) -> str:
    """Name a channel as Parquet logs do: a1, a2, ...

    (ax, ay, az of a triad), gx, gy, gz.
    """
    return f"{imu.name}.g{'xyz'[k % 3]}" if quantity == GYRO else f"{imu.name}.a{k + 1}"


def _channels(
    data: LogData, imu: Imu, *, stuck_s: float = 0.5, stuck_samples: int = 50
) -> Iterator[InspectionFinding]:
    """Find channels with missing values, and those that are stuck or clipped."""
    first = {ACCELEROMETERS: 0, GYRO: 0}
    for stream in data.raw.imus.get(imu.name, ()):
        stamps = stream.stamp_ns
        seconds = float(np.median(np.diff(stamps))) * 1e-9 if len(stamps) > 1 else 0.0
        least = max(stuck_samples, int(stuck_s / max(seconds, 1e-9)))
        for quantity, values in stream.channels.items():
            columns = [column[np.isfinite(column)] for column in values.T]
            others = any(len(column) and np.ptp(column) > 0 for column in columns)
            for k, present in enumerate(columns, start=first[quantity]):
                name = channel_name(imu, quantity, k)
                lost = [*missing(values[:, k - first[quantity]], imu.name, name)]
                yield from lost
                if text := (
                    "" if lost else _stuck(present, least, seconds, others=others)
                ):
                    yield found("imu_stuck", text, imu.name, name)
                elif limit := None if lost else clipped(present):
                    text = f"is at {limit[0]:.4g} in {percent(limit[1])} of the samples"
                    yield found("imu_saturated", text, imu.name, name)
            first[quantity] += values.shape[1]


def _stuck(present: Array, least: int, seconds: float, *, others: bool) -> str:
    """Tell for how long a channel stays at one value, beside `others` that change."""
    # A channel that repeats itself all the time is slow or coarse, not stuck.
    lively = len(present) > 2 and np.mean(np.diff(present) != 0) > 0.3
    for a, b in equal_runs(present, least) if others or lively else ():
        inner = lively and present[a] not in (present.max(), present.min())
        if inner or b - a == len(present):
            return f"stays at {present[a]:.4g} for {(b - a) * seconds:.3g} s"
    return ""


def rest_rows(data: LogData, values: Array, *, min_rest_s: float = 0.2) -> Array:
    """Average readings (N, K) over each rest of the whole arm; (R, K)."""
    still = (
        standing(data.moving, data.recording.rate_hz).all(axis=1) & data.recording.valid
    )
    least = min_rest_s * data.recording.rate_hz
    means = [
        values[a:b].mean(axis=0) for a, b in runs(still, len(still)) if b - a >= least
    ]
    return np.array(means).reshape(-1, values.shape[1])


def force_of(imu: Imu, readings: Array) -> float:
    """Median size of the specific force by readings (R, K)."""
    return float(
        np.median(np.linalg.norm(readings @ np.linalg.pinv(imu.axes).T, axis=1))
    )


def _force(
    data: LogData, imu: Imu, values: Array, *, at_rest: bool
) -> Iterator[InspectionFinding]:
    """Check the size of the specific force, and at rest what the channels say of gravity."""
    rows = values[data.recording.valid & np.isfinite(values).all(axis=1)]
    size = force_of(imu, rows) if len(rows) else 0.0
    if unit := next(
        (u for u, g in (("g", 1.0), ("mg", 1e3)) if 0.8 * g < size < 1.2 * g), ""
    ):
        text = (
            f"reads {size:.3g} in the median: it looks like {unit}, m/s^2 are expected"
        )
        yield found("imu_in_g", text, imu.name)
        return
    gravity = float(np.linalg.norm(data.robot.gravity))
    if not at_rest or not len(rest := rest_rows(data, values)):
        return
    norm, odd = force_of(imu, rest), odd_channel(imu, rest, gravity)
    if odd is not None:
        yield odd
    elif abs(norm / gravity - 1.0) > WRONG:
        text = f"reads {norm:.4g} m/s^2 at rest, gravity is {gravity:.4g}"
        yield found("imu_gravity", text, imu.name)


def odd_channel(
    imu: Imu, rest: Array, gravity: float, *, max_left: float = 0.1
) -> InspectionFinding | None:
    """Find the one change with which readings (R, K) m/s^2 at rest agree on gravity (Eq. 29)."""
    every = np.arange(rest.shape[1])
    error = _disagreement(rest, imu.axes)
    if len(every) <= 3 or np.sqrt(error) < WRONG * gravity:
        return None
    changed: list[tuple[float, str, tuple[int, ...]]] = []
    without = changed.copy()
    for k in every.tolist():
        left = _disagreement(rest * np.where(every == k, -1.0, 1.0), imu.axes)
        changed.append((left, "imu_channel_flipped", (k,)))
        axes = imu.axes[every != k]
        if np.linalg.matrix_rank(axes) == 3:
            without.append(
                (_disagreement(rest[:, every != k], axes), "imu_channel_wrong", (k,))
            )
    for pair in combinations(every.tolist(), 2):
        order = every.copy()
        order[list(pair)] = pair[::-1]
        changed.append(
            (_disagreement(rest[:, order], imu.axes), "imu_channels_swapped", pair)
        )
    # leaving it out does even where it is only reversed
    for tried in (changed, without):
        left, code, channels = min(tried, default=(np.inf, "", ()))
        if left <= max_left * error:
            names = ", ".join(channel_name(imu, ACCELEROMETERS, k) for k in channels)
            text = (
                f"the accelerometers disagree on gravity by {np.sqrt(error):.3g}"
                " m/s^2, "
            )
            text += f"{np.sqrt(left):.3g} once this is mended"
            return found(code, text, imu.name, names)
    return None


def _disagreement(rest: Array, axes: Array) -> float:
    """Mean square (m/s^2)^2 of readings (R, K) that no specific force along the axes explains."""
    P = np.eye(len(axes)) - axes @ np.linalg.pinv(axes)
    return float(np.mean(np.sum((rest @ P) ** 2, axis=1)))
