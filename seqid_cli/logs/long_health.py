"""What a pass over a long log tells of its health, as `read_recording` does of a whole one."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from seqid_cli.logs.checks import echo, health
from seqid_cli.logs.raw import Array, Stream
from seqid_cli.logs.timebase import JITTER_LIMIT
from seqid_cli.robot.types import Robot

ECHO_ROWS = 131_072  # rows from the start on in which an echo of the command is looked for


@dataclass
class LongHealth:
    """Gathers what the checks need, rows after rows."""

    robot: Robot
    _lowest: Array | None = None
    _highest: Array | None = None
    _squares: Array | None = None  # of the currents that are there
    _counts: Array | None = None
    _common: dict[str, None] | None = None  # what was noticed in every block
    _start: list[Array] = field(default_factory=list)
    _rows: int = 0

    def push(self, joints: Stream, tau: Array, noticed: list[str]) -> None:
        """Take the next rows, their torque (M, n) N m and what was noticed of that."""
        q = joints.channels["position"]
        low, high = q.min(axis=0), q.max(axis=0)
        self._lowest = low if self._lowest is None else np.minimum(self._lowest, low)
        self._highest = high if self._highest is None else np.maximum(self._highest, high)
        if "current" in joints.channels:
            self._push_current(joints.channels["current"])
        common = dict.fromkeys(noticed)
        if self._common is not None:
            common = {text: None for text in self._common if text in common}
        self._common = common
        if self._rows < ECHO_ROWS:
            self._start.append(np.hstack([q, tau]))
        self._rows += len(q)

    def _push_current(self, current: Array) -> None:
        there = np.isfinite(current)
        squares = np.where(there, current, 0.0) ** 2
        zero = np.zeros(current.shape[1])
        self._squares = (zero if self._squares is None else self._squares) + squares.sum(axis=0)
        self._counts = (zero if self._counts is None else self._counts) + there.sum(axis=0)

    def warnings(self, rate_hz: float, jitter: float) -> list[str]:
        """Return the warnings, once all rows have come."""
        if self._lowest is None or self._highest is None:
            return []
        found = list(self._common or ())
        if self._squares is not None and self._counts is not None:
            rms = np.sqrt(self._squares / np.maximum(self._counts, 1))
            found += health.current_warnings(self.robot, rms[None])
        found += health.clock_warnings(rate_hz, jitter, JITTER_LIMIT)
        extremes = np.stack([self._lowest, self._highest])
        found += health.position_warnings(self.robot, np.arange(2.0), extremes, None)
        return found + self._echoes(rate_hz)

    def _echoes(self, rate_hz: float) -> list[str]:
        rows = np.concatenate(self._start)[:ECHO_ROWS]
        n = self.robot.n
        t, valid = np.arange(len(rows)) / rate_hz, np.ones(len(rows), np.bool_)
        return echo.echo_warnings(self.robot, t, rows[:, :n], rows[:, n:], valid)
