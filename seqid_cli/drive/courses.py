"""Whether commands hold between two stamps, or are interpolated.

Within the band of the fit a held command is one that is half a period late. Above it
the steps show, in the torque alone.
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from seqid_cli.drive.equations import PROPORTIONAL
from seqid_cli.drive.row_fit import JointFit
from seqid_cli.drive.signals import DriveSignals, command_at
from seqid_cli.motion.filters.butterworth import Lowpass

# Of the torque above the band: a course that leaves so much less is the right one.
CLEARLY = 0.9


def better_course(
    logs: Sequence[DriveSignals], joint: int, fits: Sequence[JointFit]
) -> JointFit:
    """Choose between commands that hold and commands that are interpolated.

    Within the band of the fit a held command is one that is half a period late. Above
    it the steps show, in the torque alone.
    """
    if not all(log.measured and log.sent is not None for log in logs):
        return replace(fits[0], course_is_known=False)
    left = [_left_above(logs, joint, fit) for fit in fits]
    best = int(np.argmin(left))
    is_known = left[best] < CLEARLY * max(left)
    return replace(fits[best] if is_known else fits[0], course_is_known=is_known)


def _left_above(logs: Sequence[DriveSignals], joint: int, fit: JointFit) -> float:
    """Return the mean square of the torque above the band that a course leaves."""
    period_s = logs[0].command_period_s
    total = fit.delays.command + fit.delays.torque
    gain = fit.values[PROPORTIONAL]
    best = np.inf
    for delay in total + np.arange(-0.5, 0.5, 0.05) * period_s:
        squares = []
        for log in logs:
            assert log.raw.tau is not None
            command = command_at(log, fit.course, joint, log.raw.t - delay)
            rest = log.raw.tau[:, joint] - gain * command
            lowpass = Lowpass(log.cutoff_hz, log.rate_hz)
            above = rest - lowpass(rest[:, None], log.raw.valid)[:, 0]
            squares.append(above[log.usable[:, joint]] ** 2)
        best = min(best, float(np.mean(np.concatenate(squares))))
    return best
