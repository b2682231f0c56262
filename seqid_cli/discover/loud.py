"""Joints whose residual is louder than noise and encoder make it, whatever it depends on.

An effect that nothing here foretells, in a single quick move say, passes no gate; but then what is
left is more than what a right model would leave, which clean data of these logs tell (see `clean`).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from seqid_cli.discover.dependence import dependence
from seqid_cli.discover.floor import rms
from seqid_cli.discover.investigate import Investigation
from seqid_cli.discover.noise import DETAIL
from seqid_cli.discover.stationary import goes_with_motion

Array = NDArray[np.float64]

LOUDER = 1.6  # times what a right model leaves; on clean simulated arms 1.0 to 1.5
LOUD = 2.5  # from which it is worth a word


@dataclass(frozen=True)
class Loud:
    """One such joint, and what is left there over what is expected."""

    joint: int
    times: float

    @property
    def told(self) -> bool:
        """Whether it is too much to be passed over."""
        return self.times > LOUD

    @property
    def share(self) -> float:
        """Part of the squared residual that is not expected."""
        return 1.0 - self.times**-2


def expected(found: Investigation) -> Array:
    """RMS (n,) N m that the residual would have with a right model.

    The noise floor, and a detail of the torque itself.
    """
    rows, scenes = found.search.stage.rows, found.search.stage.scenes
    torque = [scene.motion.filtered(scene.modelled) for scene in scenes]
    detail = [DETAIL * rms(rows.torque(j, [tau[:, j] for tau in torque])) for j in range(rows.n)]
    return np.hypot(found.floor.rms, detail)


def louder_joints(found: Investigation, ordinary: Array) -> tuple[Loud, ...]:
    """Joints that are louder than `ordinary` (n,) N m after all that was found, the loudest first.

    Not those that the file alone fits as well as expected, nor those whose residual goes on alike
    whatever the arm does: torque noise may be slower than what can be seen of it elsewhere.
    """
    search = found.search
    left = np.minimum(search.rms(), found.start)
    times = left / np.maximum(ordinary, 1e-12)
    residual = search.system().residual()
    louder = [
        Loud(j, float(times[j]))
        for j in np.flatnonzero(times > LOUDER).tolist()
        if goes_with_motion(search.stage.rows, residual[j], j)
    ]
    return tuple(sorted(louder, key=lambda one: -one.times))


def looks_like(found: Investigation, joint: int) -> tuple[str, ...]:
    """Quantities that a joint's residual depends on most, however little that foretells."""
    system = found.search.system()
    return dependence(system, joint, least_gain=0.0, most=1).quantities
