"""Commands against what the joint does: how far it lags, and what its drive follows.

The lag l of a quantity x behind its command c is where x(t + l) - c(t), less its mean,
is smallest. It is searched on a grid of whole samples. Between them, and for its error,
one Newton step is taken in each block of some seconds:

    dl = - sum (r x') / sum x'^2,    r = x(t + l) - c(t) - mean.

The blocks' steps, weighted by sum x'^2, give the lag, and their scatter its error. The
lag is that of the loop, the delay of the transport in it: `seqid drive` parts them.
"""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from seqid_cli.inspect.channels.values import clipped
from seqid_cli.inspect.findings import finding_of
from seqid_cli.inspect.material import LogData
from seqid_cli.logs.raw import Rows
from seqid_cli.params.results.inspection import InspectedCommand, InspectionFinding
from seqid_cli.shares import percent
from seqid_cli.typing import Array, Mask

LARGEST_LAG_S = 0.6  # no drive that works lags more
FEWEST = 50  # samples that tell a lag
BLOCK_S = 2.0  # in which the lag is estimated by itself, for its error
# Of the command's variance: where more than this is left at the best lag, the joint
# follows something else.
FOLLOWED = 0.5
# Of the command's standard deviation: differences below it are those of rounding.
EQUAL = 1e-6
DEGREES = 180.0 / np.pi


@dataclass(frozen=True)
class Lag:
    """The lag of a quantity behind its command."""

    seconds: float
    std_s: float | None  # None where one block tells it
    left: float  # share of the command's variance that the shifted quantity leaves
    slope: float  # of the quantity against the command


def commands_of(data: LogData, j: int) -> InspectedCommand | None:
    """Describe the commands of a joint; None where it has none."""
    log = data.recording
    present = [
        quantity
        for quantity, values in _commands(data).items()
        if np.isfinite(values[:, j]).any()
    ]
    if not present:
        return None

    mode = ""
    lag = None
    position = _lag_of(data, "command", j)
    velocity = _lag_of(data, "command_velocity", j)
    if position is not None and position.left < FOLLOWED and not _echoes(data, j):
        mode, lag = "position", position
    elif velocity is not None and velocity.left < FOLLOWED:
        mode, lag = "velocity", velocity
    elif "command_torque" in present and _varies(data, "command_torque", j):
        mode = "torque"
    return InspectedCommand(
        quantities=present,
        form=log.command_form,
        mode=mode,
        lag_s=None if lag is None else lag.seconds,
        lag_std_s=None if lag is None else lag.std_s,
        saturated=_saturated(data, j),
    )


def command_findings(data: LogData) -> Iterator[InspectionFinding]:
    """Check the commanded positions of every joint."""
    if data.recording.command is None:
        return
    for j, name in enumerate(data.robot.joint_names):
        if not data.moves(j):
            continue
        if _echoes(data, j):
            text = "is the measured position, and no command"
            yield finding_of("command_echo", text, name, "command")
            continue
        lag = _lag_of(data, "command", j)
        if lag is None or lag.left < FOLLOWED:
            continue
        text = (
            f"leaves {percent(min(lag.left, 99.0))} of its variance where the position"
            " follows it best"
        )
        for factor, unit in ((DEGREES, "degrees"), (1.0 / DEGREES, "rad")):
            if 0.8 < lag.slope * factor < 1.25:
                text = (
                    f"is {lag.slope:.3g} rad of motion per unit: it looks like {unit}"
                )
        yield finding_of("command_not_followed", text, name, "command")


def _commands(data: LogData) -> dict[str, Array]:
    """Return the commands (N, n) that a log has."""
    log = data.recording
    arrays = {
        "command": log.command,
        "command_velocity": log.command_velocity,
        "command_torque": log.command_torque,
    }
    return {name: values for name, values in arrays.items() if values is not None}


def _varies(data: LogData, quantity: str, j: int) -> bool:
    column = _commands(data)[quantity][:, j]
    return bool(np.ptp(column[np.isfinite(column)]) > 0.0)


