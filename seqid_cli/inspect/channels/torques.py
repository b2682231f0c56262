"""Torque and current, channel by channel."""

from collections.abc import Container, Iterator

import numpy as np
from scipy.ndimage import median_filter

from seqid_cli.inspect.channels.values import (
    clipped,
    equal_runs,
    held,
    lattice,
    missing,
)
from seqid_cli.inspect.dynamics.echo import WARNING, echoes
from seqid_cli.inspect.dynamics.equations import HEAVY, largest_gravity
from seqid_cli.inspect.findings import found
from seqid_cli.inspect.material import LogData
from seqid_cli.params.results.inspection import InspectionFinding
from seqid_cli.robot.types import Array
from seqid_cli.shares import percent
from seqid_cli.typing import Index, Mask


def torque_findings(data: LogData) -> Iterator[InspectionFinding]:
    """Check the torque or current of every joint."""
    effort = data.effort()
    if effort is None:
        yield found("torque_missing", "there is neither torque nor current")
        return
    quantity, values = effort
    for j, joint in enumerate(data.robot.joints):
        for code, text in _of_channel(data, j, values[:, j], quantity):
            yield found(code, text, joint.name, quantity)
    channels, joints = data.robot.channels, data.robot.joints
    drives = any(joint.torque_constant is not None for joint in joints)
    said = channels.effort == "torque" or channels.torque is not None
    light = data.modelled and largest_gravity(data.robot).max() < HEAVY
    if quantity == "torque" and drives and light and not said:
        # Neither the robot file nor the robot's weight tells torque from current.
        text = (
            "could be torque or current: the robot file gives torque_constant, the log"
            " torque"
        )
        yield found("effort_unclear", text, channel=quantity)


def _of_channel(
    data: LogData, j: int, column: Array, quantity: str, *, max_rms: float = 200.0
) -> Iterator[tuple[str, str]]:
    """Yield codes and messages of one joint's channel; no drive takes `max_rms` amperes."""
    present = np.isfinite(column)
    values, t = column[present], data.t[present]
    rms = float(np.sqrt(np.mean(values**2))) if len(values) else 0.0
    if quantity == "current" and rms > max_rms:
        yield "current_in_ma", f"is {rms:.3g} A RMS: it looks like mA"
    if not data.moves(j) or not len(values):
        return
    if not values.any():
        yield "torque_zero", "is zero throughout although the joint moves"
    elif np.ptp(values) == 0.0:
        yield (
            "torque_constant_value",
            f"is {values[0]:.4g} throughout although the joint moves",
        )
    elif stuck := _stuck(values, t, data.moving_samples(j)[present]):
        yield "torque_stuck", stuck
    else:
        if len(spikes := _spikes(values)):
            text = f"is {values[spikes[0]]:.4g} for a moment at {t[spikes[0]]:.3f} s"
            more = f" and {len(spikes) - 1} more times" if len(spikes) > 1 else ""
            yield "torque_spikes", text + more
        if limit := clipped(values):
            yield (
                "torque_saturated",
                f"is at {limit[0]:.4g} in {percent(limit[1])} of the samples",
            )


def _spikes(values: Array, *, min_ratio: float = 10.0, min_share: float = 1.0) -> Index:
    """One sample or two far from both sides; what lasts longer may be a hard acceleration."""
    max_spikes = 16
    if len(values) <= 4 * max_spikes:
        return np.zeros(0, dtype=np.intp)
    off = np.abs(values - median_filter(values, 5, mode="nearest"))
    usual = float(np.partition(off, len(off) - max_spikes)[-max_spikes - 1])
    span = float(np.ptp(np.quantile(values, (0.01, 0.99))))
    rows: Index = np.flatnonzero(off > max(min_ratio * usual, min_share * span))
    return rows if len(rows) <= max_spikes else rows[:0]


