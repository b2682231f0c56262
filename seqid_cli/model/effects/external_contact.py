"""The arm touches something, or is touched: J' F for a while, at no time that repeats.

Nothing of it is fitted: the stretches are found as events in time, that several joints see at once
and that no other period of the motion shows, and are left out. Haddadin, De Luca, Albu-Schaeffer,
"Robot collisions: a survey on detection, isolation, and identification", IEEE Trans. Robotics
33(6), 2017.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np
from numpy.typing import NDArray

from seqid_cli.model.effects.effect import Coefficient, Columns, Effect, Settings
from seqid_cli.model.effects.scene import Scene

Array = NDArray[np.float64]


class ExternalContact(Effect):
    """A name, and what to do about it."""

    name = "external_contact"
    family = "measurement"
    alike = ("backlash",)
    separate_by = (
        "the same motion again, at least three times, with nothing within reach: a contact does "
        "not repeat"
    )

    def coefficients(self, settings: Settings) -> tuple[Coefficient, ...]:
        """Nothing is fitted."""
        return ()

    def columns(self, scene: Scene, joint: int | None, settings: Settings) -> Columns:
        """No torque is touched."""
        return {}

    def available(self, scenes: Sequence[Scene], joint: int | None) -> bool:
        """Never: it is no column to be screened."""
        return False

    def grid(
        self, scenes: Sequence[Scene], joint: int | None, residual: Sequence[Array]
    ) -> Iterator[dict[str, float]]:
        """Nothing to try."""
        return iter(())
