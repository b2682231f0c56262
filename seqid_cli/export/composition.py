"""The parts of exported code's torque: the model without effects, and lines of effects.

`predict` adds effects to a model that knows nothing of them (`effects.apply`):
each sees the load and the torque of the `BaseModel`. Exported code does the same.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from seqid_cli.effects.effect import Effect
from seqid_cli.effects.fitted import Fitted, FittedEffect
from seqid_cli.effects.scene import DEFAULT_SIGN_SHARE
from seqid_cli.errors import ConfigError
from seqid_cli.model.torque import TorqueModel
from seqid_cli.robot.base_parameters import gear_ratios
from seqid_cli.robot.types import Robot
from seqid_cli.typing import Array

# Torques that a delay line keeps at least, and per second of the longest delay: as many
# as come at 1 kHz, so that friction's steps stay as short as they are.
FEWEST_DELAYED = 64
DELAYED_PER_S = 1000.0
SPARE_DELAYED = 16
DECLARATIONS = ("laws", "deviation", "body_terms")  # methods of an effect
USUAL_TOP_SPEED = 1.0  # rad/s, of a joint whose friction and speed limit are not known


@dataclass(frozen=True, kw_only=True)
class BaseModel:
    """The model without effects, as `predict` has it; what effects see.

    Attributes
    ----------
    links : (n, 10) array
        Standard parameters, zero without a rigid-body stage.
    armature : (n,) array
        Inertias of rotors as the joints feel them, kg m^2.
    rotor : (n,) array
        Gear ratio times rotor inertia where rotors turn the links before their joints,
        else zero.
    sign_width : (n,) array
        Speeds over which the direction of motion changes, rad/s.
    delays_s : (n,) array
        By which the logged torque is late against the positions, s.
    """

    links: Array
    armature: Array
    rotor: Array
    sign_width: Array
    delays_s: Array

    @classmethod
    def of_model(cls, model: TorqueModel) -> BaseModel:
        """Return the numbers of a model."""
        robot = model.robot
        n = robot.n
        gear = gear_ratios(robot)
        rotor = np.zeros(n) if model.rotor is None else model.rotor

        turned = np.zeros(n)
        if model.coupling == "gyroscopic":
            turned = np.where(robot.chain.prismatic, 0.0, gear * rotor)

        widths = [
            (
                DEFAULT_SIGN_SHARE * (joint.velocity_limit or USUAL_TOP_SPEED)
                if surface is None
                else surface.sign_width
            )
            for joint, surface in zip(robot.joints, model.surfaces, strict=True)
        ]
        return cls(
            links=np.zeros((n, 10)) if model.phi is None else model.phi,
            armature=np.asarray(gear**2 * rotor),
            rotor=turned,
            sign_width=np.array(widths),
            delays_s=np.zeros(n) if model.delays_s is None else model.delays_s,
        )


@dataclass(kw_only=True)
class Code:
    """Effects as lines of one language, and what of the file they need.

    Attributes
    ----------
    instant : list of str
        Lines that add to `tau` what follows from the motion of the instant.
    session : list of str
        Lines that add what needs a temperature, the time or a memory.
    waves : list of str
        Lines that add up the errors of encoders in `x`, `v` and `a`.
    deviations : list of str
        Lines that add up the twists and plays of gears there.
    inertias : list of int
        Joints whose links' inertia the deviations take.
    bristles : int
        How many deflections of bristles, and states of ropes, the state holds.
    ropes : bool
        Whether there are ropes among them.
    lags : int
        How many low-passed torques it holds.
    averages : bool
        Whether a mean over the delay line is taken.
    shifts : bool
        Whether a joint's angle is another one.
    twisted : list of int
        Joints of the twists that it holds.
    plays : int
        How many gears with backlash it holds.
    wavy : list of int
        Joints whose friction feels the error of their encoder.
    based : bool
        Whether anything needs the load or the torque without effects.
    rates : bool
        Whether the torque of the last steps is kept.
    longest_s : float
        The longest delay that torque is kept for, 0 where none is.
    splines : bool
        Whether smooth terms are among them.
    armature, rotor, gravity : array
        What effects add to the rigid body: see `BodyTerm`.
    """

    instant: list[str] = field(default_factory=list)
    session: list[str] = field(default_factory=list)
    waves: list[str] = field(default_factory=list)
    deviations: list[str] = field(default_factory=list)
    inertias: list[int] = field(default_factory=list)
    bristles: int = 0
    ropes: bool = False
    lags: int = 0
    averages: bool = False
    shifts: bool = False
    rates: bool = False
    longest_s: float = 0.0
    splines: bool = False
    armature: Array
    rotor: Array
    gravity: Array
    based: bool = False
    twisted: list[int] = field(default_factory=list)
    plays: int = 0
    wavy: list[int] = field(default_factory=list)

    @property
    def delay_samples(self) -> int:
        """Number of torques that the delay line keeps."""
        needed = math.ceil(DELAYED_PER_S * self.longest_s) + SPARE_DELAYED
        return max(FEWEST_DELAYED, needed)

    @property
    def twists(self) -> int:
        """Number of twists that the state holds."""
        return len(self.twisted)

    @property
    def moved(self) -> bool:
        """True where links deviate from where their encoders say."""
        return bool(self.waves or self.deviations)


def is_timing(effect: Effect) -> bool:
    """Return whether an effect shapes the logged torque in time.

    A feed-forward does not want that.
    """
    return effect.family == "measurement" and effect.timing


def lags_of(effects: Sequence[Fitted], base: BaseModel) -> list[str]:
    """Say what shapes the logged torque in time, in parts of a sentence."""
    parts = []
    if np.any(base.delays_s > 0.0):
        parts.append("late against the positions")

    catalogued = [item.effect for item in effects if isinstance(item, FittedEffect)]
    names = [effect.name for effect in catalogued if is_timing(effect)]
    parts += [f"shaped by {name}" for name in dict.fromkeys(names)]
    return parts


def refuse_without_law(item: FittedEffect, robot: Robot) -> None:
    """Raise ConfigError if an effect says nothing that code can be written from."""
    effect = item.effect
    declared = [
        effect.laws(robot, item.joint, item.settings),
        effect.deviation(robot, item.joint, item.settings),
        effect.body_terms(robot, item.joint, item.settings),
    ]
    declares_any = any(part is not None for part in declared)
    if declares_any and _columns_are_of_the_law(type(effect)):
        return

    place = robot.name_of(item.joint) or "all joints"
    raise ConfigError(
        f"effect {effect.name!r} ({place}) declares no law that code can be written"
        " from",
        where=str(robot.source),
        hint=(
            "Give its class `laws` (docs/how-to/own_effects.md), or export a form that"
            " leaves effects out: URDF, MJCF, ROS 2."
        ),
    )


def _columns_are_of_the_law(kind: type[Effect]) -> bool:
    """Return whether no class has columns of its own beside a law that it inherits."""
    # From the class itself to what it inherits: whichever comes first holds.
    for ancestor in kind.__mro__:
        if any(name in vars(ancestor) for name in DECLARATIONS):
            return True
        if "columns" in vars(ancestor):
            return False
    return False
