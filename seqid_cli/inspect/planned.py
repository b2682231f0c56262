"""Which moves of a plan have been recorded: each is looked for in every log by its positions.

For a move of positions p_j, sampled as the log's are, the mean square distance to the
log's q_j at an offset k is a sum of three correlations with the mask m of valid
samples,

    D_j(k) = [sum m q_j^2 - 2 sum m q_j p_j + sum m p_j^2] / sum m,

so that offsets that reach over the log's ends or over gaps count by what is there.
"""

from collections.abc import Iterable, Sequence
from pathlib import Path

import numpy as np
from msgspec import structs
from scipy.signal import correlate

from seqid_cli.errors import ConfigError
from seqid_cli.inspect.screening import Screened, read_screened
from seqid_cli.logs.raw import TimeSource
from seqid_cli.motion.planned import sampled
from seqid_cli.params.io import read_any
from seqid_cli.params.results.inspection import PlannedPart
from seqid_cli.params.results.plan import PlanFile, PlannedMove
from seqid_cli.robot.types import Array, Robot
from seqid_cli.shares import percent

RATE_HZ = 20.0  # of positions that are compared
ORDER = ("missing", "spoiled", "recorded")


def recorded_parts(
    plan: Path, robot: Robot, logs: Sequence[Path], time_source: TimeSource = "header"
) -> list[PlannedPart]:
    """Say of each move of a plan whether it is recorded, missing or spoiled."""
    (source,) = read_any([plan])
    file = source.content
    if not isinstance(file, PlanFile):
        raise ConfigError(
            "is no plan", where=str(plan), hint="Give what seqid plan -o wrote."
        )
    if tuple(file.robot.joints) != robot.joint_names:
        hint = f"It is of {file.robot.name}: give that robot file."
        raise ConfigError("is a plan for other joints", where=str(plan), hint=hint)
    screened = (
        read_screened(log, robot, imus=False, time_source=time_source) for log in logs
    )
    return compared(file, robot.joint_names, screened)


def compared(
    plan: PlanFile, names: Sequence[str], logs: Iterable[Screened]
) -> list[PlannedPart]:
    """Compare the moves of a plan with logs; the best log of each counts."""
    best = [
        PlannedPart(move=move.name, stage=move.stage, status="missing")
        for move in plan.moves
    ]
    for log in logs:
        t = log.recording.t
        nearest = np.searchsorted(t, np.arange(t[0], t[-1], 1.0 / RATE_HZ)).clip(
            0, len(t) - 1
        )
        valid = log.recording.valid[nearest].astype(float)
        q = np.where(valid[:, None] > 0, log.recording.q[nearest], 0.0)
        errors = [f.message for f in log.findings if f.severity == "error"]
        for k, move in enumerate(plan.moves):
            for scale in dict.fromkeys((1.0, plan.speed_scale)):
                part = _found(plan, move, names, q, valid, scale)
                part.log = str(log.recording.path)
                if part.status == "recorded" and errors:
                    part.status, part.reason = "spoiled", errors[0]
                best[k] = max(
                    best[k], part, key=lambda x: (ORDER.index(x.status), x.share)
                )
    return best


def _found(
    plan: PlanFile,
    move: PlannedMove,
    names: Sequence[str],
    q: Array,
    valid: Array,
    scale: float,
    *,
    least_share: float = 0.3,
    whole: float = 0.97,
    follows: float = 0.05,
    resembles: float = 0.25,
) -> PlannedPart:
    """Look for one move in one log; distances count in shares of each joint's motion."""
    missing = PlannedPart(move=move.name, stage=move.stage, status="missing")
    p = sampled(move, names, RATE_HZ / scale)[1]
    if len(q) < least_share * len(p):
        return missing
    ranges = np.array([np.ptp(plan.limits[name].position) for name in names])
    unit = np.maximum(np.ptp(p, axis=0), 0.1 * ranges)
    unit = np.where(unit > 0.0, unit, 1.0)
    there = correlate(valid, np.ones(len(p)), method="fft")
    squares = np.sum(((q / unit) ** 2) * valid[:, None], axis=1)
    distance = correlate(squares, np.ones(len(p)), method="fft")
    distance += correlate(valid, np.sum((p / unit) ** 2, axis=1), method="fft")
    for j in range(len(names)):
        distance -= 2.0 * correlate(
            valid * q[:, j] / unit[j], p[:, j] / unit[j], method="fft"
        )
    open_ = there >= least_share * len(p)
    if not open_.any():
        return missing
    mean = np.where(open_, distance / np.maximum(there, 1.0), np.inf)
    # the sample of the log at which the move begins
    k = int(np.argmin(mean)) - len(p) + 1
    own, log = (
        slice(max(0, -k), min(len(p), len(q) - k)),
        slice(max(0, k), min(len(q), k + len(p))),
    )
    seen = valid[log] > 0
    off = np.sqrt(np.mean((q[log][seen] - p[own][seen]) ** 2, axis=0))
    share, worst = float(seen.sum() / len(p)), int(np.argmax(off / unit))
    if off[worst] > resembles * unit[worst]:
        return missing
    reason = ""
    if off[worst] > follows * unit[worst]:
        reason = f"joint {names[worst]} is {off[worst]:.3g} rad (RMS) off"
    elif scale < 1.0:
        reason = f"at {scale:.2g} of the planned speed"
    elif share < whole:
        reason = f"only {percent(share, 0)} of it is in the log"
    status, start = "spoiled" if reason else "recorded", k / RATE_HZ
    return structs.replace(
        missing, status=status, reason=reason, start=start, share=share
    )
