"""Excess residual: more than noise and encoder make, whatever it depends on.

An effect that left-out blocks do not show, in a single quick move say, is not selected. What is
left then exceeds what a right model would leave.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from seqid_cli.discover.investigate import Investigation
from seqid_cli.discover.noise.floor import rms
from seqid_cli.discover.noise.spectra import DETAIL
from seqid_cli.discover.select.smooth import SmoothFunction
from seqid_cli.discover.select.terms import smooth_terms
from seqid_cli.typing import Array

EXCESS = 2.5  # times what a right model leaves; on clean simulated arms 1.0 to 1.5


@dataclass(frozen=True)
class Excess:
    """One joint with excess residual, and what is left there over what is expected."""

    joint: int
    times: float

    @property
    def share(self) -> float:
        """Part of the squared residual that is not expected."""
        return 1.0 - self.times**-2


def expected(found: Investigation) -> Array:
    """RMS (n,) N m that the residual would have with a right model.

    The noise floor, and a detail of the torque itself.
    """
    rows = found.ground.stage.rows
    torque = [scene.modelled_filtered for scene in rows.scenes]
    detail = [DETAIL * rms(rows.torque(j, [tau[:, j] for tau in torque])) for j in range(rows.n)]
    return np.hypot(found.floor.rms, detail)


def excess_residuals(found: Investigation, ordinary: Array) -> tuple[Excess, ...]:
    """Joints with more than `ordinary` (n,) N m left after all that was found, the largest first.

    Joints that the file alone fits as well as expected are left out.
    """
    left = np.minimum(found.model.rms(), found.start)
    times = left / np.maximum(ordinary, 1e-12)
    larger = [Excess(j, float(times[j])) for j in np.flatnonzero(times > EXCESS).tolist()]
    return tuple(sorted(larger, key=lambda one: -one.times))


def looks_like(found: Investigation, joint: int) -> SmoothFunction | None:
    """The smooth term that a joint's residual is most like, however little it predicts."""
    ground = found.ground
    terms = [t for t in smooth_terms(ground.stage.rows, ground.size) if t.joint == joint]
    gained = found.model.linear.gained([term.part for term in terms])
    best = max(zip(terms, gained, strict=True), key=lambda pair: pair[1].evidence, default=None)
    what = best[0].what if best else None
    return what if isinstance(what, SmoothFunction) else None
