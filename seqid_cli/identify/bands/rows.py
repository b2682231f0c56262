"""A thinned copy of a stage's equations, kept so that stretches of time can be left out later.

What is left of the torque is low-passed. Two samples per period of the cut-off
therefore say all that there is to know of it, and these few rows can be held where the
full regressor cannot.
"""

from dataclasses import dataclass, field, replace

import numpy as np

from seqid_cli.motion.motion import Motion
from seqid_cli.typing import Array, Index, Mask

SAMPLES_PER_CUTOFF = 2.0  # per period of the cut-off: the least that loses nothing
MOST_ROWS = 4096  # of all logs together: 12 MB for an arm of six joints


@dataclass(frozen=True, kw_only=True)
class BandRows:
    """Rows H theta = y of the equations at thinned samples, M of them, of all logs.

    `H` (M, n, p) and `y` (M, n) N m are filtered as in the stage's equations, `used`
    (M, n) marks those that took part, `judged` (M, n) those by which predictions are
    judged: near reversals a stage may leave out more. `q`, `dq`, `ddq` (M, n) are the
    motion behind them. `weight` (M,) is the number of the stage's rows that each stands
    for. `log` (M,) counts the logs from 0, and `t` (M,) s is the time within the log.
    """

    H: Array
    y: Array
    used: Mask
    judged: Mask
    q: Array
    dq: Array
    ddq: Array
    weight: Array
    t: Array
    log: Index

    @property
    def samples(self) -> int:
        """Number of samples."""
        return len(self.t)

    def part(self, where: Index | Mask | slice) -> "BandRows":
        """Return some of the samples."""
        return BandRows(**{name: values[where] for name, values in vars(self).items()})


@dataclass
class BandRowsCollector:
    """Collects thinned rows, log by log, in memory that does not grow with the logs."""

    parts: list[BandRows] = field(default_factory=list)
    logs: int = 0

    def next_log(self) -> None:
        """Begin a log: rows that follow are of it."""
        self.logs += 1

    def pick(self, motion: Motion, judged: Mask) -> Index:
        """Return which of consecutive samples to add: numbers (K,) within these N.

        `judged` (N, n) marks the rows by which predictions are judged.
        """
        stride = _stride(motion)
        chosen = np.arange(0, motion.samples, stride)
        return np.asarray(chosen[judged[chosen].any(axis=1)])

    def add(
        self,
        motion: Motion,
        chosen: Index,
        *,
        H: Array,
        y: Array,
        used: Mask,
        judged: Mask,
    ) -> None:
        """Add samples of the log that was begun last.

        Parameters
        ----------
        motion : Motion
            N consecutive samples, at the rate of the equations.
        chosen : array (K,)
            Those that are added, as `pick` names them.
        H, y : array
            Of the chosen ones: regressor (K, n, p) and right side (K, n) N m.
        used, judged : array (K, n)
            Which rows take part in the equations, and by which predictions are judged.
        """
        if not len(chosen):
            return
        part = BandRows(
            H=np.array(H),
            y=np.array(y),
            used=np.array(used),
            judged=np.array(judged),
            q=motion.q[chosen],
            dq=motion.dq[chosen],
            ddq=motion.ddq[chosen],
            weight=np.full(len(chosen), float(_stride(motion))),
            t=motion.t[chosen],
            log=np.full(len(chosen), max(self.logs - 1, 0)),
        )
        self.parts.append(part)
        self._thin()

    def __add__(self, other: "BandRowsCollector") -> "BandRowsCollector":
        later = [replace(part, log=part.log + self.logs) for part in other.parts]
        both = BandRowsCollector(self.parts + later, self.logs + other.logs)
        both._thin()
        return both

    def joined(self) -> BandRows | None:
        """Return the samples of all logs, or None where there are none."""
        if not self.parts:
            return None
        names = vars(self.parts[0])
        return BandRows(
            **{n: np.concatenate([getattr(p, n) for p in self.parts]) for n in names}
        )

    def _thin(self) -> None:
        """Keep every second sample, as often as there are too many."""
        while sum(part.samples for part in self.parts) > MOST_ROWS:
            fewer = [part.part(slice(None, None, 2)) for part in self.parts]
            self.parts = [replace(part, weight=2.0 * part.weight) for part in fewer]


def _stride(motion: Motion) -> int:
    """Return which of a motion's samples, every so many, tell all of what is low-passed."""
    if not motion.lowpass.active:
        return 1
    return max(1, int(motion.rate_hz / (SAMPLES_PER_CUTOFF * motion.lowpass.cutoff_hz)))
