"""Readings of IMUs by themselves: stuck, clipped, units, gravity at rest, axes."""

from collections.abc import Iterator
from itertools import combinations
from typing import NamedTuple

import numpy as np

from seqid_cli.imu.array import layout
from seqid_cli.inspect.channels.values import clipped, equal_runs, missing
from seqid_cli.inspect.findings import finding_of
from seqid_cli.inspect.material import LogData
from seqid_cli.logs.raw import ACCELEROMETERS, GYRO
from seqid_cli.motion.filters.differentiation import runs
from seqid_cli.motion.segmentation import standing
from seqid_cli.params.results.inspection import InspectionFinding
from seqid_cli.robot.types import Array, Imu, Robot
from seqid_cli.shares import percent

STANDARD_GRAVITY = 9.80665


def layout_findings(robot: Robot) -> Iterator[InspectionFinding]:
    """Find arrays of the robot file that do not determine the angular acceleration."""
    for imu in robot.imus:
        count = len(imu.positions)
        is_triad = count == 3 and not imu.positions.any()
        if not (imu.gyro or is_triad or layout(imu).acceleration):
            text = (
                f"its {count} accelerometers do not determine the angular acceleration"
            )
            yield finding_of("imu_layout", text, imu.name)


def imu_findings(data: LogData) -> Iterator[InspectionFinding]:
    """Check the channels of every IMU in a log."""
    strength = float(np.linalg.norm(data.robot.gravity))
    is_on_earth = abs(strength - STANDARD_GRAVITY) <= 0.5
    for imu in data.robot.imus:
        of_channels = [*_channels(data, imu)]
        yield from of_channels
        yield from _slow(data, imu)

        values = data.recording.accelerometers.get(imu.name)
        spans_space = np.linalg.matrix_rank(imu.axes) == 3
        if values is not None and is_on_earth and spans_space:
            # Channels that are broken disagree on gravity anyway.
            at_rest = data.modelled and not of_channels
            yield from _force(data, imu, values, at_rest=at_rest)

        gyro = data.recording.gyros.get(imu.name)
        if gyro is not None:
            yield from _bias(data, imu, gyro)


def _bias(data: LogData, imu: Imu, gyro: Array) -> Iterator[InspectionFinding]:
    """Find a gyro (N, 3) rad/s that reads too much at rest."""
    rest = rest_rows(data, gyro)
    if not len(rest):
        return
    bias = rest.mean(axis=0)
    size = np.linalg.norm(bias)
    if size > data.settings.imus.max_bias:
        channel = channel_name(imu, GYRO, int(np.abs(bias).argmax()))
        yield finding_of(
            "gyro_bias", f"reads {size:.3g} rad/s at rest", imu.name, channel
        )


def channel_name(imu: Imu, quantity: str, k: int) -> str:
    """Return the name of a channel as Parquet logs have it: a1, a2, ..., gx, gy, gz."""
    if quantity == GYRO:
        return f"{imu.name}.g{'xyz'[k % 3]}"
    return f"{imu.name}.a{k + 1}"


def _channels(
    data: LogData, imu: Imu, *, stuck_s: float = 0.5, stuck_samples: int = 50
) -> Iterator[InspectionFinding]:
    """Find channels with missing values, and those that are stuck or clipped.

    A channel is stuck that stays at a value for `stuck_s` and so many samples.
    """
    max_missing = data.settings.channels.max_missing
    # The streams of an IMU follow each other in the order of its channels.
    first = {ACCELEROMETERS: 0, GYRO: 0}
    for stream in data.raw.imus.get(imu.name, ()):
        stamps = stream.stamp_ns
        seconds = np.asarray((stamps - stamps[:1]) * 1e-9, dtype=np.float64)
        interval_s = 0.0
        if len(stamps) > 1:
            interval_s = float(np.median(np.diff(stamps))) * 1e-9
        least = max(stuck_samples, int(stuck_s / max(interval_s, 1e-9)))

        # Of a channel only the first fault is named: missing values look stuck, say.
        for quantity, values in stream.channels.items():
            columns = [column[np.isfinite(column)] for column in values.T]
            others_change = any(
                len(column) and np.ptp(column) > 0 for column in columns
            )
            for k, present in enumerate(columns):
                name = channel_name(imu, quantity, first[quantity] + k)
                lost = [*missing(values[:, k], seconds, imu.name, name, max_missing)]
                if lost:
                    yield from lost
                    continue
                stuck = _stuck(present, least, interval_s, others_change=others_change)
                if stuck:
                    yield finding_of("imu_stuck", stuck, imu.name, name)
                    continue
                limit_and_share = clipped(present)
                if limit_and_share:
                    limit, share = limit_and_share
                    text = f"is at {limit:.4g} in {percent(share)} of the samples"
                    yield finding_of("imu_saturated", text, imu.name, name)
            first[quantity] += values.shape[1]


