"""Options of a plan; kept free of heavy imports for the command line."""

from __future__ import annotations

from dataclasses import dataclass

MOVE_RAMPS = 20.0  # length of a move over the time from rest to the largest speed


@dataclass(frozen=True)
class PlanOptions:
    """Durations in s; see `docs/deciding_numbers.md` for the numbers.

    `duration_s` is the time that the moves of the inertia stage may take, `together` whether all
    joints move at once in them instead of two, `pool` how many moves are drawn to choose from and
    `sweeps` how often each chosen one is refined.
    """

    duration_s: float = 150.0
    move_s: float = 10.0
    together: bool = False
    pool: int = 600
    sweeps: int = 2
    seed: int = 0
