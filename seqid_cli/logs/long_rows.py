"""What the first pass over a long log remembers of its stamps, and the time base that follows."""

from dataclasses import dataclass, field

import numpy as np

from seqid_cli.logs.clocks import BURSTS, GAP_INTERVALS, GAP_LEAST_S
from seqid_cli.logs.raw import Array, RawLog, Stamps
from seqid_cli.logs.thinned import Thinned
from seqid_cli.logs.timebase import JITTER_LIMIT, UNIFORM

MARGIN = 64  # rows on either side of a block, over which a spline forgets its ends
GROUP = 256  # rows whose distance from the base is remembered by its extremes


class UnevenError(Exception):
    """The log has to be read as a whole."""


@dataclass
class Scan:
    """What the first pass remembers of the stamps."""

    count: int = 0
    first: int = 0
    last: int = 0
    usual: float = 0.0  # ns, the median step of the first block
    sums: Array = field(default_factory=lambda: np.zeros(2))  # of steps below the least gap
    beyond: list[Array] = field(default_factory=list)  # steps above it
    surplus: float = 0.0  # samples missing in longer steps
    steps: Thinned = field(default_factory=Thinned)
    off: list[Array] = field(default_factory=list)  # (groups, 3): row, least and most distance
    partial: str = ""
    warnings: list[str] = field(default_factory=list)

    def push(self, stamps: Stamps, raw: RawLog) -> None:
        """Take the stamps of the next rows, and what was said of them."""
        self.partial = raw.partial or self.partial
        self.warnings += [note for note in raw.warnings if note not in self.warnings]
        if self.count:
            steps = np.diff(stamps, prepend=np.int64(self.last)).astype(np.float64)
        else:
            self.first = int(stamps[0])
            steps = np.diff(stamps).astype(np.float64)
            if not len(steps):
                raise UnevenError
            self.usual = float(np.median(steps))
        self._note_steps(steps)
        self._note_distance(stamps)
        self.count += len(stamps)
        self.last = int(stamps[-1])

    def _note_steps(self, steps: Array, *, most_gaps: int = 100000) -> None:
        self.steps.push(steps)
        far = steps > GAP_LEAST_S * 1e9
        near = steps[~far] if far.any() else steps
        if far.any():
            self.beyond.append(steps[far])
            if sum(map(len, self.beyond)) > most_gaps:
                raise UnevenError
        self.sums += (near.sum(), np.square(near - self.usual).sum())
        longer = near[near > 1.5 * self.usual]
        self.surplus += float((np.rint(longer / self.usual) - 1).sum())

    def _note_distance(self, stamps: Stamps) -> None:
        index = self.count + np.arange(len(stamps))
        off = (stamps - self.first) - index * self.usual
        starts = np.arange(0, len(off), GROUP)
        least, most = (extreme.reduceat(off, starts) for extreme in (np.minimum, np.maximum))
        self.off.append(np.stack([index[starts], least, most], axis=1))

    def base(self, *, stretch: float = 20.0) -> tuple[int, float, int, float, bool, int]:
        """Lay the base as `timebase.make_base` does: start, step, samples, jitter, exact, gaps."""
        if self.count < 2:
            raise UnevenError
        beyond = np.concatenate(self.beyond) if self.beyond else np.zeros(0)
        median = float(np.median(self.steps.rows))
        limit = max(GAP_INTERVALS * median, GAP_LEAST_S * 1e9)
        gap = beyond > limit
        if abs(median / self.usual - 1) > 0.02 or gap.sum() > BURSTS * (self.count - 1):
            raise UnevenError
        regular = beyond[~gap]
        number = self.count - 1 - int(gap.sum())
        total = self.sums[0] + regular.sum()
        mean = total / number - self.usual
        spread = (self.sums[1] + np.square(regular - self.usual).sum()) / number - mean**2
        jitter = float(np.sqrt(max(spread, 0.0)) / median)
        if jitter > JITTER_LIMIT:
            raise UnevenError
        intervals = number + self.surplus + float((np.rint(regular / median) - 1).clip(0).sum())
        step = total / round(intervals) * 1e-9
        span = (self.last - self.first) * 1e-9
        if span / step > stretch * self.count:
            raise UnevenError
        samples = int(np.floor(span / step + 1e-6)) + 1
        exact = samples == self.count and self._on_base(step * 1e9)
        return self.first, step, samples, jitter, exact, int(gap.sum())

    def _on_base(self, step: float) -> bool:
        row, least, most = np.concatenate(self.off).T
        drift = step - self.usual
        reach = np.maximum(np.abs(least - row * drift), np.abs(most - row * drift))
        return bool(reach.max() + GROUP * abs(drift) <= UNIFORM * step)
