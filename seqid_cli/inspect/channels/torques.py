"""Torques and currents, channel by channel; temperatures and sensors beside them."""

from collections.abc import Container, Iterator

import numpy as np

from seqid_cli.inspect.channels.values import clipped, equal_runs, held, lattice
from seqid_cli.inspect.dynamics.echo import WARNING, echoes
from seqid_cli.inspect.dynamics.weights import HEAVY, largest_gravity
from seqid_cli.inspect.findings import finding_of
from seqid_cli.inspect.material import LogData
from seqid_cli.inspect.settings import ChannelSettings
from seqid_cli.logs.signs import sign_bit
from seqid_cli.params.results.inspection import InspectionFinding
from seqid_cli.robot.types import Array
from seqid_cli.running import median_of_five
from seqid_cli.shares import percent
from seqid_cli.typing import Index, Mask


def torque_findings(data: LogData) -> Iterator[InspectionFinding]:
    """Check the torque or current of every joint."""
    effort = data.effort()
    if effort is None:
        yield finding_of("torque_missing", "there is neither torque nor current")
        return
    quantity, values = effort
    if quantity == "current":
        yield from _inverse_gears(data)
    yield from _beyond_limits(data, quantity)
    for j, joint in enumerate(data.robot.joints):
        for code, text in _of_channel(data, j, values[:, j], quantity):
            yield finding_of(code, text, joint.name, quantity)
    if quantity == "torque" and _may_be_current(data):
        text = (
            "could be torque or current: the robot file gives torque_constant, the log"
            " torque"
        )
        yield finding_of("effort_unclear", text, channel=quantity)


def _inverse_gears(data: LogData, *, least: float = 0.5) -> Iterator[InspectionFinding]:
    """Find gears of a ratio below `least`: the joint would outrun its motor."""
    for joint in data.robot.joints:
        ratio = abs(joint.gear_ratio or 1.0)
        if ratio < least:
            text = (
                f"gear_ratio is {ratio:.4g}, motor turns per joint turn: was its"
                f" inverse, {1.0 / ratio:.4g}, meant?"
            )
            yield finding_of("gear_inverse", text, joint.name, "current")


def _beyond_limits(
    data: LogData, quantity: str, *, usual: float = 0.99, most: float = 1.2
) -> Iterator[InspectionFinding]:
    """Find torques whose quantile `usual` is `most` times the URDF's effort limit.

    A push or a spike is no torque of the joint. One joint beyond may have a wrong limit
    in the URDF; where all that move are beyond theirs, the torque has another unit.
    """
    tau = data.recording.tau
    if tau is None or not data.modelled:
        return
    largest = np.quantile(np.abs(tau[data.recording.valid]), usual, axis=0)
    limits = np.array(
        [
            (joint.urdf.effort if joint.urdf is not None else None) or np.inf
            for joint in data.robot.joints
        ]
    )
    is_beyond = largest > most * limits
    moving = [j for j in range(data.robot.n) if data.moves(j)]
    all_beyond = len(moving) > 1 and bool(is_beyond[moving].all())
    code = "effort_limits" if all_beyond else "torque_limit"
    for j in np.flatnonzero(is_beyond):
        joint = data.robot.joints[j]
        unit = joint.unit("N m")
        text = (
            f"reaches {largest[j]:.4g} {unit}, the URDF's effort limit is"
            f" {limits[j]:.4g} {unit}"
        )
        yield finding_of(code, text, joint.name, quantity)


def _may_be_current(data: LogData) -> bool:
    """Return whether neither the robot file nor the robot's weight tells a torque."""
    channels = data.robot.channels
    if channels.effort == "torque" or channels.torque is not None:
        return False
    has_drive_data = any(
        joint.torque_constant is not None for joint in data.robot.joints
    )
    is_light = data.modelled and largest_gravity(data.robot).max() < HEAVY
    return has_drive_data and bool(is_light)


