"""Episodes of one table as stretches of one recording, never joined.

A data set may hold many short recordings behind each other, each with a clock of its own that
begins again (LeRobot's `episode_index`). Their stamps are laid one behind the other with a hole
between them that counts as a gap, so that nothing is interpolated or differentiated across.
"""

from itertools import pairwise

import numpy as np

from seqid_cli.logs.raw import Array, Rows, Stamps


def separate(
    stamps: Stamps,
    keep: Rows,
    episode: Array,
    name: str,
    *,
    hole_s: float = 1.0,
    hole_intervals: int = 50,
) -> tuple[Stamps, Rows, list[str]]:
    """Lay episodes one behind the other; one alone stays as it is.

    `stamps` (M,): of the rows [ns]. `keep` (K,): the rows that have one. `episode` (M,): number,
    NaN where missing. `name`: its column. `hole_s`, `hole_intervals`: the hole between episodes has
    so many seconds and intervals at least. Returns: new stamps, the rows of an episode, notes.
    """
    numbered = np.isfinite(episode[keep])
    lost = int(np.count_nonzero(~numbered))
    notes = [f"{lost} rows without {name} were left out"] if lost else []
    keep = keep[numbered]
    if not len(keep):
        return stamps, keep, notes
    ends = [0, *(np.flatnonzero(np.diff(episode[keep]) != 0) + 1).tolist(), len(keep)]
    runs = [keep[start:end] for start, end in pairwise(ends)]
    if len(runs) == 1:
        return stamps, keep, notes
    interval = _interval(stamps, runs)
    hole = round(interval * max(hole_intervals, np.ceil(hole_s * 1e9 / interval)))
    moved = stamps.copy()
    latest = int(stamps[runs[0]].max())
    for run in runs[1:]:
        earliest = int(stamps[run].min())
        moved[run] = stamps[run] - earliest + latest + hole
        latest = int(moved[run].max())
    notes.append(
        f"{len(runs)} episodes ({name}) are read as stretches with a gap of {hole * 1e-9:.3g} s "
        "between them"
    )
    return moved, keep, notes


def _interval(stamps: Stamps, runs: list[Rows]) -> float:
    """Mean interval inside the episodes, gaps left out [ns]: the holes then fit the time base."""
    steps = np.concatenate([np.diff(stamps[run]) for run in runs])
    forward = steps[steps > 0]
    if not len(forward):
        return 1e9
    return float(np.mean(forward[forward < 1.5 * np.median(forward)]))
