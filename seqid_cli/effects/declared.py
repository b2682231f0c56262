"""What effects declare beside formulas: links that deviate, bodies that change."""

from dataclasses import dataclass, field

import numpy as np

from seqid_cli.typing import Array


@dataclass(frozen=True)
class Twist:
    """The link lags by the twist of a spring and damper, per unit of compliance.

    `stiffness` N m/rad and `damping_ratio`, of critical, shape it. Of what the model
    has for the link's inertia `rotor` kg m^2 are the motor's.
    """

    stiffness: float
    damping_ratio: float
    rotor: float = 0.0


@dataclass(frozen=True)
class Play:
    """The link flies from flank to flank of a `gap` rad, per unit of it."""

    gap: float


@dataclass(frozen=True)
class Wave:
    """The measured angle is wrong by sine and cosine of `rate` times itself.

    Rotors feel it too.
    """

    rate: float


@dataclass(frozen=True)
class Shift:
    """The joint's angle is another one: per rad from `low` to `high`, rad."""

    low: float
    high: float


Deviation = Twist | Play | Wave | Shift


@dataclass(frozen=True, kw_only=True)
class BodyTerm:
    """What one coefficient changes in the rigid body, per unit of it.

    Torque is linear in each of the changes.

    Attributes
    ----------
    last_link : Array
        (10,) standard parameters added to the last link.
    armature : Array, optional
        (n,) kg m^2 at the joints.
    rotor : Array, optional
        (n,) kg m^2, gear ratio times inertia of rotors that turn the link before their
        joint.
    gravity : Array
        (3,) m/s^2 in the base frame, which the links feel besides.
    """

    last_link: Array = field(default_factory=lambda: np.zeros(10))
    armature: Array | None = None
    rotor: Array | None = None
    gravity: Array = field(default_factory=lambda: np.zeros(3))
