"""Moves of a plan that have been recorded: their positions are looked for in all logs.

For a move of positions p_j, sampled as the log's are, the mean square distance to the
log's q_j at an offset k is a sum of three correlations with the mask m of valid
samples,

    D_j(k) = [sum m q_j^2 - 2 sum m q_j p_j + sum m p_j^2] / sum m,

so that offsets that reach over the log's ends or over gaps count by what is there.
Distances of joint j are in a unit u_j, by which a joint that travels far and one that
travels little count alike.
"""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from msgspec import structs

from seqid_cli.errors import ConfigError
from seqid_cli.inspect.screening import Screened, read_screened
from seqid_cli.inspect.settings import InspectSettings
from seqid_cli.logs.reading import HEADER_STAMPS, Reading
from seqid_cli.motion.planned import sampled
from seqid_cli.params.io import read_any
from seqid_cli.params.results.inspection import PlannedPart
from seqid_cli.params.results.plan import PlanFile, PlannedMove
from seqid_cli.robot.types import Array, Robot
from seqid_cli.shares import percent
from seqid_cli.spectra import correlated

RATE_HZ = 20.0  # of positions that are compared
ORDER = ("missing", "spoiled", "recorded")


def recorded_parts(
    plan: Path,
    robot: Robot,
    logs: Sequence[Path],
    reading: Reading = HEADER_STAMPS,
    settings: InspectSettings = InspectSettings(),
) -> list[PlannedPart]:
    """Return for each move of a plan whether it is recorded, missing or spoiled.

    Parameters
    ----------
    plan : Path
        A plan file.
    robot : Robot
        The arm that it is of.
    logs : sequence of Path
        Logs in which the moves are looked for.
    reading : Reading
        By which stamps logs are read, and which part of them.
    settings : InspectSettings
        What spoils a move is found by them.

    Raises
    ------
    ConfigError
        The file is no plan, or one for other joints.
    """
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
        read_screened(log, robot, imus=False, reading=reading, settings=settings)
        for log in logs
    )
    return compared(file, robot.joint_names, screened)


@dataclass(frozen=True)
class _Positions:
    """Positions of a log at `RATE_HZ`: q (N, n) rad, zero where they are not valid."""

    q: Array
    valid: Array  # (N,) 1.0 or 0.0


def compared(
    plan: PlanFile, names: Sequence[str], logs: Iterable[Screened]
) -> list[PlannedPart]:
    """Compare the moves of a plan with logs.

    Parameters
    ----------
    plan : PlanFile
        The plan.
    names : sequence of str
        The robot's joints in their order.
    logs : iterable of Screened
        Logs with their findings.

    Returns
    -------
    list of PlannedPart
        One per move, of the log that shows most of it.
    """
    best = [
        PlannedPart(move=move.name, stage=move.stage, status="missing")
        for move in plan.moves
    ]
    for log in logs:
        positions = _positions(log)
        errors = [f.message for f in log.findings if f.severity == "error"]
        for k, move in enumerate(plan.moves):
            for speed_scale in dict.fromkeys((1.0, plan.speed_scale)):
                part = _look_for(plan, move, names, positions, speed_scale)
                part.log = str(log.recording.path)
                if part.status == "recorded" and errors:
                    part.status = "spoiled"
                    part.reason = errors[0]
                best[k] = max(best[k], part, key=_rank)
    return best


def _rank(part: PlannedPart) -> tuple[int, float]:
    """Return what makes a part the better of two: its status, then its share."""
    return ORDER.index(part.status), part.share


def _positions(log: Screened) -> _Positions:
    """Return a log's positions at `RATE_HZ`, by the sample after each time."""
    t = log.recording.t
    times = np.arange(t[0], t[-1], 1.0 / RATE_HZ)
    rows = np.searchsorted(t, times).clip(0, len(t) - 1)
    valid = log.recording.valid[rows].astype(float)
    q = np.where(valid[:, None] > 0, log.recording.q[rows], 0.0)
    return _Positions(q=q, valid=valid)


def _look_for(
    plan: PlanFile,
    move: PlannedMove,
    names: Sequence[str],
    log: _Positions,
    speed_scale: float,
    *,
    least_share: float = 0.3,
    whole: float = 0.97,
    follows: float = 0.05,
    resembles: float = 0.25,
) -> PlannedPart:
    """Look for one move in one log, by distances in shares of each joint's motion."""
    missing = PlannedPart(move=move.name, stage=move.stage, status="missing")
    p = sampled(move, names, RATE_HZ / speed_scale)[1]
    if len(log.q) < least_share * len(p):
        return missing

    # A joint that stays must stay as well: a tenth of its range is its unit.
    ranges = np.array([np.ptp(plan.limits[name].position) for name in names])
    unit = np.maximum(np.ptp(p, axis=0), 0.1 * ranges)
    unit = np.where(unit > 0.0, unit, 1.0)
    distance = _mean_distance(log, p, unit, least_share)
    if distance is None:
        return missing

    # The sample of the log at which the move begins, and what of both overlaps.
    start = int(np.argmin(distance)) - len(p) + 1
    of_move = slice(max(0, -start), min(len(p), len(log.q) - start))
    of_log = slice(max(0, start), min(len(log.q), start + len(p)))
    valid = log.valid[of_log] > 0
    error = log.q[of_log][valid] - p[of_move][valid]
    rms_error = np.sqrt(np.mean(error**2, axis=0))
    share = float(valid.sum() / len(p))
    worst = int(np.argmax(rms_error / unit))
    if rms_error[worst] > resembles * unit[worst]:
        return missing

    reason = ""
    if rms_error[worst] > follows * unit[worst]:
        reason = f"joint {names[worst]} is {rms_error[worst]:.3g} rad (RMS) off"
    elif speed_scale < 1.0:
        reason = f"at {speed_scale:.2g} of the planned speed"
    elif share < whole:
        reason = f"only {percent(share, 0)} of it is in the log"
    return structs.replace(
        missing,
        status="spoiled" if reason else "recorded",
        reason=reason,
        start=start / RATE_HZ,
        share=share,
    )


def _mean_distance(
    log: _Positions, p: Array, unit: Array, least_share: float
) -> Array | None:
    """Return D summed over joints at all offsets (N + P - 1,); None where none counts.

    Offsets at which less than `least_share` of the move (P, n) is in the log are
    infinitely far.
    """
    ones = np.ones(len(p))
    n_valid = correlated(log.valid, ones)
    squares = np.sum(((log.q / unit) ** 2) * log.valid[:, None], axis=1)
    distance = correlated(squares, ones)
    distance += correlated(log.valid, np.sum((p / unit) ** 2, axis=1))
    for j in range(len(unit)):
        distance -= 2.0 * correlated(
            log.valid * log.q[:, j] / unit[j], p[:, j] / unit[j]
        )
    counts = n_valid >= least_share * len(p)
    if not counts.any():
        return None
    return np.where(counts, distance / np.maximum(n_valid, 1.0), np.inf)
