"""One motor turns with two joints: its friction and inertia act on the sum of their rates.

    u = dq_j + a dq_k,        tau_u = F_c s(u) + F_v u + J du/dt
    tau_j = tau_u,            tau_k = a tau_u                  (virtual work)

F_c [N m], F_v [N m s/rad], J [kg m^2] at the joint, k the neighbour, `ratio` a by how much the
drive of joint j turns with it: 1 or -1, unless another is clearly better. Usual in wrists, whose
last motor sits behind the joint before it: Gautier, Janot, Vandanjon, "A new closed-loop output
error method for parameter identification of robot dynamics", IEEE Trans. Control Syst. Technol.
21(2), 2013 (Staubli TX40, a = 1).

What the model already has acts on dq_j. The effect moves it, so that its columns are differences:
s(u) - s(dq_j) and so on.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from seqid_cli.model.effects.effect import Coefficient, Columns, Effect, Setting, Settings
from seqid_cli.model.effects.scene import Scene

Array = NDArray[np.float64]

RATIOS = (-1.0, -0.4, -0.15, 0.15, 0.4, 1.0)


class TransmissionCoupling(Effect):
    """Friction and inertia on the combined rate of two neighbouring joints.

    It is offered at the joint whose drive it is, with the neighbour before and after.
    """

    name = "transmission_coupling"
    family = "transmission"
    settings = (
        Setting("neighbour", "1", low=-1.0, high=1.0, continuous=False),
        Setting("ratio", "1", low=-1.0, high=1.0, usual=(-1.0, 1.0)),
    )
    alike = ("asymmetric_friction", "rotor_inertia")
    separate_by = (
        "each of the two joints alone, then both together, with equal and with opposite directions"
    )

    def coefficients(self, settings: Settings) -> tuple[Coefficient, ...]:
        """Return Coulomb, viscous friction and inertia of the combination."""
        return (
            Coefficient("coulomb", "N m", low=0.0),
            Coefficient("viscous", "N m s/rad"),
            Coefficient("inertia", "kg m^2"),
        )

    def available(self, scenes: Sequence[Scene], joint: int | None) -> bool:
        """A pair of revolute joints is needed."""
        assert joint is not None
        robot = scenes[0].robot
        return not robot.chain.prismatic[joint] and bool(_neighbours(scenes[0], joint))

    def axes(self, scenes: Sequence[Scene], joint: int | None) -> Mapping[str, Sequence[float]]:
        """Neighbours and ratios."""
        assert joint is not None
        return {"neighbour": _neighbours(scenes[0], joint), "ratio": RATIOS}

    def columns(self, scene: Scene, joint: int | None, settings: Settings) -> Columns:
        """What direction, rate and acceleration of the combination add, on both joints."""
        assert joint is not None
        partner, ratio = joint + int(settings["neighbour"]), float(settings["ratio"])
        width = scene.sign_width[joint]
        own, other = (
            np.stack([scene.motion.dq[:, j], scene.motion.ddq[:, j]], axis=1)
            for j in (joint, partner)
        )
        both = own + ratio * other
        drive = np.column_stack([np.tanh(both[:, 0] / width), both])
        already = np.column_stack([scene.sign[:, joint], own])
        return {joint: drive - already, partner: ratio * drive}


def _neighbours(scene: Scene, joint: int) -> list[float]:
    prismatic = scene.robot.chain.prismatic
    near = [k for k in (joint - 1, joint + 1) if 0 <= k < scene.robot.n]
    return [float(k - joint) for k in near if not prismatic[k]]