def _of_channel(
    data: LogData, j: int, column: Array, quantity: str, *, max_rms: float = 200.0
) -> Iterator[tuple[str, str]]:
    """Yield codes and messages of one joint's channel (M,).

    No drive takes a current of `max_rms` amperes.
    """
    present = np.isfinite(column)
    values = column[present]
    t = data.t[present]
    rms = float(np.sqrt(np.mean(values**2))) if len(values) else 0.0
    if quantity == "current" and rms > max_rms and not sign_bit(values):
        yield "current_in_ma", f"is {rms:.3g} A RMS: it looks like mA"
    if not data.moves(j) or not len(values):
        return

    if not values.any():
        yield "torque_zero", "is zero throughout although the joint moves"
        return
    if np.ptp(values) == 0.0:
        text = f"is {values[0]:.4g} throughout although the joint moves"
        yield "torque_constant_value", text
        return
    bit = sign_bit(values)
    if bit:
        yield "effort_sign_bit", bit
        return
    moving = data.moving_samples(j)[present]
    stuck = _stuck(values, t, moving, step=data.lattice(quantity, j))
    if stuck:
        yield "torque_stuck", stuck
        return

    spikes = _spikes(values, data.settings.channels)
    if len(spikes):
        text = f"is {values[spikes[0]]:.4g} for a moment at {t[spikes[0]]:.3f} s"
        if len(spikes) > 1:
            text += f" and {len(spikes) - 1} more times"
        yield "torque_spikes", text
    limit_and_share = clipped(values)
    if limit_and_share:
        limit, share = limit_and_share
        text = f"is at {limit:.4g} in {percent(share)} of the samples"
        yield "torque_saturated", text


def _spikes(values: Array, settings: ChannelSettings) -> Index:
    """Return samples of a channel (M,), one or two at a time, far from both sides.

    What lasts longer may be a hard acceleration. Distances are from the median of five
    samples.
    """
    max_spikes = 16
    if len(values) <= 4 * max_spikes:
        return np.zeros(0, dtype=np.intp)
    span = float(np.ptp(np.quantile(values, (0.01, 0.99))))
    least = settings.min_spike_share * span
    # Most channels end here: the median of five is no farther than two changes.
    if 2.0 * np.abs(np.diff(values)).max() <= least:
        return np.zeros(0, dtype=np.intp)
    distance = np.abs(values - median_of_five(values, beyond="edge"))
    # The largest distance that is none of the spikes.
    usual = float(np.partition(distance, len(values) - max_spikes)[-max_spikes - 1])
    least = max(settings.min_spike_ratio * usual, least)
    rows: Index = np.flatnonzero(distance > least)
    return rows if len(rows) <= max_spikes else rows[:0]


def torque_quality(
    data: LogData,
    broken: Container[str],
    *,
    max_step: float = 0.25,
    max_changing: float = 0.6,
) -> Iterator[InspectionFinding]:
    """Check how well torque is measured.

    Parameters
    ----------
    data : LogData
        The log.
    broken : container of str
        Joints that are left out.
    max_step : float
        Step of the channel, as a share of the torque's spread.
    max_changing : float
        Share of samples that differ from the one before, above which noise carries the
        signal over the steps.
    """
    effort = data.effort()
    if effort is None:
        return
    quantity, all_values = effort
    for j, name in enumerate(data.robot.joint_names):
        column = all_values[:, j]
        if not data.moves(j) or name in broken:
            continue
        present = np.isfinite(column)
        values = column[present]
        moving = data.moving_samples(j)[present]

        group_size = held(values)
        if group_size > 1:
            text = f"repeats each value {group_size} times"
            yield finding_of("channel_held", text, name, quantity)

        step = data.lattice(quantity, j)
        spread = float(values[moving].std()) if moving.any() else 0.0
        is_dithered = len(values) > 1 and np.mean(np.diff(values) != 0) > max_changing
        if step and spread and step > max_step * spread and not is_dithered:
            text = f"comes in steps of {step:.3g}, its spread is {spread:.3g}"
            yield finding_of("torque_quantised", text, name, quantity)


