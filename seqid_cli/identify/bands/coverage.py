"""Shares of predicted samples whose error is within its band, by speed and load.

Errors are counted where a joint slides: at rest the model states an interval and no
deviation. Neighbouring samples share their error and are not separate tests. A block of
time counts as one test.
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
    """Counts of one group of samples, for n joints.

    `samples` (n,) are all of them, and `within` holds by band those inside it (n,).
    `blocks` names for each joint the blocks of time that have samples. Where one part
    of a log ends within a block and the next begins, it remains one block.
    """

    samples: Array
    within: Mapping[str, Array]
    blocks: Sequence[frozenset[LogBlock]]

    def __add__(self, other: "BandCounts") -> "BandCounts":
        within = {
            band: count + other.within[band] for band, count in self.within.items()
        }
        blocks = [
            blocks | other_blocks
            for blocks, other_blocks in zip(self.blocks, other.blocks, strict=True)
        ]
        return BandCounts(
            samples=self.samples + other.samples, within=within, blocks=blocks
        )


@dataclass
class CoverageCounter:
    """Counter of the samples within their bands, part by part of the logs."""

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
            Name of the log, the same for all of its parts.
        t : array (N,)
            Time within the log [s].
        residual, std : array (N, n)
            Measured minus predicted torque and its standard deviation [N m].
        counts, fast, loaded : array (N, n)
            Which samples count, are beyond the edge of speed, and beyond that of load.
            None where the edge is not known.
        """
        counts = counts & np.isfinite(std)
        block = (t / BLOCK_S).astype(np.intp)

        groups = {"overall": counts}
        if fast is not None:
            groups["slow"] = counts & ~fast
            groups["fast"] = counts & fast
        if loaded is not None:
            groups["low_load"] = counts & ~loaded
            groups["high_load"] = counts & loaded

        for name, group in groups.items():
            group_counts = _count(residual, std, group, log, block)
            if name in self.groups:
                group_counts = self.groups[name] + group_counts
            self.groups[name] = group_counts

    def of_joint(self, joint: int) -> JointCoverage | None:
        """Return the shares of a joint's samples in its bands; None without samples."""
        overall = self.groups.get("overall")
        if overall is None or not overall.samples[joint]:
            return None
        coverage_by_group = {
            name: _coverage(group, joint) for name, group in self.groups.items()
        }
        return JointCoverage(**coverage_by_group)


def clearly_below(
    coverage: BandCoverage, *, least_share: float, sigmas: float = 1.645
) -> bool:
    """Return whether a 90 % band holds in too few samples, and not by chance.

    Parameters
    ----------
    coverage : BandCoverage
        Share of the samples in the band, and their blocks of time.
    least_share : float
        Share of the samples in which the band must hold.
    sigmas : float
        Standard deviations by which a share may miss 0.9 by chance. Over B blocks of
        time that of the share is sqrt(0.9 * 0.1 / B) = 0.3 / sqrt(B).
    """
    if coverage.band_90 is None or not coverage.blocks:
        return False
    chance = sigmas * 0.3 / np.sqrt(coverage.blocks)
    is_too_low = coverage.band_90 < least_share
    return bool(is_too_low and coverage.band_90 < 0.9 - chance)


def _count(
    residual: Array, std: Array, group: Mask, log: str, block: Index
) -> BandCounts:
    """Count a group's samples (N, n), those within each band, and blocks of time."""
    error = np.abs(residual)
    # A deviation outside the group may be NaN, with which nothing can be compared.
    group_std = np.where(group, std, 0.0)
    within = {}
    for band, half_width in HALF_WIDTHS.items():
        is_within = group & (error <= half_width * group_std)
        within[band] = is_within.sum(axis=0)

    blocks = []
    for in_group in group.T:
        numbers = np.unique(block[in_group])
        blocks.append(frozenset(LogBlock(log, int(number)) for number in numbers))
    return BandCounts(samples=group.sum(axis=0), within=within, blocks=blocks)


def _coverage(group: BandCounts, joint: int) -> BandCoverage:
    """Return the shares of one joint's samples in the bands; None without samples."""
    samples = int(group.samples[joint])
    shares: dict[str, float | None] = {}
    for band, within in group.within.items():
        shares[band] = float(within[joint] / samples) if samples else None
    return BandCoverage(**shares, samples=samples, blocks=len(group.blocks[joint]))