def torque_quality(
    data: LogData,
    broken: Container[str],
    *,
    max_step: float = 0.25,
    max_changing: float = 0.6,
) -> Iterator[InspectionFinding]:
    """Check how well torque is measured, but for the joints named in `broken`."""
    quantity, all_values = data.effort() or ("", np.zeros((0, 0)))
    for j, (name, column) in enumerate(
        zip(data.robot.joint_names, all_values.T, strict=False)
    ):
        yield from missing(column, name, quantity)
        if not data.moves(j) or name in broken:
            continue
        present = np.isfinite(column)
        values, moving = column[present], data.moving_samples(j)[present]
        if (size := held(values)) > 1:
            text = f"repeats each value {size} times"
            yield found("channel_held", text, name, quantity)
        step, spread = (
            lattice(values),
            float(values[moving].std()) if moving.any() else 0.0,
        )
        dithered = len(values) > 1 and np.mean(np.diff(values) != 0) > max_changing
        if step and spread and step > max_step * spread and not dithered:
            text = f"comes in steps of {step:.3g}, its spread is {spread:.3g}"
            yield found("torque_quantised", text, name, quantity)


def _stuck(
    values: Array, t: Array, moving: Mask, *, min_samples: int = 50, min_s: float = 0.2
) -> str:
    if moving.sum() < 3 or not np.median(np.diff(values[moving]) != 0):
        return ""  # it repeats itself anyway
    for a, b in equal_runs(values, min_samples):
        seconds, inner = (
            float(t[b - 1] - t[a]),
            values[a] not in (values.min(), values.max()),
        )
        if seconds >= min_s and inner and moving[a:b].mean() > 0.5:
            return f"stays at {values[a]:.4g} for {seconds:.3g} s from {t[a]:.3f} s"
    return ""


def echo_findings(data: LogData) -> Iterator[InspectionFinding]:
    """Find torques that echo a command; noise of a joint that stands makes travel, not motion."""
    log, tau = data.recording, data.recording.tau
    for j in [] if tau is None else echoes(data.robot, log.t, log.q, tau, log.valid):
        if data.moves(j):
            yield found("torque_echo", WARNING, data.robot.joint_names[j])


def sensor_findings(
    data: LogData, *, opposed: float = -0.5
) -> Iterator[InspectionFinding]:
    """Check torque sensors behind the gear and encoders on the link against the motor's side."""
    _, torque = data.effort() or ("", None)
    for channel, motor in (
        ("load", torque),
        ("link_position", data.joints.channels["position"]),
    ):
        values = data.joints.channels.get(channel)
        if values is None or motor is None:
            continue
        for j, name in enumerate(data.robot.joint_names):
            both = (
                data.moving_samples(j)
                & np.isfinite(values[:, j])
                & np.isfinite(motor[:, j])
            )
            a, b = values[both, j], motor[both, j]
            varied = both.sum() > 1 and a.std() * b.std() > 0.0
            together = float(np.corrcoef(a, b)[0, 1]) if varied else 0.0
            if together < opposed:
                text = (
                    "runs against the motor's side: their correlation is"
                    f" {together:.2f}"
                )
                yield found("sensor_sign", text, name, channel)


def temperature_findings(data: LogData) -> Iterator[InspectionFinding]:
    """Check the temperatures."""
    temperatures = data.joints.channels.get("temperature", np.zeros((0, data.robot.n)))
    for name, column in zip(data.robot.joint_names, temperatures.T, strict=True):
        values = column[np.isfinite(column)]
        low, high = (values.min(), values.max()) if len(values) else (20.0, 20.0)
        step = float(np.abs(np.diff(values)).max(initial=0.0))
        text, code = "", "temperature_nonsense"
        if len(values) and 240.0 < np.median(values) < 420.0:
            text, code = (
                f"is {np.median(values):.4g} in the median",
                "temperature_in_kelvin",
            )
        elif low == high == 0.0:
            text = "is exactly 0 throughout"
        elif low < -40.0 or high > 200.0 or step > 20.0:
            text = (
                f"runs from {low:.4g} to {high:.4g} degC, in steps of up to"
                f" {step:.3g} K"
            )
        if text:
            yield found(code, text, name, "temperature")
