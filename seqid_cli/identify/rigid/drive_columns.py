"""What drives add to the torques of moves: columns of the inertia stage's equation.

Friction, and what it changes by per unit of each term of its drive
(`identify.nuisances`), are surfaces of one family: they are sampled and filtered
together.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from seqid_cli.identify.nuisances import FrictionChange, change_of, even_surfaces
from seqid_cli.model.friction import FrictionFamily, FrictionSurface
from seqid_cli.model.torque import sampled_families
from seqid_cli.motion.motion import Motion
from seqid_cli.params.schema import Stages
from seqid_cli.robot.types import Robot
from seqid_cli.typing import Array

# Members of a joint's family of friction surfaces.
FRICTION = 0
PER_DELAY = 1
DRY_SIZE = 2
VISCOUS_SIZE = 3
PER_KELVIN = 4
FAMILY_SIZE = 5


@dataclass(frozen=True, kw_only=True)
class DriveColumns:
    """What the drives add to the torques of n joints, filtered alike, all (N, n).

    `delay` [N m/s] is per second by which the torque is late, `friction_per_second` the
    part of it by which friction was identified differently; `dry_size` and
    `viscous_size` [N m] are per asymmetry of either part of friction, `per_kelvin` [N m
    K] is per friction's change per kelvin. `friction` [N m] is that of the surfaces.
    """

    friction: Array
    delay: Array
    friction_per_second: Array
    dry_size: Array
    viscous_size: Array
    per_kelvin: Array

    def part(self, where: slice) -> "DriveColumns":
        """Return the columns of some samples."""
        return DriveColumns(
            friction=self.friction[where],
            delay=self.delay[where],
            friction_per_second=self.friction_per_second[where],
            dry_size=self.dry_size[where],
            viscous_size=self.viscous_size[where],
            per_kelvin=self.per_kelvin[where],
        )


class Drives:
    """The friction of n joints, and what each drive's terms change of its torque.

    Parameters
    ----------
    robot : Robot
    stages : Stages
        With friction, whose terms of the drives are known.
    surfaces : sequence of FrictionSurface or None
        Friction of each joint.
    """

    def __init__(
        self,
        robot: Robot,
        stages: Stages,
        surfaces: Sequence[FrictionSurface | None],
    ) -> None:
        self.surfaces = surfaces
        self._delays = [_change_of(stages, name, "delay") for name in robot.joint_names]
        self._families: list[FrictionFamily | None] = []
        for name, surface, delay in zip(
            robot.joint_names, surfaces, self._delays, strict=True
        ):
            thermal = _change_of(stages, name, "thermal")
            self._families.append(
                None if surface is None else _family(surface, delay, thermal)
            )

    @property
    def delays_of_friction(self) -> Array:
        """Delays (n,) s that friction was identified with; 0 where it was not."""
        return np.array(
            [0.0 if delay is None else delay.value for delay in self._delays]
        )

    def columns(self, motion: Motion) -> DriveColumns:
        """Return what friction, delay and asymmetry of each drive add to its torque."""
        assert motion.tau is not None
        sampled = sampled_families(self._families, motion, size=FAMILY_SIZE)
        filtered = motion.filtered(sampled, times=2)
        torque_rate = np.gradient(motion.tau, axis=0) * motion.rate_hz
        return DriveColumns(
            friction=filtered[..., FRICTION],
            delay=filtered[..., PER_DELAY] - torque_rate,
            friction_per_second=filtered[..., PER_DELAY],
            dry_size=filtered[..., DRY_SIZE],
            viscous_size=filtered[..., VISCOUS_SIZE],
            per_kelvin=self._per_kelvin(motion, filtered),
        )

    def _per_kelvin(self, motion: Motion, filtered: Array) -> Array:
        """Return the torque (N, n) N m of one unit of friction's change per kelvin."""
        kelvin = np.zeros_like(motion.q)
        if motion.celsius is None:
            return kelvin
        for j, surface in enumerate(self.surfaces):
            if surface is not None:
                kelvin[:, j] = surface.kelvin(motion.celsius[:, j])
        return np.asarray(filtered[..., PER_KELVIN] + kelvin * filtered[..., FRICTION])


def _change_of(stages: Stages, name: str, term: str) -> FrictionChange | None:
    """Return a term of a joint's friction, and how friction goes with it."""
    joint = stages.friction.joints.get(name) if stages.friction else None
    return None if joint is None else change_of(joint, term)


def _family(
    surface: FrictionSurface,
    delay: FrictionChange | None,
    thermal: FrictionChange | None,
) -> FrictionFamily:
    """Return a joint's friction and what it changes by, in the order of the members.

    A term that friction was not identified with changes nothing.
    """
    nothing = surface.of_size(np.zeros_like(surface.positive))
    dry_size, viscous_size = even_surfaces(surface)
    return FrictionFamily(
        (
            surface,
            nothing if delay is None else delay.per_unit,
            dry_size,
            viscous_size,
            nothing if thermal is None else thermal.per_unit,
        )
    )
