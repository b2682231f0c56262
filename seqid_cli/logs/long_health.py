"""What a pass over a long log tells of its health, as `read_recording` does of a whole one."""

from dataclasses import dataclass, field

import numpy as np

from seqid_cli.logs.checks import echo, health
from seqid_cli.logs.raw import Array, Stream
from seqid_cli.logs.timebase import JITTER_LIMIT
from seqid_cli.robot.types import Robot


@dataclass
class LongHealth:
    """Gathers what the checks need, rows after rows.

    An echo of the command is looked for in the first `echo_rows` rows.
    """

    robot: Robot
    echo_rows: int = 131_072
    _extremes: list[Array] = field(default_factory=list)  # (2, n) per block
    _currents: list[Array] = field(default_factory=list)  # (2, n): squares and how many
    _noticed: list[list[str]] = field(default_factory=list)
    _start: list[Array] = field(default_factory=list)
    _rows: int = 0

    def push(self, joints: Stream, tau: Array, noticed: list[str]) -> None:
        """Take the next rows, their torque (M, n) N m and what was noticed of that."""
        q = joints.channels["position"]
        self._extremes.append(np.stack([q.min(axis=0), q.max(axis=0)]))
        self._noticed.append(noticed)
        if "current" in joints.channels:
            current = joints.channels["current"]
            there = np.isfinite(current)
            squares = np.where(there, current, 0.0) ** 2
            self._currents.append(np.stack([squares.sum(axis=0), there.sum(axis=0)]))
        if self._rows < self.echo_rows:
            self._start.append(np.hstack([q, tau]))
        self._rows += len(q)

    def warnings(self, rate_hz: float, jitter: float) -> list[str]:
        """Return the warnings, once all rows have come; of torque what every block shows."""
        if not self._extremes:
            return []
        first, *others = self._noticed
        found = [text for text in dict.fromkeys(first) if all(text in one for one in others)]
        if self._currents:
            squares, counts = np.sum(self._currents, axis=0)
            rms = np.sqrt(squares / np.maximum(counts, 1))
            found += health.current_warnings(self.robot, rms[None])
        found += health.clock_warnings(rate_hz, jitter, JITTER_LIMIT)
        extremes = np.concatenate(self._extremes)
        t = np.arange(float(len(extremes)))
        found += health.position_warnings(self.robot, t, extremes, None)
        return found + self._echoes(rate_hz)

    def _echoes(self, rate_hz: float) -> list[str]:
        rows = np.concatenate(self._start)[: self.echo_rows]
        n = self.robot.n
        t, valid = np.arange(len(rows)) / rate_hz, np.ones(len(rows), np.bool_)
        return echo.echo_warnings(self.robot, t, rows[:, :n], rows[:, n:], valid)
