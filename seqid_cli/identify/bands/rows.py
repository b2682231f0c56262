"""A thinned copy of a stage's equations, from which parts can be left out later.

Residuals of the torque are low-passed. Two samples per period of the cut-off therefore
hold all of their information. So few rows fit into memory where the full regressor
does not.
"""

from dataclasses import dataclass, field, replace

import numpy as np

from seqid_cli.motion.motion import Motion
from seqid_cli.typing import Array, Index, Mask

SAMPLES_PER_CUTOFF = 2.0  # per period of the cut-off: fewer would lose information
MOST_ROWS = 4096  # of all logs together: 12 MB for an arm of six joints


@dataclass(frozen=True, kw_only=True)
class BandRows:
    """Rows H theta = y of the equations at thinned samples, M of them, of all logs.

    Attributes
    ----------
    H : array (M, n, p)
        Regressor, filtered as in the stage's equations.
    y : array (M, n)
        Right side [N m], filtered alike.
    used, judged : array (M, n)
        Rows in the stage's equations, and rows by which predictions are judged: near
        reversals a stage may leave out more.
    q, dq, ddq : array (M, n)
        Joint positions [rad], speeds [rad/s] and accelerations [rad/s^2].
    weight : array (M,)
        Number of the stage's rows that each sample stands for.
    t : array (M,)
        Time within the log [s].
    log : array (M,)
        Number of the log, from 0.
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
        """Return the rows of some samples."""
        return BandRows(
            H=self.H[where],
            y=self.y[where],
            used=self.used[where],
            judged=self.judged[where],
            q=self.q[where],
            dq=self.dq[where],
            ddq=self.ddq[where],
            weight=self.weight[where],
            t=self.t[where],
            log=self.log[where],
        )


@dataclass
class BandRowsCollector:
    """Collector of thinned rows, whose memory does not grow with the logs."""

    parts: list[BandRows] = field(default_factory=list)
    logs: int = 0

    def next_log(self) -> None:
        """Begin a log, to which the rows added from now on belong."""
        self.logs += 1

    def pick(self, motion: Motion, judged: Mask) -> Index:
        """Choose the samples to add from N consecutive ones.

        Parameters
        ----------
        motion : Motion
            The N samples.
        judged : array (N, n)
            Rows by which predictions are judged.

        Returns
        -------
        array (K,)
            Numbers of the chosen samples.
        """
        candidates = np.arange(0, motion.samples, _stride(motion))
        is_judged = judged[candidates].any(axis=1)
        return np.asarray(candidates[is_judged])

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
            Numbers of the samples to add, from `pick`.
        H, y : array
            Regressor (K, n, p) and right side (K, n) [N m] of the chosen samples.
        used, judged : array (K, n)
            Rows in the equations, and rows by which predictions are judged.
        """
        if not len(chosen):
            return

        # The arrays are copied: a view would keep the whole regressor in memory.
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
        later_parts = [replace(part, log=part.log + self.logs) for part in other.parts]
        merged = BandRowsCollector(
            parts=self.parts + later_parts, logs=self.logs + other.logs
        )
        merged._thin()
        return merged

    def joined(self) -> BandRows | None:
        """Return the samples of all logs, or None where there are none."""
        if not self.parts:
            return None
        return BandRows(
            H=np.concatenate([part.H for part in self.parts]),
            y=np.concatenate([part.y for part in self.parts]),
            used=np.concatenate([part.used for part in self.parts]),
            judged=np.concatenate([part.judged for part in self.parts]),
            q=np.concatenate([part.q for part in self.parts]),
            dq=np.concatenate([part.dq for part in self.parts]),
            ddq=np.concatenate([part.ddq for part in self.parts]),
            weight=np.concatenate([part.weight for part in self.parts]),
            t=np.concatenate([part.t for part in self.parts]),
            log=np.concatenate([part.log for part in self.parts]),
        )

    def _thin(self) -> None:
        """Drop every second sample, until there are few enough."""
        while sum(part.samples for part in self.parts) > MOST_ROWS:
            # Copied as well: a view of every second sample would keep all of them.
            halves = [part.part(np.arange(0, part.samples, 2)) for part in self.parts]
            self.parts = [replace(part, weight=2.0 * part.weight) for part in halves]


def _stride(motion: Motion) -> int:
    """Return every how many samples hold all information of a low-passed signal."""
    if not motion.lowpass.active:
        return 1
    thinned_rate_hz = SAMPLES_PER_CUTOFF * motion.lowpass.cutoff_hz
    return max(1, int(motion.rate_hz / thinned_rate_hz))
