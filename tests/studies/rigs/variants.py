"""The same rig built anew: other friction waves over position, other mountings of the arrays."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from tests.plants.arms.rigs import mounting
from tests.plants.friction.surface import SurfaceFriction
from tests.plants.simulate import Plant


def another(plant: Plant, rng: np.random.Generator) -> Plant:
    """Draw the friction's phases and the arrays' mountings; everything else stays."""
    friction = plant.friction
    if not isinstance(friction, SurfaceFriction):
        raise TypeError(f"friction is a {type(friction).__name__}, not a SurfaceFriction")
    imus = tuple(replace(imu, rotation=mounting(*rng.uniform(-1.2, 1.2, 3))) for imu in plant.imus)
    phase = rng.uniform(-np.pi, np.pi, friction.phase.shape)
    return replace(plant, friction=replace(friction, phase=phase), imus=imus)
