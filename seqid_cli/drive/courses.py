"""Whether commands hold between two stamps, or are interpolated.

Within the band of the fit a held command is one that is half a period late. Above it
the steps show, in the torque alone.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from seqid_cli.drive.equations import Delays
from seqid_cli.drive.signals import DriveSignals, command_at
from seqid_cli.motion.filters.butterworth import Lowpass
from seqid_cli.typing import Array

# Of the torque above the band: a course that leaves so much less is the right one.
CLEARLY = 0.9
# Of a command's period, in which delays are tried: steps pass a row within a moment.
DELAY_STEP = 0.01


@dataclass(frozen=True, kw_only=True)
class Candidate:
    """What commands may do between two stamps, with delays that suit it."""

    course: str
    delays: Delays


def tells_course(logs: Sequence[DriveSignals]) -> bool:
    """Tell whether logs can show what commands do between two stamps."""
    return all(log.measured and log.sent is not None for log in logs)


def better_course(
    logs: Sequence[DriveSignals], joint: int, candidates: Sequence[Candidate]
) -> int | None:
    """Return the number of the candidate that leaves least, None where none is clear.

    Within the band of the fit a held command is one that is half a period late. Above
    it the steps show, in the torque alone.
    """
    left = [_left_above(logs, joint, candidate) for candidate in candidates]
    best = int(np.argmin(left))
    return best if left[best] < CLEARLY * max(left) else None


def _left_above(
    logs: Sequence[DriveSignals], joint: int, candidate: Candidate
) -> float:
    """Return the mean square of the torque above the band that a course leaves.

    The gain that suits it best is taken away from the torque: steps are all that is
    there.
    """
    period_s = logs[0].command_period_s
    total = candidate.delays.command + candidate.delays.torque
    torque = [_above(log, joint, log.raw.tau) for log in logs]
    best = np.inf
    for delay in total + np.arange(-0.5, 0.5, DELAY_STEP) * period_s:
        command = [
            _above(
                log, joint, command_at(log, candidate.course, joint, log.raw.t - delay)
            )
            for log in logs
        ]
        u = np.concatenate(torque)
        c = np.concatenate(command)
        gain = max(0.0, float(c @ u)) / max(float(c @ c), 1e-300)
        best = min(best, float(np.mean((u - gain * c) ** 2)))
    return best


def _above(log: DriveSignals, joint: int, values: Array | None) -> Array:
    """Return what usable samples of a joint's channel have above the band."""
    assert values is not None
    column = values if values.ndim == 1 else values[:, joint]
    low = Lowpass(log.cutoff_hz, log.rate_hz)(column[:, None], log.raw.valid)[:, 0]
    return np.asarray((column - low)[log.usable[:, joint]])