def _stuck(
    present: Array, least: int, interval_s: float, *, others_change: bool
) -> str:
    """Return for how long a channel stays at one value, beside others that change."""
    # A channel that repeats itself all the time is slow or coarse, not stuck.
    is_lively = len(present) > 2 and np.mean(np.diff(present) != 0) > 0.3
    if not (others_change or is_lively):
        return ""
    for start, stop in equal_runs(present, least):
        value = present[start]
        is_inner = is_lively and value not in (present.max(), present.min())
        if is_inner or stop - start == len(present):
            return f"stays at {value:.4g} for {(stop - start) * interval_s:.3g} s"
    return ""


def rest_rows(data: LogData, values: Array, *, min_rest_s: float = 0.2) -> Array:
    """Average readings (N, K) over each rest of the whole arm.

    A rest lasts `min_rest_s`. Returns (R, K), in the unit of `values`.
    """
    recording = data.recording
    is_still = standing(data.moving, recording.rate_hz).all(axis=1) & recording.valid
    least = min_rest_s * recording.rate_hz
    means = [
        values[start:stop].mean(axis=0)
        for start, stop in runs(is_still, len(is_still))
        if stop - start >= least
    ]
    return np.array(means).reshape(-1, values.shape[1])


def force_of(imu: Imu, readings: Array) -> float:
    """Return the median size of the specific force by readings (R, K)."""
    forces = readings @ np.linalg.pinv(imu.axes).T
    return float(np.median(np.linalg.norm(forces, axis=1)))


def _slow(
    data: LogData, imu: Imu, *, min_hz: float = 20.0, per_cutoff: float = 5.0
) -> Iterator[InspectionFinding]:
    """Find an IMU that is too slow for the motion: less than `per_cutoff` a period.

    `min_hz` is what any IMU has at least.
    """
    rate_hz = data.recording.health.imu_rates_hz.get(imu.name, 0.0)
    least_hz = min_hz
    if data.motion is not None:
        least_hz = max(min_hz, per_cutoff * data.motion.cutoff.hz)
    # Two clocks differ a little.
    if 0.0 < rate_hz < 0.99 * least_hz:
        text = (
            f"is too slow: {rate_hz:.3g} readings a second, this motion needs"
            f" {least_hz:.3g}"
        )
        yield finding_of("imu_slow", text, imu.name)


class _Sizes(NamedTuple):
    """Sizes of the specific force [m/s^2]: usual ones, small ones and large ones."""

    low: float
    median: float
    high: float


def _sizes(imu: Imu, readings: Array) -> _Sizes:
    """Return the sizes of the specific force by readings (R, K)."""
    forces = readings @ np.linalg.pinv(imu.axes).T
    norms = np.linalg.norm(forces, axis=1)
    return _Sizes(*np.quantile(norms, (0.1, 0.5, 0.9)).tolist())


def _force(
    data: LogData, imu: Imu, values: Array, *, at_rest: bool
) -> Iterator[InspectionFinding]:
    """Check the size of the specific force, and of gravity at rest."""
    rows = values[data.recording.valid & np.isfinite(values).all(axis=1)]
    if not len(rows):
        return
    # A rest tells what the IMU reads of gravity alone. Without one the motion hides
    # it, but gravity stays, so that the size never falls far.
    rest = rest_rows(data, values)
    sizes = _sizes(imu, rest if len(rest) else rows)
    fault = _of_size(sizes, is_rest=bool(len(rest)))
    if fault is not None:
        code, text = fault
        yield finding_of(code, text, imu.name)
        return

    if not at_rest or not len(rest):
        return
    gravity = float(np.linalg.norm(data.robot.gravity))
    norm = force_of(imu, rest)
    max_error = data.settings.imus.max_gravity_error
    odd = odd_channel(imu, rest, gravity, max_error=max_error)
    if odd is not None:
        yield odd
    elif abs(norm / gravity - 1.0) > max_error:
        text = f"reads {norm:.4g} m/s^2 at rest, gravity is {gravity:.4g}"
        yield finding_of("imu_gravity", text, imu.name)