def _echoes(data: LogData, j: int) -> bool:
    """Return whether the commanded position is the measured one while a joint moves."""
    log = data.recording
    if log.command is None:
        return False
    rows = log.valid & data.moving[:, j] & np.isfinite(log.command[:, j])
    if np.count_nonzero(rows) < FEWEST:
        return False
    q = log.q[rows, j]
    # Both are interpolated where the log has an uneven clock: not to the last bit.
    limit = max(0.5 * float(data.step[j]), EQUAL * float(q.std()))
    return bool(np.quantile(np.abs(log.command[rows, j] - q), 0.99) <= limit)


def _lag_of(data: LogData, quantity: str, j: int) -> Lag | None:
    """Return the lag behind a commanded position or velocity; None where none shows."""
    command = _commands(data).get(quantity)
    if command is None:
        return None
    log = data.recording
    measured = log.q[:, j]
    if quantity == "command_velocity":
        measured = log.dq[:, j] if log.dq is not None else _slope(measured, log.rate_hz)
    return lag_between(command[:, j], measured, log.valid, log.rate_hz)


def _slope(values: Array, rate_hz: float) -> Array:
    return np.asarray(np.gradient(values, 1.0 / rate_hz))


def lag_between(
    command: Array, measured: Array, valid: Mask, rate_hz: float
) -> Lag | None:
    """Find the lag of a measured quantity behind its command.

    Parameters
    ----------
    command, measured : ndarray, (N,)
        Both on one time base; the command is NaN where there is none.
    valid : ndarray of bool, (N,)
        Samples that are measured.
    rate_hz : float
        Samples per second.

    Returns
    -------
    Lag or None
        None where too few samples have both, or the command does not vary.
    """
    most = round(LARGEST_LAG_S * rate_hz)
    is_used = valid & np.isfinite(command)
    used = np.flatnonzero(is_used)
    used = used[(used >= most) & (used < len(command) - most)]
    if len(used) < FEWEST or np.ptp(command[used]) == 0.0:
        return None

    # Coarse steps first: a fast log has a thousand lags, and the error is smooth.
    coarse = max(1, most // 32)
    shifts = np.arange(-most, most + 1, coarse)
    left = [_left(command, measured, used, int(shift)) for shift in shifts]
    center = int(shifts[int(np.argmin(left))])
    near = np.arange(center - coarse, center + coarse + 1)
    near = near[np.abs(near) <= most]
    left = [_left(command, measured, used, int(shift)) for shift in near]
    shift = int(near[int(np.argmin(left))])

    slope = _slope(measured, rate_hz)[used + shift]
    rest = measured[used + shift] - command[used]
    rest = rest - rest.mean()
    blocks = (used / (BLOCK_S * rate_hz)).astype(np.intp)
    blocks -= blocks[0]
    weights = np.bincount(blocks, slope**2)
    numerators = np.bincount(blocks, -rest * slope)
    moving = weights > 1e-3 * weights.max()
    weights = weights[moving]
    if not weights.sum() > 0.0:
        return None
    steps = numerators[moving] / weights
    mean = float(np.average(steps, weights=weights))
    std = None
    if len(steps) > 1:
        share = weights / weights.sum()
        spread = float(np.sum(share**2 * (steps - mean) ** 2))
        std = float(np.sqrt(spread * len(steps) / (len(steps) - 1)))

    deviation = command[used] - command[used].mean()
    variance = float(np.mean(deviation**2))
    return Lag(
        seconds=shift / rate_hz + float(np.clip(mean, -1.0 / rate_hz, 1.0 / rate_hz)),
        std_s=std,
        left=float(np.mean(rest**2)) / variance,
        slope=float(np.mean(measured[used + shift] * deviation)) / variance,
    )


def _left(command: Array, measured: Array, rows: Rows, shift: int) -> float:
    """Return the variance of what a shift by some samples leaves."""
    return float(np.var(measured[rows + shift] - command[rows]))


def _saturated(data: LogData, j: int) -> float | None:
    """Return the share of samples at a limit of the torque; None where none shows."""
    commands = data.recording.command_torque
    effort = data.effort()
    columns = [] if commands is None else [commands[:, j]]
    if effort is not None:
        columns.append(effort[1][:, j])
    shares = []
    for column in columns:
        limit_and_share = clipped(column[np.isfinite(column)])
        if limit_and_share is not None:
            shares.append(limit_and_share[1])
    return max(shares, default=None)
