"""What effects of the drive and of its measurement have in common.

They act on the joint's whole torque, tau_measured = F(tau), so that their columns are
built from the modelled torque, and a recording can be freed of them exactly by the
inverse of F.
"""

import abc
from collections.abc import Callable
from dataclasses import replace

from seqid_cli.effects.effect import AnyJoint, Columns, Effect, Settings
from seqid_cli.effects.memory import AsLogged, OfSeries
from seqid_cli.effects.scene import Joint, Scene
from seqid_cli.logs.recording import Recording
from seqid_cli.model.torque import sampled_friction
from seqid_cli.robot.types import Robot
from seqid_cli.typing import Array

SMALL_S = 1e-6  # below it the derivative over time is exact enough


class MeasurementEffect(Effect):
    """An effect that is undone by correcting the channel that it distorts."""

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
        """Return a recording without the effect of coefficients c (k,).

        It is the effect of a joint, or of all joints alike where `joint` is None.
        """


class TorqueMeasurement(MeasurementEffect):
    """An effect on measured torque: `true_torque` inverts it, by samples or in time."""

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
        """Replace the torque of the joint, or of all joints."""
        assert recording.tau is not None
        touched_joints = slice(None) if joint is None else slice(joint, joint + 1)
        tau = recording.tau.copy()
        tau[:, touched_joints] = self.true_torque(
            tau[:, touched_joints], recording.rate_hz, settings, c
        )
        return replace(recording, tau=tau)


class OfModelledTorque(Effect):
    """An effect on measured torque whose column is a function of the modelled one."""

    family = "measurement"
    passes = 1  # what has steps is low-passed once in the columns already

    def columns(self, scene: Scene, joint: Joint, settings: Settings) -> Columns:
        """Evaluate the law of the torque as the model has it."""
        laws = self.laws(scene.robot, joint, settings)
        assert laws is not None
        law = next(iter(laws.values()))  # the same at every joint

        joints = touched(scene.robot, joint)

        def law_of_torque(tau: Array, torque_name: str) -> Array:
            values = {"tau": tau}
            for name, memory in law.memories.items():
                if isinstance(memory, AsLogged):
                    values[name] = memory.kept(tau, torque_name, scene, joints)
                    continue
                assert isinstance(memory, OfSeries)
                values[name] = memory.of_series(tau, scene.motion)
            return law.of_values(values)

        return of_modelled(scene, joint, law_of_torque)


class ModelledTorque(OfModelledTorque, TorqueMeasurement):
    """An effect of the modelled torque that can be undone in the measured one."""


def touched(robot: Robot, joint: Joint) -> list[int]:
    """Return the joints that an effect of one joint, or of all joints, touches."""
    return list(range(robot.n)) if joint is None else [joint]


def steady_change(scene: Scene, joint: Joint, seconds: float = 0.0) -> Columns:
    """Compute the change per second (N, 1) of the torque of a steady motion.

    It is taken over `seconds`, SMALL_S at least.
    """
    motion = scene.motion
    joints = touched(scene.robot, joint)
    seconds = seconds if abs(seconds) > SMALL_S else SMALL_S

    later_motion = replace(motion, q=motion.q + seconds * motion.dq)
    later = replace(scene, motion=later_motion)
    # Friction of the joints that are asked for alone: it takes most of the time.
    surfaces = [
        surface if j in joints else None
        for j, surface in enumerate(scene.model.surfaces)
    ]
    friction_later = sampled_friction(surfaces, later_motion)
    torque_now = (scene.carried + scene.friction)[:, joints]
    torque_later = (later.carried + friction_later)[:, joints]
    change = (torque_later - torque_now) / seconds
    return {j: change[:, [k]] for k, j in enumerate(joints)}


def of_modelled(
    scene: Scene, joint: Joint, function: Callable[[Array, str], Array]
) -> Columns:
    """Compute columns function(tau) of the model's torque, ready for one more low-pass.

    The load is measured where a torque sensor does that, else modelled. The function
    gets the name of a torque as well: what follows from it alone may be kept.
    """
    joints = touched(scene.robot, joint)
    carried = scene.carried[:, joints]

    # Rigid torque comes from motion that was low-passed once, friction has steps. What
    # friction adds to the column is low-passed once here, so that one pass more treats
    # both like measured torque.
    of_carried = function(carried, "carried")
    modelled = carried + scene.friction[:, joints]
    by_friction = function(modelled, "modelled") - of_carried
    column = of_carried + scene.motion.filtered(by_friction)
    return {j: column[:, [k]] for k, j in enumerate(joints)}
