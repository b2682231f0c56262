"""Dry friction that is larger at some places than at others.

    tau = s(v) sum_k [a_k cos(2 pi k x / p) + b_k sin(2 pi k x / p)],   k = 1 .. `waves`
    x = min(max(q, `lowest`), `highest`)

a_k, b_k [N m], p the `period`: a turn of the joint (2 pi rad), as a bent bearing or a
gear out of round has it; at a sliding joint twice the travel. Between `lowest` and
`highest` the logs show it; beyond it is held, as waves that were fitted to a part of a
turn may be anything on the rest of it. Files of before have no such range. A friction
stage whose orders in position suffice holds it already. Popovic, Goldenberg, "Modeling
of friction using spectral analysis", IEEE Trans. Robotics and Automation 14(1), 1998.
"""

from collections.abc import Mapping
from itertools import product

import numpy as np

from seqid_cli.effects.effect import (
    Coefficient,
    FrictionEffect,
    GridAxes,
    Setting,
    Settings,
)
from seqid_cli.effects.law import Law
from seqid_cli.effects.scene import Scenes, positions, travel
from seqid_cli.robot.types import Robot

WAVES = (1.0, 2.0, 3.0, 5.0)  # per turn of the joint


class PositionDependentFriction(FrictionEffect):
    """Friction in waves over the position."""

    name = "position_dependent_friction"
    settings = (
        Setting("period", "rad", low=0.0, continuous=False),
        Setting("waves", "1", low=1.0, continuous=False),
        # Not of its shape: the same waves in other logs are the same effect.
        Setting("lowest", "rad", asked=False),
        Setting("highest", "rad", asked=False),
    )
    over = "position"
    sided = True
    alike = ("friction_change", "torque_ripple", "load_dependent_friction")
    separate_by = (
        "constant speeds of this joint both ways over its whole range, at three speeds"
        " and with the load on it turned round: friction over the position stays, that"
        " of the load does not"
    )

    def between(self, settings: Settings) -> tuple[Setting, ...]:
        """Return none: the logs say the range."""
        return ()

    def searched(self, settings: Settings) -> int:
        """Return 1: the number of waves."""
        return 1

    def coefficients(self, settings: Settings) -> tuple[Coefficient, ...]:
        """Return cosine and sine of every wave."""
        pairs = product(range(1, round(settings["waves"]) + 1), ("cosine", "sine"))
        return tuple(Coefficient(f"{part}_{k}", "N m") for k, part in pairs)

    def axes(self, scenes: Scenes, joint: int) -> GridAxes:
        """Return a turn, or twice the travel of a sliding joint, waves and range."""
        prismatic = scenes[0].robot.joints[joint].prismatic
        period = 2.0 * travel(scenes, joint) if prismatic else 2.0 * np.pi
        low, high = positions(scenes, joint)
        return {
            "period": (period,),
            "waves": WAVES,
            "lowest": (low,),
            "highest": (high,),
        }

    def simpler(self, settings: Settings) -> dict[str, float] | None:
        """Return the next smaller number of waves."""
        fewer = [waves for waves in WAVES if waves < settings["waves"]]
        return {**settings, "waves": fewer[-1]} if fewer else None

    def laws(self, robot: Robot, joint: int, settings: Settings) -> Mapping[int, Law]:
        """Return the direction of motion times cosines and sines."""
        waves = range(1, round(settings["waves"]) + 1)
        place = "q"
        numbers = {"rate": 2.0 * np.pi / settings["period"]}
        if "lowest" in settings:
            place = "min(max(q, lowest), highest)"
            numbers |= {name: settings[name] for name in ("lowest", "highest")}
        parts = {"turn": f"rate * {place}", "way": "sign(dq)"}
        terms = [
            f"way * {wave}({k} * turn)" for k, wave in product(waves, ("cos", "sin"))
        ]
        return {joint: Law(terms=tuple(terms), parts=parts, numbers=numbers)}
