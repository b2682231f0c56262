"""What robots can be compared by: parameters, and friction at speeds that all of them share."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from seqid_cli.model.friction import SLIDES, FrictionSurface
from seqid_cli.params.schema import FrictionJoint, ParameterFile, Stages

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Quantity:
    """One number that every robot has: a parameter, or the friction of a joint at a speed."""

    stage: str
    joint: str
    name: str
    unit: str


def quantities(
    stages: Stages, speeds: Mapping[str, Array]
) -> Iterator[tuple[Quantity, tuple[float, float]]]:
    """Yield what a robot can be compared by, with value and standard error."""
    for joint, surface in (stages.friction.joints if stages.friction else {}).items():
        for speed in speeds.get(joint, ()):
            quantity = Quantity("friction", joint, f"at {speed:.3g} rad/s", surface.unit)
            yield quantity, _mean_friction(surface, float(speed))
    for name, stage in (("gravity", stages.gravity), ("inertia", stages.inertia)):
        for p in stage.parameters if stage else ():
            yield Quantity(name, p.joint, p.name, p.unit), (p.value, p.std_error)


def speeds_of(files: Iterable[ParameterFile], *, speeds: int = 3) -> dict[str, Array]:
    """Speeds of each joint that the friction of all files is known at, by joint."""
    found: dict[str, list[tuple[float, float]]] = {}
    for file in files:
        for joint, surface in (file.stages.friction.joints if file.stages.friction else {}).items():
            low, high = surface.speed_range
            found.setdefault(joint, []).append((max(low, SLIDES * surface.sign_width), high))
    ends = {j: (max(r[0] for r in own), min(r[1] for r in own)) for j, own in found.items()}
    return {j: np.linspace(low, high, speeds) for j, (low, high) in ends.items() if low < high}


def _mean_friction(
    joint: FrictionJoint, speed: float, *, positions: int = 25
) -> tuple[float, float]:
    """Mean friction over positions and both directions at a speed, and its standard error."""
    surface = FrictionSurface.from_stage(joint)
    low, high = joint.position_range
    q = np.tile(np.linspace(low, high, positions), 2)
    v = np.repeat([speed, -speed], positions)
    mean = float(np.mean(np.sign(v) * surface.torque(q, v)))
    row = np.mean(np.sign(v)[:, None] * surface.columns(q, v), axis=0)
    if surface.covariance.shape != (len(row), len(row)):
        return mean, 0.0
    return mean, float(np.sqrt(max(row @ surface.covariance @ row, 0.0)))