def _of_size(
    sizes: _Sizes,
    *,
    is_rest: bool,
    max_rest: float = 0.05,
    max_moving: float = 0.5,
    max_even: float = 0.3,
) -> tuple[str, str] | None:
    """Return code and message where a specific force has not the size of gravity.

    Parameters
    ----------
    sizes : _Sizes
        At rest, or in motion.
    is_rest : bool
        Whether they are of rests.
    max_rest, max_moving : float
        Shares of gravity that are left of it where it is taken out, at rest and in
        motion.
    max_even : float
        Share of large sizes that small ones have at most where gravity is taken out.
    """
    is_even = sizes.low > max_even * sizes.high
    where = "at rest" if is_rest else "in the median"
    for unit, one_gravity in (("g", 1.0), ("mg", 1e3)):
        if 0.8 * one_gravity < sizes.median < 1.2 * one_gravity and is_even:
            text = (
                f"reads {sizes.median:.3g} {where}: it looks like {unit}, m/s^2 are"
                " expected"
            )
            return "imu_in_g", text

    share = sizes.median / STANDARD_GRAVITY
    if share < (max_rest if is_rest else max_moving) and (is_rest or not is_even):
        text = (
            f"reads {sizes.median:.3g} m/s^2 {where}: gravity is taken out of it, it is"
            " a linear acceleration"
        )
        return "imu_without_gravity", text
    return None


class _Change(NamedTuple):
    """A change of some channels, and the disagreement (m/s^2)^2 that it leaves."""

    left: float
    code: str
    channels: tuple[int, ...]


def odd_channel(
    imu: Imu, rest: Array, gravity: float, *, max_error: float, max_left: float = 0.1
) -> InspectionFinding | None:
    """Find the one change with which readings at rest agree on gravity (Eq. 29).

    Parameters
    ----------
    imu : Imu
        The array of K accelerometers.
    rest : (R, K) array
        Readings at R rests [m/s^2].
    gravity : float
        Strength of gravity [m/s^2].
    max_error : float
        Share of gravity by which channels may disagree on it.
    max_left : float
        Share of the squared error that a change leaves at most.
    """
    error = _disagreement(rest, imu.axes)
    if rest.shape[1] <= 3 or np.sqrt(error) < max_error * gravity:
        return None
    # Leaving a channel out mends it even where it is only reversed: that is tried last.
    for changes in (
        [*_reversed(imu, rest), *_exchanged(imu, rest)],
        [*_left_out(imu, rest)],
    ):
        best = min(changes, default=None)
        if best is not None and best.left <= max_left * error:
            names = [channel_name(imu, ACCELEROMETERS, k) for k in best.channels]
            text = (
                f"the accelerometers disagree on gravity by {np.sqrt(error):.3g}"
                f" m/s^2, {np.sqrt(best.left):.3g} once this is mended"
            )
            return finding_of(best.code, text, imu.name, ", ".join(names))
    return None


def _reversed(imu: Imu, rest: Array) -> Iterator[_Change]:
    """Yield each channel reversed."""
    channels = np.arange(rest.shape[1])
    for k in channels.tolist():
        sign = np.where(channels == k, -1.0, 1.0)
        left = _disagreement(rest * sign, imu.axes)
        yield _Change(left, "imu_channel_flipped", (k,))


def _exchanged(imu: Imu, rest: Array) -> Iterator[_Change]:
    """Yield each two channels exchanged."""
    channels = np.arange(rest.shape[1])
    for pair in combinations(channels.tolist(), 2):
        order = channels.copy()
        order[list(pair)] = pair[::-1]
        left = _disagreement(rest[:, order], imu.axes)
        yield _Change(left, "imu_channels_swapped", pair)


def _left_out(imu: Imu, rest: Array) -> Iterator[_Change]:
    """Yield each channel left out, where the others still see all directions."""
    channels = np.arange(rest.shape[1])
    for k in channels.tolist():
        others = channels != k
        axes = imu.axes[others]
        if np.linalg.matrix_rank(axes) == 3:
            left = _disagreement(rest[:, others], axes)
            yield _Change(left, "imu_channel_wrong", (k,))


def _disagreement(rest: Array, axes: Array) -> float:
    """Return the mean square (m/s^2)^2 of readings that no specific force explains.

    `rest` (R, K) are readings along the `axes` (K, 3).
    """
    P = np.eye(len(axes)) - axes @ np.linalg.pinv(axes)
    return float(np.mean(np.sum((rest @ P) ** 2, axis=1)))
