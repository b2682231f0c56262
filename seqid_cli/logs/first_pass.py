"""The first pass over a long log: its time base, from stamps that come block by block.

The base is the one that `timebase.make_base` would lay through all stamps. Intervals
below the least gap are summed as they come; those above it, which may be gaps or not,
are few and wait until the median interval is known. Whether samples lie on the base is
bounded by their extreme distances from it, group by group.
"""

from dataclasses import dataclass, field

import numpy as np

from seqid_cli.logs.raw import BURSTS, GAP_INTERVALS, GAP_LEAST_S, RawLog, Stamps
from seqid_cli.logs.thinned import Thinned
from seqid_cli.logs.timebase import JITTER_LIMIT, UNIFORM, Base
from seqid_cli.typing import Array

GROUP = 256  # rows whose distance from the base is remembered by its extremes


class UnevenError(Exception):
    """The log has to be read as a whole."""


@dataclass
class FirstPass:
    """Remembers of stamps what the base needs; times are in ns."""

    n_rows: int = 0
    first_ns: int = 0
    last_ns: int = 0
    usual_step: float = 0.0  # the median step of the first block
    step_sum: float = 0.0  # of steps below the least gap
    squared_deviation: float = 0.0  # of these steps from the usual one, summed
    long_steps: list[Array] = field(default_factory=list)  # above the least gap
    long_ends: list[Stamps] = field(default_factory=list)  # where these end
    n_missing: float = 0.0  # samples missing in longer steps below the least gap
    steps: Thinned = field(default_factory=Thinned)
    # (groups, 3): first row, least and largest offset from even stamps
    offsets: list[Array] = field(default_factory=list)
    partial: str = ""
    warnings: list[str] = field(default_factory=list)

    def push(self, stamps: Stamps, raw: RawLog, *, most_gaps: int = 100000) -> None:
        """Take the next stamps (M,) and what was said of them.

        Raises UnevenError where there are more than `most_gaps` steps above the least
        gap, or where the first block holds no two stamps.
        """
        self.partial = raw.partial or self.partial
        self.warnings += [note for note in raw.warnings if note not in self.warnings]

        # The step from the block before counts as well.
        last = np.full(int(self.n_rows > 0), self.last_ns)
        steps = np.diff(stamps, prepend=last).astype(np.float64)
        if not self.n_rows:
            if not len(steps):
                raise UnevenError
            self.first_ns = int(stamps[0])
            self.usual_step = float(np.median(steps))

        self._add_steps(steps, stamps[len(stamps) - len(steps) :])
        if sum(map(len, self.long_steps)) > most_gaps:
            raise UnevenError
        self._add_offsets(stamps)
        self.n_rows += len(stamps)
        self.last_ns = int(stamps[-1])

    def _add_steps(self, steps: Array, ends: Stamps) -> None:
        self.steps.push(steps)
        is_long = steps > GAP_LEAST_S * 1e9
        self.long_steps.append(steps[is_long])
        self.long_ends.append(ends[is_long])
        short = steps[~is_long] if is_long.any() else steps
        self.step_sum += short.sum()
        self.squared_deviation += np.square(short - self.usual_step).sum()
        # A dropped sample makes one interval of two.
        longer = short[short > 1.5 * self.usual_step]
        self.n_missing += float((np.rint(longer / self.usual_step) - 1).sum())

    def _add_offsets(self, stamps: Stamps) -> None:
        row = self.n_rows + np.arange(len(stamps))
        offset = (stamps - self.first_ns) - row * self.usual_step
        starts = np.arange(0, len(offset), GROUP)
        least = np.minimum.reduceat(offset, starts)
        largest = np.maximum.reduceat(offset, starts)
        self.offsets.append(np.stack([row[starts], least, largest], axis=1))

    def base(self, *, stretch: float = 20.0) -> Base:
        """Lay the base as `timebase.make_base` does.

        Raises UnevenError where samples come in bursts, where the interval changes, or
        where the stamps span more than `stretch` times their samples.
        """
        if self.n_rows < 2:
            raise UnevenError
        n_steps = self.n_rows - 1
        median = float(np.median(self.steps.rows))
        long_steps = np.concatenate(self.long_steps)
        is_gap = long_steps > max(GAP_INTERVALS * median, GAP_LEAST_S * 1e9)
        n_gaps = int(is_gap.sum())
        if abs(median / self.usual_step - 1) > 0.02 or n_gaps > BURSTS * n_steps:
            raise UnevenError

        # Mean and jitter of the steps that are no gaps.
        regular = long_steps[~is_gap]
        n_regular = n_steps - n_gaps
        total = self.step_sum + regular.sum()
        mean_deviation = total / n_regular - self.usual_step
        squares = self.squared_deviation + np.square(regular - self.usual_step).sum()
        variance = squares / n_regular - mean_deviation**2
        jitter = float(np.sqrt(max(variance, 0.0)) / median)
        if jitter > JITTER_LIMIT:
            raise UnevenError

        n_missing = float((np.rint(regular / median) - 1).clip(0).sum())
        n_intervals = round(n_regular + self.n_missing + n_missing)
        step_s = total / n_intervals * 1e-9
        span_s = (self.last_ns - self.first_ns) * 1e-9
        if span_s / step_s > stretch * self.n_rows:
            raise UnevenError
        samples = int(np.floor(span_s / step_s + 1e-6)) + 1
        gap_ends = (np.concatenate(self.long_ends)[is_gap] - self.first_ns) * 1e-9
        gap_starts = gap_ends - long_steps[is_gap] * 1e-9
        return Base(
            start_ns=self.first_ns,
            step_s=step_s,
            count=samples,
            jitter=jitter,
            exact=samples == self.n_rows and self._lies_on_base(step_s),
            gaps=tuple(zip(gap_starts.tolist(), gap_ends.tolist(), strict=True)),
        )

    def _lies_on_base(self, step_s: float) -> bool:
        """Tell whether all stamps lie on a base of this step.

        Offsets are from even stamps at the usual step; from the base they differ by the
        drift of one step against the other, within a group by its length at most.
        """
        row, least, largest = np.concatenate(self.offsets).T
        drift = step_s * 1e9 - self.usual_step
        farthest = np.maximum(
            np.abs(least - row * drift), np.abs(largest - row * drift)
        )
        bound = farthest.max() + GROUP * abs(drift)
        return bool(bound <= UNIFORM * step_s * 1e9)
