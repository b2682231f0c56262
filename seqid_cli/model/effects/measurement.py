"""What effects of the drive and of its measurement have in common.

They act on the joint's whole torque, tau_measured = F(tau), so that their columns are
built from the modelled torque, and a recording can be freed of them exactly by the
inverse of F.
"""

import abc
from collections.abc import Callable
from dataclasses import replace

from seqid_cli.logs.recording import Recording
from seqid_cli.model.effects.effect import AnyJoint, Columns, Effect, Settings
from seqid_cli.model.effects.memory import Late, Rate
from seqid_cli.model.effects.scene import Joint, Scene
from seqid_cli.robot.types import Robot
from seqid_cli.typing import Array

SMALL_S = 1e-6  # below it the derivative over time is exact enough


class MeasurementEffect(Effect):
    """An effect that a recording can be freed of by correcting the channel that it distorts."""

    family = "measurement"

    @abc.abstractmethod
    def restored(
        self,
        recording: Recording,
        robot: Robot,
        joint: AnyJoint,
        settings: Settings,
        c: Array,
    ) -> Recording:
        """Return a recording without the effect of coefficients c (k,) of a joint, or of all."""


class TorqueMeasurement(MeasurementEffect):
    """One that distorts torque: `true_torque` inverts it, sample by sample or in time."""

    passes = 1  # what has steps is low-passed once in the columns already

    @abc.abstractmethod
    def true_torque(
        self, tau: Array, rate_hz: float, settings: Settings, c: Array
    ) -> Array:
        """Return the torque (N, k) N m that was measured as tau (N, k) at `rate_hz`."""

    def restored(
        self,
        recording: Recording,
        robot: Robot,
        joint: Joint,
        settings: Settings,
        c: Array,
    ) -> Recording:
        """Replace the torque of the joint, or of all."""
        assert recording.tau is not None
        which = slice(None) if joint is None else slice(joint, joint + 1)
        tau = recording.tau.copy()
        tau[:, which] = self.true_torque(tau[:, which], recording.rate_hz, settings, c)
        return replace(recording, tau=tau)


class ModelledTorque(TorqueMeasurement):
    """One whose column is a function of the modelled torque: its law has one term."""

    def columns(self, scene: Scene, joint: Joint, settings: Settings) -> Columns:
        """Evaluate the law of the torque as it should be."""
        laws = self.laws(scene.robot, joint, settings)
        assert laws is not None
        law = next(iter(laws.values()))  # the same at every joint

        def changed(tau: Array) -> Array:
            values = {"tau": tau}
            for name, memory in law.memories.items():
                assert isinstance(memory, Late | Rate)
                values[name] = memory.of_series(tau, scene.motion)
            return law.of_values(values)

        return of_modelled(scene, joint, changed)


def touched(robot: Robot, joint: Joint) -> list[int]:
    """Joints that an effect of one joint, or of all, touches."""
    return list(range(robot.n)) if joint is None else [joint]


def steady_change(scene: Scene, joint: Joint, seconds: float = 0.0) -> Columns:
    """Change of the torque of steady motion over `seconds`, SMALL_S at least, (N, 1) per second."""
    motion, which = scene.motion, touched(scene.robot, joint)
    seconds = seconds if abs(seconds) > SMALL_S else SMALL_S
    later = replace(scene, motion=replace(motion, q=motion.q + seconds * motion.dq))
    now, then = ((one.carried + one.friction)[:, which] for one in (scene, later))
    change = (then - now) / seconds
    return {j: change[:, [k]] for k, j in enumerate(which)}


def of_modelled(
    scene: Scene, joint: Joint, function: Callable[[Array], Array]
) -> Columns:
    """Columns function(tau) of the torque as it should be, ready for one more low-pass.

    The load is measured where a torque sensor does that, else modelled. Rigid torque
    comes from motion that was low-passed once, friction has steps: what friction adds
    to the column is low-passed once here, so that one pass more treats both like
    measured torque.
    """
    which = touched(scene.robot, joint)
    carried = scene.carried[:, which]
    smooth = function(carried)
    stepped = function(carried + scene.friction[:, which]) - smooth
    total = smooth + scene.motion.filtered(stepped)
    return {j: total[:, [k]] for k, j in enumerate(which)}
