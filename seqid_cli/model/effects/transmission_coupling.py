"""One motor turns with two joints: its friction and inertia act on the sum of their rates.

    u = dq_j + sign dq_k,        tau_u = F_c s(u) + F_v u + J du/dt
    tau_j = tau_u,               tau_k = sign tau_u            (virtual work)

F_c [N m], F_v [N m s/rad], J [kg m^2] at the joint, k the neighbour, `sign` +1 or -1 its gears'
sense of turn. Usual in wrists, whose last motor sits behind the joint before it: Gautier, Janot,
Vandanjon, "A new closed-loop output error method for parameter identification of robot dynamics",
IEEE Trans. Control Syst. Technol. 21(2), 2013 (Staubli TX40).
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np
from numpy.typing import NDArray

from seqid_cli.model.effects.effect import Coefficient, Columns, Effect, Setting, Settings
from seqid_cli.model.effects.scene import Scene

Array = NDArray[np.float64]

SPARSE = 4  # samples apart, at which shares are compared


class TransmissionCoupling(Effect):
    """Friction and inertia on the combined rate of two neighbouring joints.

    The pair is one effect: it is offered at the joint whose residual it explains most.
    """

    name = "transmission_coupling"
    family = "transmission"
    settings = (
        Setting("neighbour", "1", low=-1.0, high=1.0, continuous=False),
        Setting("sign", "1", low=-1.0, high=1.0, continuous=False),
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
        return not robot.chain.prismatic[joint] and bool(self._neighbours(scenes[0], joint))

    def _neighbours(self, scene: Scene, joint: int) -> list[int]:
        prismatic = scene.robot.chain.prismatic
        near = [k for k in (joint - 1, joint + 1) if 0 <= k < scene.robot.n]
        return [k - joint for k in near if not prismatic[k]]

    def grid(
        self, scenes: Sequence[Scene], joint: int | None, residual: Sequence[Array]
    ) -> Iterator[dict[str, float]]:
        """Yield neighbours and signs, unless the neighbour has more of its residual explained."""
        assert joint is not None
        for side in self._neighbours(scenes[0], joint):
            for sign in (1.0, -1.0):
                settings = {"neighbour": float(side), "sign": sign}
                own, other = self._shares(scenes, joint, settings, residual)
                if own > other or (own == other and side > 0):
                    yield settings

    def _shares(
        self,
        scenes: Sequence[Scene],
        joint: int,
        settings: Settings,
        residual: Sequence[Array],
    ) -> list[float]:
        """Share of the squared residual that the pair's fit takes away at joint and neighbour.

        Each joint's own direction, rate and acceleration are free meanwhile.
        """
        pair = (joint, joint + int(settings["neighbour"]))
        columns = [self.columns(scene, joint, settings) for scene in scenes]
        X, y = [], []
        for j in pair:
            counts = np.concatenate([r[::SPARSE, j] != 0.0 for r in residual])
            parts = [
                _filtered(scene, np.hstack([own[j], _own_terms(scene, j)]), (joint, j), settings)
                for scene, own in zip(scenes, columns, strict=True)
            ]
            Z, r = (
                np.concatenate(parts)[counts],
                np.concatenate([r[::SPARSE, j] for r in residual])[counts],
            )
            Q = np.linalg.qr(Z[:, 3:])[0]
            X.append(Z[:, :3] - Q @ (Q.T @ Z[:, :3]))
            y.append(r - Q @ (Q.T @ r))
        scale = [max(float(np.linalg.norm(r)), 1e-300) for r in y]
        both = np.vstack([Z / size for Z, size in zip(X, scale, strict=True)])
        ones = np.concatenate([r / size for r, size in zip(y, scale, strict=True)])
        c = np.linalg.lstsq(both, ones, rcond=1e-9)[0]
        left = [np.linalg.norm(r - Z @ c) / size for Z, r, size in zip(X, y, scale, strict=True)]
        return [float(1.0 - share**2) for share in left]

    def columns(self, scene: Scene, joint: int | None, settings: Settings) -> Columns:
        """Direction, rate and acceleration of the combination, on both joints."""
        assert joint is not None
        partner, sign = joint + int(settings["neighbour"]), float(settings["sign"])
        rate, acceleration = (
            x[:, joint] + sign * x[:, partner] for x in (scene.motion.dq, scene.motion.ddq)
        )
        width = max(scene.sign_width[joint], scene.sign_width[partner])
        X = np.stack([np.tanh(rate / width), rate, acceleration], axis=1)
        return {joint: X, partner: sign * X}


def _own_terms(scene: Scene, joint: int) -> Array:
    """What the joint's own friction and inertia would take up, (N, 4)."""
    motion = scene.motion
    own = [scene.sign[:, joint], motion.dq[:, joint], motion.ddq[:, joint]]
    return np.stack([*own, np.ones(scene.samples)], axis=1)


def _filtered(scene: Scene, X: Array, pair: tuple[int, int], settings: Settings) -> Array:
    """Low-passed columns at a few samples, kept with the scene."""
    name = f"coupling {pair[1]} {settings['neighbour']} {settings['sign']}"
    if (name, pair[0]) not in scene.memo:
        kept = scene.motion.filtered(X, times=TransmissionCoupling.passes)[::SPARSE]
        scene.memo[name, pair[0]] = (kept,)
    return scene.memo[name, pair[0]][0]
