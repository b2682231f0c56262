"""One motor turns with two joints: friction and inertia act on the sum of their rates.

    u = dq_j + a dq_k,        tau_u = F_c s(u) + F_v u + J du/dt
    tau_j = tau_u,            tau_k = a tau_u                  (virtual work)

F_c [N m], F_v [N m s/rad], J [kg m^2] at the joint, k the neighbour, `ratio` a by how
much the drive of joint j turns with it: 1 or -1, unless another is clearly better; of a
ball screw that slides and turns it is the lead over 2 pi [m/rad], or its inverse. Usual
in wrists, whose last motor sits behind the joint before it: Gautier, Janot, Vandanjon,
"A new closed-loop output error method for parameter identification of robot dynamics",
IEEE Trans. Control Syst. Technol. 21(2), 2013 (Staubli TX40, a = 1).

Seen from joint k the same drive has the ratio 1 / a. The joint whose residual it
explains most gives its name.

What the model already has acts on dq_j. The effect moves it, so that its columns are
differences: s(u) - s(dq_j) and so on.
"""

from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np

from seqid_cli.effects.effect import (
    Coefficient,
    Effect,
    Grid,
    Mirrored,
    Setting,
    Settings,
)
from seqid_cli.effects.law import Law
from seqid_cli.effects.scene import Joint, Scene, Scenes, top_speed
from seqid_cli.effects.smooth import Axis
from seqid_cli.model.friction import SLIDES
from seqid_cli.model.torque import slowest_near
from seqid_cli.robot.types import Robot
from seqid_cli.typing import Array, Mask

RATIOS = (-1.0, -0.4, -0.15, 0.15, 0.4, 1.0)
LARGEST_RATIO = 1e5  # of a thread of 0.06 mm a turn


class TransmissionCoupling(Effect):
    """Friction and inertia on the combined rate of two neighbouring joints."""

    name = "transmission_coupling"
    family = "transmission"
    drive = True
    steady = True
    settings = (
        Setting("neighbour", "1", low=-1.0, high=1.0, continuous=False),
        Setting(
            "ratio", "1", low=-LARGEST_RATIO, high=LARGEST_RATIO, usual=(-1.0, 1.0)
        ),
    )
    over = "acceleration"
    linear = (
        Coefficient("coulomb", "N m", low=0.0),
        Coefficient("viscous", "N m s/rad"),
        Coefficient("inertia", "kg m^2"),
    )
    alike = ("asymmetric_friction", "rotor_inertia")
    separate_by = (
        "each of the two joints alone, then both together, with equal and with opposite"
        " directions"
    )

    def available(self, scenes: Scenes, joint: Joint) -> bool:
        """Return whether the joint has a neighbour."""
        return scenes[0].robot.n > 1

    def grid(self, scenes: Scenes, joint: int, residual: Sequence[Array]) -> Grid:
        """Yield ratios to both neighbours, first to the one of the joint's own kind.

        Between sliding and turning joints ratios are in units of the top speeds.
        """
        prismatic = scenes[0].robot.chain.prismatic
        of_other_kind = prismatic != prismatic[joint]
        neighbours = [k for k in (joint - 1, joint + 1) if 0 <= k < len(prismatic)]
        neighbours.sort(key=lambda k: bool(of_other_kind[k]))

        for k in neighbours:
            unit = 1.0
            if of_other_kind[k]:
                unit = top_speed(scenes, joint) / top_speed(scenes, k)
            for ratio in RATIOS:
                yield {"neighbour": float(k - joint), "ratio": unit * ratio}

    def mirrored(self, joint: int, settings: Settings) -> Mirrored:
        """Return the drive as one of the neighbour's, with the inverse ratio."""
        return Mirrored(
            joint=_partner(joint, settings),
            settings={
                "neighbour": -settings["neighbour"],
                "ratio": 1.0 / settings["ratio"],
            },
        )

    def axis(self, joint: int, settings: Settings) -> Axis:
        """Return the neighbour's velocity."""
        return Axis("velocity", _partner(joint, settings))

    def laws(self, robot: Robot, joint: int, settings: Settings) -> Mapping[int, Law]:
        """Return what direction, rate and acceleration of the combination add.

        Joints are counted from 1 in formulas.
        """
        partner = _partner(joint, settings)
        j = joint + 1
        k = partner + 1
        parts = {
            "u": f"dq_{j} + ratio * dq_{k}",
            "du": f"ddq_{j} + ratio * ddq_{k}",
            "width": f"sqrt(sign_width_{j} ** 2 + (ratio * sign_width_{k}) ** 2)",
            "way": "tanh(u / width)",
        }
        at_joint = (f"way - sign(dq_{j})", f"u - dq_{j}", f"du - ddq_{j}")
        at_partner = ("ratio * way", "ratio * u", "ratio * du")
        return {
            joint: Law(terms=at_joint, parts=parts, numbers=settings),
            partner: Law(terms=at_partner, parts=parts, numbers=settings),
        }

    def guessed(
        self, scene: Scene, joint: int, settings: Settings
    ) -> Mapping[int, Mask]:
        """Return the samples at which the drive sticks, though both joints move."""
        drive = _drive(scene, joint, settings)
        dq = scene.motion.dq
        rate = dq[:, [joint]] + drive.ratio * dq[:, [drive.partner]]
        slowest = slowest_near(scene.motion, rate)[:, 0]
        sticks = slowest < SLIDES * drive.sign_width
        return {joint: sticks, drive.partner: sticks}


def _partner(joint: int, settings: Settings) -> int:
    return joint + int(settings["neighbour"])


class _Drive(NamedTuple):
    """The drive that turns with two joints.

    `sign_width` is the speed over which its direction changes.
    """

    partner: int
    ratio: float
    sign_width: float


def _drive(scene: Scene, joint: int, settings: Settings) -> _Drive:
    partner = _partner(joint, settings)
    ratio = float(settings["ratio"])
    widths = scene.sign_width[[joint, partner]] * (1.0, ratio)
    return _Drive(partner, ratio, float(np.hypot(*widths)))
