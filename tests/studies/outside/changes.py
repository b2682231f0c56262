"""What becomes of an arm after it was identified: friction, constant, zero, load."""

from dataclasses import replace

import numpy as np

from tests.studies.outside.arms import Arm
from tests.studies.outside.effects import (
    Draw,
    joint_zero,
    named,
    payload,
    torque_constant,
)
from tests.studies.outside.simulate import Effect, State


def friction(*, dry: float, viscous: float, most: float) -> Draw:
    """Return a drawing of one joint's friction that has become larger, or smaller.

    `dry` and `viscous` are shares that a scale of 1 adds, `most` the largest scale.
    """

    def drawn(arm: Arm, j: int, rng: np.random.Generator) -> Effect:
        def more_dry(scale: float, base: float, state: State) -> float:
            return scale * dry * base

        def more_viscous(scale: float, state: State) -> float:
            return -scale * viscous * arm.drives[j].viscous * state.dq[j]

        effect = Effect(j, most=most, name="friction_change")
        if dry:
            effect = replace(effect, dry=more_dry)
        if viscous:
            effect = replace(effect, push=more_viscous)
        return effect

    return drawn


# In this order they come to the seeds.
CHANGES: dict[str, Draw] = {
    "dry friction up": friction(dry=0.25, viscous=0.0, most=8.0),
    "torque constant": named("torque_constant", torque_constant),
    "dry friction down": friction(dry=-0.25, viscous=0.0, most=3.2),
    "joint zero": named("joint_zero", joint_zero),
    "viscous friction up": friction(dry=0.0, viscous=0.25, most=12.0),
    "load": named("payload", payload),
    "viscous friction down": friction(dry=0.0, viscous=-0.25, most=3.6),
    "both frictions up": friction(dry=0.25, viscous=0.25, most=8.0),
}
