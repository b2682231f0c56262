"""Losses that grow with the torque which a gear passes on, where its rotor may not be known.

The gear passes to the link what turns the joint but for its own rotor,

    tau_L = tau_rigid - I_r ddq.

At the joints near the base no motion tells the reflected rotor inertia I_r [kg m^2]
from the link's. Where the robot file does not give it either, losses tell: they do not
grow with the torque that the rotor takes. I_r is then searched, from none to all of the
smallest inertia about the joint that the logs show. Hamon, Gautier, Garrec, "New dry
friction model with load- and velocity-dependence and dynamic identification of
multi-DOF robots", ICRA 2011.
"""

from collections.abc import Mapping, Sequence

from seqid_cli.model.effects.effect import (
    FrictionLaw,
    Grid,
    Setting,
    Settings,
    rotor_hidden,
)
from seqid_cli.model.effects.scene import Scenes
from seqid_cli.model.effects.sensitivity import link_inertia
from seqid_cli.typing import Array

ROTOR = "reflected_rotor_inertia"
SHARES = (0.02, 0.06, 0.2, 0.6)  # of the smallest inertia about the joint


class LoadLoss(FrictionLaw):
    """An effect of the torque that a gear passes on."""

    sided = steady = True
    settings = (
        Setting(ROTOR, "kg m^2", low=1e-12, high=1e6, logarithmic=True, asked=False),
    )
    needs = ("motion", "load")

    def grid(self, scenes: Scenes, joint: int, residual: Sequence[Array]) -> Grid:
        """Yield no rotor, then some that it may have."""
        yield {}
        yield from self.beyond(scenes, joint)

    def beyond(self, scenes: Scenes, joint: int) -> Grid:
        """Yield rotor inertias where neither robot file nor motion nor a sensor tells them."""
        measured = all(scene.sensor is not None for scene in scenes)
        if measured or not rotor_hidden(scenes[0].robot, joint):
            return
        most = _most(scenes, joint)
        if most > 0.0:
            yield from ({ROTOR: share * most} for share in SHARES)

    def between(self, settings: Settings) -> tuple[Setting, ...]:
        """The rotor inertia, where there is one to search."""
        return self.settings if ROTOR in settings else ()

    def load(self, settings: Settings) -> tuple[str, Mapping[str, float]]:
        """Return the formula of the torque [N m] that the gear passes to the link, and its numbers.

        A torque sensor behind the gear does not see a rotor, whoever is looking for
        one.
        """
        if ROTOR not in settings:
            return "load", {}
        return f"(load - {ROTOR} * load_is_modelled * ddq)", settings

    def plausible(
        self, scenes: Scenes, joint: int, settings: Settings, c: Array
    ) -> bool:
        """Ask for bounded losses, and for a link that has inertia of its own."""
        possible = ROTOR not in settings or settings[ROTOR] <= _most(scenes, joint)
        return possible and super().plausible(scenes, joint, settings, c)


def _most(scenes: Scenes, joint: int) -> float:
    """The smallest modelled inertia kg m^2 about a joint that the logs show, never negative."""
    return max(min(float(link_inertia(s, joint)[:, joint].min()) for s in scenes), 0.0)
