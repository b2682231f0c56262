"""How often bands held on the logs that were predicted, over all and by speed and load.

Errors are counted where a joint slides: at rest the model says an interval, and no
deviation. Many samples of one moment are not many tests: what counts as a test is a
block of time.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np

from seqid_cli.identify.bands.calibrate import BLOCK_S
from seqid_cli.params.results.prediction import BandCoverage, JointCoverage
from seqid_cli.typing import Array, Index, Mask

HALF_WIDTHS = {"band_90": 1.645, "band_95": 1.96}  # in standard deviations


class LogBlock(NamedTuple):
    """A block of time of one log."""

    log: str
    number: int


@dataclass(frozen=True, kw_only=True)
class BandCounts:
    """Samples of the joints (n,) in a group, how many of them were in each band, and blocks.

    `blocks` holds for each joint which blocks of time had samples, as log and number.
    A block in which one part of a log ends and the next begins is one block.
    """

    samples: Array
    within: Mapping[str, Array]
    blocks: Sequence[frozenset[LogBlock]]

    def __add__(self, other: "BandCounts") -> "BandCounts":
        pairs = zip(self.blocks, other.blocks, strict=True)
        return BandCounts(
            samples=self.samples + other.samples,
            within={name: x + other.within[name] for name, x in self.within.items()},
            blocks=[ours | theirs for ours, theirs in pairs],
        )


@dataclass
class CoverageCounter:
    """Adds up how often bands held, part by part of the logs."""

    groups: dict[str, BandCounts] = field(default_factory=dict)

    def add(
        self,
        *,
        log: str,
        t: Array,
        residual: Array,
        std: Array,
        counts: Mask,
        fast: Mask | None,
        loaded: Mask | None,
    ) -> None:
        """Add N samples of one log, or of a part of one.

        Parameters
        ----------
        log : str
            What tells the log from the others; the same for all of its parts.
        t : array (N,)
            Time within the log [s].
        residual, std : array (N, n)
            Measured minus predicted torque and its standard deviation [N m].
        counts, fast, loaded : array (N, n)
            Which samples count, and on which side of the edges they are (None: not
            known).
        """
        counts = counts & np.isfinite(std)
        block = (t / BLOCK_S).astype(np.intp)
        groups = {"overall": counts}
        if fast is not None:
            groups |= {"slow": counts & ~fast, "fast": counts & fast}
        if loaded is not None:
            groups |= {"low_load": counts & ~loaded, "high_load": counts & loaded}
        for name, group in groups.items():
            found = _counted(residual, std, group, log, block)
            self.groups[name] = (
                self.groups[name] + found if name in self.groups else found
            )

    def of_joint(self, joint: int) -> JointCoverage | None:
        """Return how often the bands of a joint held; None where it was never counted."""
        overall = self.groups.get("overall")
        if overall is None or not overall.samples[joint]:
            return None
        found = {name: _coverage(group, joint) for name, group in self.groups.items()}
        return JointCoverage(**found)


def clearly_below(
    coverage: BandCoverage, *, least_share: float, sigmas: float = 1.645
) -> bool:
    """Whether a 90 % band held in fewer than `least_share` of the samples, and not by chance.

    Of B blocks of time a share of 0.9 has a standard deviation of 0.3 / sqrt(B);
    `sigmas` of them are granted.
    """
    if coverage.band_90 is None or not coverage.blocks:
        return False
    chance = sigmas * 0.3 / np.sqrt(coverage.blocks)
    return bool(coverage.band_90 < least_share and coverage.band_90 < 0.9 - chance)


def _counted(
    residual: Array, std: Array, group: Mask, log: str, block: Index
) -> BandCounts:
    """Count the samples of a group, those of them in the bands, and the blocks of time."""
    error = np.abs(residual)
    blocks = [
        frozenset(LogBlock(log, int(number)) for number in np.unique(block[counted]))
        for counted in group.T
    ]
    return BandCounts(
        samples=group.sum(axis=0),
        within={
            name: (
                (group & (error <= half_width * np.where(group, std, 0.0))).sum(axis=0)
            )
            for name, half_width in HALF_WIDTHS.items()
        },
        blocks=blocks,
    )


def _coverage(group: BandCounts, joint: int) -> BandCoverage:
    """Return the shares of one joint; null without samples."""
    samples = int(group.samples[joint])
    shares = {
        name: float(within[joint] / samples) if samples else None
        for name, within in group.within.items()
    }
    return BandCoverage(**shares, samples=samples, blocks=len(group.blocks[joint]))
