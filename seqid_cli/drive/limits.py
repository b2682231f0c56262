"""Limits of a joint's torque and speed, and the rows that are near them.

Rows at the limit of the torque follow another law. A fit without the largest torques
predicts what would be beyond it; where that is much more than was ever measured, there
is a limit.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.ndimage import binary_dilation

from seqid_cli.drive.equations import Delays, JointLaw
from seqid_cli.drive.search import Solution
from seqid_cli.drive.signals import shifted
from seqid_cli.motion.filters.differentiation import runs
from seqid_cli.typing import Mask

# The largest torques are left out of the first fit of all.
TOP_SHARE = 0.9
# A torque that would be so many times the largest one that was measured is cut off.
BEYOND = 1.1
BEYOND_ROWS = 5  # that are, for a limit to be there
NEAR_LIMIT = 0.97  # of a limit, from which rows follow another law
GUARD_S = 0.03  # on either side of them
# The shortest time at a speed that is a limit and no peak.
PLATEAU_S = 0.1


@dataclass(frozen=True, kw_only=True)
class Limit:
    """The limit of a torque [N m], and where it was reached."""

    value: float
    std_error: float
    rows: int


def below(law: JointLaw, of: Sequence[Mask], limit: float) -> list[Mask]:
    """Return samples of each log without those near or above a torque [N m]."""
    masks = []
    for log, used in zip(law.logs, of, strict=True):
        guard = max(1, round(GUARD_S * log.rate_hz))
        torque = log.raw.tau if log.measured else log.torque
        assert torque is not None
        high = np.abs(torque[:, law.joint]) > limit
        around = np.ones(2 * guard + 1, dtype=np.bool_)
        masks.append(used & ~binary_dilation(high, around))
    return masks


def torque_limit_of(
    law: JointLaw, names: Sequence[str], solution: Solution, largest: float
) -> Limit | None:
    """Find the limit of the torque: where more is predicted than was ever measured.

    Parameters
    ----------
    law : JointLaw
        With all rows, those at a limit too.
    names, solution
        The law's parts and their numbers, from other rows.
    largest : float
        N m, that was measured.
    """
    at_limit = []
    for log, used in zip(law.logs, law.used, strict=True):
        columns, _ = law.columns(log, names, solution.delays)
        inside = used & np.isfinite(columns).all(axis=1)
        if not inside.any():
            continue
        predicted = columns @ solution.theta
        offset = np.median((log.torque[:, law.joint] - predicted)[inside])
        beyond = inside & (np.abs(predicted + offset) > BEYOND * largest)
        torque = log.raw.tau if log.measured else log.torque
        assert torque is not None
        at_limit.append(np.abs(torque[beyond, law.joint]))
    torques = np.concatenate(at_limit) if at_limit else np.zeros(0)
    # What lies well below belongs to a law that does not hold there, not to a limit.
    high = torques[torques > TOP_SHARE * largest]
    if len(high) < BEYOND_ROWS or len(high) < 0.5 * len(torques):
        return None
    value = float(np.median(high))
    # Neighbouring rows are one reading.
    std_error = float(1.25 * high.std() / np.sqrt(max(1.0, len(high) / 5.0)))
    return Limit(value=value, std_error=std_error, rows=len(high))


def speed_limit_of(law: JointLaw, delays: Delays, fastest: float) -> Limit | None:
    """Find a limit of the speed: a joint stays at it while its command runs faster.

    Near a peak of its own a joint is as fast for a moment only.
    """
    speeds = []
    for log, used in zip(law.logs, law.lawful, strict=True):
        total = (delays.command + delays.torque) * log.rate_hz
        command = log.commands[law.course].c[:, law.joint]
        asked = np.abs(np.gradient(command)) * log.rate_hz
        asked = np.nan_to_num(shifted(asked, total))
        speed = np.abs(log.dq[:, law.joint])
        at_limit = used & (speed > NEAR_LIMIT * fastest) & (asked > BEYOND * fastest)
        for start, stop in runs(at_limit, len(at_limit)):
            if stop - start >= PLATEAU_S * log.rate_hz:
                speeds.append(speed[start:stop])
    if not speeds:
        return None
    pooled = np.concatenate(speeds)
    return Limit(
        value=float(np.median(pooled)),
        # Each plateau is one reading.
        std_error=float(pooled.std() / np.sqrt(len(speeds))),
        rows=len(pooled),
    )
