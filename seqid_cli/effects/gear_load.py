"""Losses that grow with the torque which a gear passes on; its rotor may be unknown.

The gear passes to the link what turns the joint but for its own rotor,

    tau_L = tau_rigid - I_r ddq.

At the joints near the base no motion tells the reflected rotor inertia I_r [kg m^2]
from the link's. At others only couplings of the joints do, and a file that was
identified without the losses has made the rotor of them. Where the robot file does not
give it, losses tell: they do not grow with the torque that the rotor takes. I_r is then
searched, from none to all of the smallest inertia about the joint that the logs show.
Hamon, Gautier, Garrec, "New dry friction model with load- and velocity-dependence and
dynamic identification of multi-DOF robots", ICRA 2011.
"""

from collections.abc import Mapping, Sequence

from seqid_cli.effects.effect import (
    AnyJoint,
    FrictionEffect,
    Grid,
    Setting,
    Settings,
    knows_load,
    rotor_hidden,
)
from seqid_cli.effects.scene import Scene, Scenes
from seqid_cli.effects.sensitivity import link_inertia
from seqid_cli.typing import Array

ROTOR = "reflected_rotor_inertia"
SHARES = (0.02, 0.06, 0.2, 0.6)  # of the smallest inertia about the joint


class LoadLoss(FrictionEffect):
    """An effect of the torque that a gear passes on."""

    sided = True
    steady = True
    settings = (
        Setting(ROTOR, "kg m^2", low=1e-12, high=1e6, logarithmic=True, asked=False),
    )

    def available(self, scenes: Scenes, joint: AnyJoint) -> bool:
        """Return whether the joint moves and the model knows the load of its gear."""
        return super().available(scenes, joint) and knows_load(scenes)

    def grid(self, scenes: Scenes, joint: int, residual: Sequence[Array]) -> Grid:
        """Yield no rotor, then some rotors that the joint may have."""
        yield {}
        yield from self.beyond(scenes, joint)

    def beyond(self, scenes: Scenes, joint: int) -> Grid:
        """Yield rotor inertias if no file knows them well and no sensor is there."""
        measured = all(scene.sensor is not None for scene in scenes)
        if measured or knows_rotor(scenes[0], joint):
            return
        largest = smallest_inertia(scenes, joint)
        if largest > 0.0:
            yield from ({ROTOR: share * largest} for share in SHARES)

    def between(self, settings: Settings) -> tuple[Setting, ...]:
        """Return the rotor inertia, where there is one to search."""
        return self.settings if ROTOR in settings else ()

    def load(self, settings: Settings) -> tuple[str, Mapping[str, float]]:
        """Return the formula of the torque passed to the link, and its numbers.

        The torque is in N m. A torque sensor behind the gear does not see a rotor,
        whether one is searched or not.
        """
        if ROTOR not in settings:
            return "load", {}
        return f"(load + (rotor - {ROTOR}) * load_is_modelled * ddq)", settings

    def plausible(
        self, scenes: Scenes, joint: int, settings: Settings, c: Array
    ) -> bool:
        """Return whether losses are bounded and the link has inertia of its own."""
        leaves_a_link = ROTOR not in settings or settings[ROTOR] <= smallest_inertia(
            scenes, joint
        )
        return leaves_a_link and super().plausible(scenes, joint, settings, c)


def smallest_inertia(scenes: Scenes, joint: int) -> float:
    """Return the smallest modelled inertia about a joint, kg m^2, at least 0.

    It is that of the links and of the joint's own rotor.
    """
    smallest = min(
        float(link_inertia(scene, joint)[:, joint].min() + scene.rotor[joint])
        for scene in scenes
    )
    return max(smallest, 0.0)


def knows_rotor(scene: Scene, joint: int) -> bool:
    """Return whether the file knows a rotor better than the finest share that is tried.

    The rotor turns `SHARES[0]` of the inertia about the joint, then.
    """
    if scene.model.rotor_std is None:
        return not rotor_hidden(scene.robot, joint)
    std_error = float(scene.gear[joint] ** 2 * scene.model.rotor_std[joint])
    return std_error <= SHARES[0] * smallest_inertia([scene], joint)
