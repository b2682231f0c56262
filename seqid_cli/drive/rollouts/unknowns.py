"""The unknowns of a simulated joint, and what is known of them before.

What must be positive is searched in its logarithm: a step then is a share, and no gain
turns its sign. A prior is normal in what is searched.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from seqid_cli.drive.rollouts.loop import NAMES, LoopValues
from seqid_cli.typing import Array

# Values of what is no unknown and has none: everything else is zero.
DEFAULTS: Mapping[str, float] = {"friction_factor": 1.0, "stribeck_speed": 0.1}
# Steps by which derivatives are taken: of a logarithm, and of what is linear.
LOG_STEP = 1e-6


@dataclass(frozen=True, kw_only=True)
class Unknown:
    """One number that is searched.

    Attributes
    ----------
    name : str
        Of `LoopValues`.
    start, std : float
        Of the prior: the value, and the standard deviation of it, or of its logarithm
        (natural) where that is searched.
    positive : bool
        Whether the logarithm is searched.
    step : float
        By which derivatives are taken.
    """

    name: str
    start: float
    std: float
    positive: bool = True
    step: float = LOG_STEP

    @property
    def mean(self) -> float:
        """Mean of the prior in what is searched."""
        return float(np.log(self.start)) if self.positive else self.start


@dataclass(frozen=True, kw_only=True)
class Unknowns:
    """The unknowns of a joint, p of them, and values of the rest."""

    searched: Sequence[Unknown]
    fixed: Mapping[str, float]

    @property
    def names(self) -> list[str]:
        """Names of what is searched."""
        return [each.name for each in self.searched]

    @property
    def mean(self) -> Array:
        """Means (p,) of the prior."""
        return np.array([each.mean for each in self.searched])

    @property
    def std(self) -> Array:
        """Standard deviations (p,) of the prior."""
        return np.array([each.std for each in self.searched])

    @property
    def steps(self) -> Array:
        """Steps (p,) by which derivatives are taken."""
        return np.array([each.step for each in self.searched])

    def natural(self, theta: Array) -> Array:
        """Return values (S, p) of what is searched."""
        positive = np.array([each.positive for each in self.searched])
        bounded = np.where(positive, np.clip(theta, -30.0, 30.0), 0.0)
        return np.where(positive, np.exp(bounded), theta)

    def values(self, theta: Array) -> LoopValues:
        """Return the numbers of S sets from what is searched (S, p)."""
        natural = self.natural(theta)
        columns = {}
        for name in NAMES:
            if name in self.names:
                columns[name] = natural[:, self.names.index(name), None]
            else:
                value = self.fixed.get(name, DEFAULTS.get(name, 0.0))
                columns[name] = np.full((len(theta), 1), value)
        return LoopValues(**columns)

    def with_more(self, more: Sequence[Unknown]) -> "Unknowns":
        """Return these with more that are searched."""
        return Unknowns(searched=[*self.searched, *more], fixed=self.fixed)

    def centred(self, means: Mapping[str, tuple[float, float]]) -> "Unknowns":
        """Return these with other priors: value and standard deviation by name."""
        searched = []
        for each in self.searched:
            start, std = means.get(each.name, (each.start, each.std))
            searched.append(replace(each, start=start, std=min(std, each.std)))
        return Unknowns(searched=searched, fixed=self.fixed)
