"""Tables of many short recordings behind each other, each with a clock of its own.

A LeRobot data set numbers them in a column `episode_index`, and its time begins again
with each. They become stretches of one log with a gap between them, never joined.
"""

from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from seqid_cli.logs.raw import Array, Rows, Stamps


@dataclass(frozen=True)
class Stretches:
    """Rows of a table with episodes laid one behind the other."""

    stamps: Stamps  # (M,) ns, of all rows
    rows: Rows  # (K,) that have a stamp and an episode
    notes: list[str]


def separate(stamps: Stamps, rows: Rows, episode: Array, name: str) -> Stretches:
    """Lay episodes one behind the other; the stamps of a single one stay as they are.

    Parameters
    ----------
    stamps : ndarray of int, (M,)
        Stamps of all rows [ns].
    rows : ndarray of int, (K,)
        The rows that have one.
    episode : ndarray, (M,)
        Number of each row's episode, NaN where it is missing.
    name : str
        The column of these numbers, for notes.
    """
    hole_s, hole_intervals = 1.0, 50  # between episodes, at least

    is_numbered = np.isfinite(episode[rows])
    n_lost = int(np.count_nonzero(~is_numbered))
    notes = [f"{n_lost} rows without {name} were left out"] if n_lost else []
    rows = rows[is_numbered]
    runs = np.split(rows, np.flatnonzero(np.diff(episode[rows])) + 1)
    if len(runs) == 1:
        return Stretches(stamps, rows, notes)

    # Holes are whole mean intervals of the episodes, so that they fit the time base.
    interval_ns = _mean_interval(stamps, runs)
    n_intervals = max(hole_intervals, np.ceil(hole_s * 1e9 / interval_ns))
    hole_ns = round(interval_ns * n_intervals)
    moved = stamps.copy()
    for before, run in pairwise(runs):
        moved[run] += int(moved[before].max()) + hole_ns - int(stamps[run].min())
    notes.append(
        f"{len(runs)} episodes ({name}) are read as stretches with a gap of"
        f" {hole_ns * 1e-9:.3g} s between them"
    )
    return Stretches(moved, rows, notes)


def _mean_interval(stamps: Stamps, runs: list[Rows]) -> float:
    """Return the mean interval [ns] in episodes without gaps; one second if none."""
    steps = np.concatenate([np.diff(stamps[run]) for run in runs])
    steps = steps[steps > 0]
    if not len(steps):
        return 1e9
    return float(np.mean(steps[steps < 1.5 * np.median(steps)]))
