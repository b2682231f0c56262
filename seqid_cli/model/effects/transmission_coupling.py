"""One motor turns with two joints: its friction and inertia act on the sum of their rates.

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

import numpy as np

from seqid_cli.model.effects.effect import Coefficient, Effect, Grid, Setting, Settings
from seqid_cli.model.effects.law import Law
from seqid_cli.model.effects.scene import Joint, Scene, Scenes, top_speed
from seqid_cli.model.effects.smooth import Axis
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
    drive = steady = True
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
        """A neighbour is needed."""
        return scenes[0].robot.n > 1

    def grid(self, scenes: Scenes, joint: int, residual: Sequence[Array]) -> Grid:
        """The joint before and the one after, first the one of the own kind, and ratios.

        Between sliding and turning ratios are in units of the top speeds.
        """
        mixed = (
            scenes[0].robot.chain.prismatic != scenes[0].robot.chain.prismatic[joint]
        )
        near = [k for k in (joint - 1, joint + 1) if 0 <= k < len(mixed)]
        for k in sorted(near, key=lambda k: bool(mixed[k])):
            unit = top_speed(scenes, joint) / top_speed(scenes, k) if mixed[k] else 1.0
            yield from (
                {"neighbour": float(k - joint), "ratio": unit * x} for x in RATIOS
            )

    def axis(self, joint: int, settings: Settings) -> Axis:
        """Return the neighbour's velocity."""
        return Axis("velocity", joint + int(settings["neighbour"]))

    def laws(self, robot: Robot, joint: int, settings: Settings) -> Mapping[int, Law]:
        """What direction, rate and acceleration of the combination add, on both joints."""
        k, partner = joint + 1, joint + int(settings["neighbour"])
        parts = {
            "u": f"dq_{k} + ratio * dq_{partner + 1}",
            "du": f"ddq_{k} + ratio * ddq_{partner + 1}",
            "width": (
                f"sqrt(sign_width_{k} ** 2 + (ratio * sign_width_{partner + 1}) ** 2)"
            ),
            "way": "tanh(u / width)",
        }
        own = f"way - sign(dq_{k})", f"u - dq_{k}", f"du - ddq_{k}"
        other = "ratio * way", "ratio * u", "ratio * du"
        return {
            joint: Law(terms=own, parts=parts, numbers=settings),
            partner: Law(terms=other, parts=parts, numbers=settings),
        }

    def guessed(
        self, scene: Scene, joint: int, settings: Settings
    ) -> Mapping[int, Mask]:
        """Where the drive sticks, though both joints move."""
        partner, ratio, width = _drive(scene, joint, settings)
        rate = scene.motion.dq[:, [joint]] + ratio * scene.motion.dq[:, [partner]]
        sticks = slowest_near(scene.motion, rate)[:, 0] < SLIDES * width
        return {joint: sticks, partner: sticks}


def _drive(scene: Scene, joint: int, settings: Settings) -> tuple[int, float, float]:
    """Partner, ratio, and the speed over which the drive's direction changes."""
    partner, ratio = joint + int(settings["neighbour"]), float(settings["ratio"])
    return (
        partner,
        ratio,
        float(np.hypot(*(scene.sign_width[[joint, partner]] * (1.0, ratio)))),
    )