def _stuck(
    values: Array,
    t: Array,
    moving: Mask,
    *,
    step: float | None = None,
    min_samples: int = 50,
    min_s: float = 0.2,
    max_step: float = 0.1,
) -> str:
    """Return where a channel stays at a value while its joint moves; empty: nowhere.

    Zero is none: a drive that is let go makes no torque. Nor is a level of a coarse
    channel, which stays where it is as long as the torque changes by less. `step` is
    its lattice, where that is known already.
    """
    if moving.sum() < 3 or not np.median(np.diff(values[moving]) != 0):
        return ""  # it repeats itself anyway
    if step is None:
        step = lattice(values)
    is_coarse = step > max_step * float(np.std(values[moving]))
    if is_coarse:
        return ""
    for start, stop in equal_runs(values, min_samples):
        value = values[start]
        seconds = float(t[stop - 1] - t[start])
        # At its limits a channel is clipped, which is another finding.
        is_inner = value not in (0.0, values.min(), values.max())
        if seconds >= min_s and is_inner and moving[start:stop].mean() > 0.5:
            return f"stays at {value:.4g} for {seconds:.3g} s from {t[start]:.3f} s"
    return ""


def echo_findings(data: LogData) -> Iterator[InspectionFinding]:
    """Find torques that echo a command."""
    log = data.recording
    if log.tau is None:
        return
    for j in echoes(
        data.robot,
        log.t,
        log.q,
        log.tau,
        log.valid,
        settings=data.settings.echo,
    ):
        # Noise of a joint that stands makes travel, but no motion.
        if data.moves(j):
            yield finding_of("torque_echo", WARNING, data.robot.joint_names[j])


def sensor_findings(
    data: LogData, *, opposed: float = -0.5
) -> Iterator[InspectionFinding]:
    """Check torque sensors and encoders on the link against the motor's side.

    A correlation below `opposed` says that they count the other way.
    """
    channels = data.joints.channels
    effort = data.effort()
    pairs = [
        ("load", None if effort is None else effort[1]),
        ("link_position", channels["position"]),
    ]
    # Friction hides the load in a motor's torque, but a wrong sign shows through it.
    for channel, motor_side in pairs:
        link_side = channels.get(channel)
        if link_side is None or motor_side is None:
            continue
        for j, name in enumerate(data.robot.joint_names):
            correlation = _correlation(
                link_side[:, j], motor_side[:, j], data.moving_samples(j)
            )
            if correlation < opposed:
                text = (
                    "runs against the motor's side: their correlation is"
                    f" {correlation:.2f}"
                )
                yield finding_of("sensor_sign", text, name, channel)


def _correlation(a: Array, b: Array, moving: Mask) -> float:
    """Return the correlation of two channels (M,) in motion; 0 if one is constant."""
    used = moving & np.isfinite(a) & np.isfinite(b)
    if used.sum() < 2 or a[used].std() * b[used].std() == 0.0:
        return 0.0
    return float(np.corrcoef(a[used], b[used])[0, 1])


def temperature_findings(data: LogData) -> Iterator[InspectionFinding]:
    """Check the temperatures of every joint."""
    temperatures = data.joints.channels.get("temperature")
    if temperatures is None:
        return
    for j, name in enumerate(data.robot.joint_names):
        column = temperatures[:, j]
        values = column[np.isfinite(column)]
        if not len(values):
            continue

        median = np.median(values)
        low = values.min()
        high = values.max()
        step = float(np.abs(np.diff(values)).max(initial=0.0))
        if 240.0 < median < 420.0:
            text = f"is {median:.4g} in the median"
            yield finding_of("temperature_in_kelvin", text, name, "temperature")
        elif low == high == 0.0:
            text = "is exactly 0 throughout"
            yield finding_of("temperature_nonsense", text, name, "temperature")
        elif low < -40.0 or high > 200.0 or step > 20.0:
            text = (
                f"runs from {low:.4g} to {high:.4g} degC, in steps of up to"
                f" {step:.3g} K"
            )
            yield finding_of("temperature_nonsense", text, name, "temperature")
