"""Efforts that a driver gives without their sign, and the sign put back.

A servo may report the size of its current only. Such a channel comes down to zero and
never goes below, whichever way the joint moves: noise alone would make a signed one
negative half of the time there. A servo that holds a position drives towards its goal,
so that the sign is that of command minus position where the log has commands.
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from seqid_cli.logs.commands import latest_of_samples
from seqid_cli.logs.raw import Array, Mask, Stream
from seqid_cli.robot.types import Robot
from seqid_cli.robust import white_noise

UNSIGNED = "is never negative though the joint moves both ways: it is a magnitude"


def with_signs(
    stream: Stream,
    robot: Robot,
    warnings: list[str],
    *,
    commands: Sequence[Stream] = (),
) -> Stream:
    """Give magnitudes of torque and current the sign of command minus position.

    Parameters
    ----------
    stream : Stream
        Joint samples in the order of time, with `position` (M, n) [rad; m], and
        `command` where the log has it.
    robot : Robot
        Names of the joints.
    warnings : list of str
        A note on each magnitude is added to it, with what was made of it.
    commands : sequence of Stream
        Commands with stamps of their own, as bags have them.
    """
    position = stream.channels["position"]
    command = latest_of_samples(stream, commands, "command")
    channels = dict(stream.channels)
    for quantity in ("torque", "current"):
        if quantity not in channels:
            continue
        values = channels[quantity].copy()
        # A driver that drops the sign of one joint drops that of all.
        joints = [j for j in range(robot.n) if _may_be(values[:, j], position[:, j])]
        if not any(_touches_zero(values[:, j], position[:, j]) for j in joints):
            continue
        for j in joints:
            text = f"{robot.joint_names[j]}: {quantity} {UNSIGNED}"
            if command is not None and np.isfinite(command[:, j]).any():
                towards = np.sign(command[:, j] - position[:, j])
                values[:, j] *= np.where(np.isfinite(towards), towards, 0.0)
                text += "; its sign is taken from command minus position"
            warnings.append(text)
        channels[quantity] = values
    return replace(stream, channels=channels)


def _may_be(
    values: Array,
    position: Array,
    *,
    min_samples: int = 200,
    min_way: float = 0.05,
    min_balance: float = 0.2,
) -> bool:
    """Tell whether an effort (M,) is never negative though its joint moves both ways.

    Parameters
    ----------
    values, position : ndarray, (M,)
        Effort and position [rad; m] of a joint.
    min_samples : int
        Samples below which it may be so by chance.
    min_way, min_balance : float
        Way that the joint moves at least each way, and share of the longer way.
    """
    both = np.isfinite(values) & np.isfinite(position)
    x = values[both]
    if len(x) < min_samples or x.min() < 0.0 or x.max() <= 0.0 or sign_bit(x):
        return False
    change = np.diff(position[both])
    forward = float(np.clip(change, 0.0, None).sum())
    backward = float(np.clip(-change, 0.0, None).sum())
    longer = max(forward, backward)
    return min(forward, backward) >= max(min_way, min_balance * longer)


def _touches_zero(
    values: Array,
    position: Array,
    *,
    noises: float = 2.0,
    min_near: int = 20,
    min_share: float = 0.005,
) -> bool:
    """Tell whether an effort (M,) comes so near to zero that a signed one went below.

    Near are `noises` times its noise, or a step of a coarse channel. There are at least
    `min_near` such values while the joint moves, and `min_share` of all.
    """
    both = np.isfinite(values) & np.isfinite(position)
    x = values[both]
    # One step of a coarse channel is as near to zero as it can tell.
    steps = np.diff(np.unique(x))
    step = float(steps.min()) if len(steps) else 0.0
    is_coarse = step > 0.01 * float(x.max())
    noise = max(noises * float(white_noise(x)), 1.01 * step if is_coarse else 0.0)
    is_moving: Mask = np.abs(np.gradient(position[both])) > 0.0
    near = int(np.count_nonzero((x <= noise) & is_moving))
    return near >= max(min_near, min_share * len(x))


def sign_bit(
    values: Array, *, min_share: float = 0.02, min_turns: int = 4, apart: float = 3.0
) -> str:
    """Return in words that negative values of a channel are read as large ones.

    Parameters
    ----------
    values : (M,) array
        Values, all finite.
    min_share, min_turns : float, int
        Share of small and of large values, and turns from one to the other.
    apart : float
        Multiple of the span of either within which there is no value between them.
    """
    if not len(values) or values.min() < 0.0:
        return ""
    levels = np.unique(values)
    if len(levels) < 4:
        return ""
    widest = int(np.diff(levels).argmax())
    low = float(levels[widest])
    high = float(levels[widest + 1])
    is_large = values >= high
    share = float(is_large.mean())
    turns = np.flatnonzero(np.diff(is_large.astype(np.int8)) != 0)
    span = max(low - float(levels[0]), float(levels[-1]) - high)
    if not min_share < share < 1.0 - min_share or len(turns) < min_turns:
        return ""
    if high - low < apart * span:
        return ""

    # As it goes through zero, a two's complement comes from the top.
    at_turns = np.concatenate([values[turns], values[turns + 1]])
    at_turns = at_turns[at_turns >= high]
    is_complement = levels[-1] - np.median(at_turns) < np.median(at_turns) - high
    size = float(levels[-1]) if is_complement else high
    bits = "2^16, as an unsigned integer reads a two's complement"
    if not is_complement:
        bits = "2^15, as the sign bit in front of a magnitude"
    return f"jumps by {size:.5g} where it changes its sign: {bits}"
