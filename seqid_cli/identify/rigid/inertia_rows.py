"""The equations of the inertia stage, reduced: what is kept of logs once read."""

from dataclasses import dataclass, field

import numpy as np

from seqid_cli.identify.bands.rows import BandRowsCollector
from seqid_cli.identify.regression.least_squares import Accumulator
from seqid_cli.identify.regression.noise_level import LogNoise
from seqid_cli.identify.regression.repeats import with_log
from seqid_cli.params.schema import MotionUse
from seqid_cli.typing import Array, Mask


@dataclass(frozen=True)
class States:
    """Some states (S, n) of a log [rad, rad/s, rad/s^2].

    `used` says at which joints rows were used.
    """

    q: Array
    dq: Array
    ddq: Array
    used: Mask


@dataclass(kw_only=True)
class InertiaRows:
    """The equations of some logs, reduced.

    `joints` are the factors of each joint's rows, `torque_squares` (n,) sums of its
    squared torque [(N m)^2], `cross` the products (p, c) of its rows with the columns
    of friction's errors, `sample_counts` (2,) the samples that count as independent,
    and all. `noise` is of the logs that are held, `states` are some of each log's.
    """

    joints: list[Accumulator]
    torque_squares: Array
    sample_counts: Array
    cross: dict[int, Array] = field(default_factory=dict)
    uses: list[MotionUse] = field(default_factory=list)
    noise: list[LogNoise] = field(default_factory=list)
    states: list[States] = field(default_factory=list)
    band_rows: BandRowsCollector = field(default_factory=BandRowsCollector)

    @classmethod
    def empty(cls, joints: int, unknowns: int) -> "InertiaRows":
        """Return the rows of no log, for so many joints and unknowns."""
        return cls(
            joints=[Accumulator(unknowns) for _ in range(joints)],
            torque_squares=np.zeros(joints),
            sample_counts=np.zeros(2),
        )

    def __add__(self, other: "InertiaRows") -> "InertiaRows":
        """Return these rows and those of one more log."""
        nothing = np.zeros(())
        cross = {
            j: self.cross.get(j, nothing) + other.cross.get(j, nothing)
            for j in self.cross | other.cross
        }
        return InertiaRows(
            joints=with_log(self.joints, other.joints),
            torque_squares=self.torque_squares + other.torque_squares,
            sample_counts=self.sample_counts + other.sample_counts,
            cross=cross,
            uses=self.uses + other.uses,
            noise=self.noise + other.noise,
            states=self.states + other.states,
            band_rows=self.band_rows + other.band_rows,
        )

    @property
    def independent(self) -> float:
        """Share of the samples that counts as independent."""
        independent, samples = self.sample_counts
        return float(independent / max(samples, 1.0))
