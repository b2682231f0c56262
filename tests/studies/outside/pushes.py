"""Pushes at the flange that show from their start to their end."""

from dataclasses import dataclass

import mujoco
import numpy as np

from tests import Array
from tests.studies.outside.arms import Arm
from tests.studies.outside.robotfiles import STEP_S
from tests.studies.outside.simulate import Effect, built

LONGEST_RAMP_S = 0.3
DRAWS = 20  # of moment and direction, until a push is felt at both of its ends
EVEN = 0.5  # of a unit force's torque, RMS over the push, what each end has at least
EDGE_SHARE = 0.15  # of its length: an end
MOMENTS = 60  # at which a push is looked at
SLOW = 0.05  # of a joint's limit: slower than that it may stick
MOVING = 0.8  # of the moments of each end, in which some joint moves


@dataclass(frozen=True)
class Push:
    """When a log that is asked about is pushed: its place among these, and s of it."""

    log: int
    start: float
    end: float


@dataclass(frozen=True, kw_only=True)
class Shape:
    """A force over time: half a sine, or a plateau between two short ramps."""

    seconds: float
    is_plateau: bool

    def at(self, t: float) -> float:
        """Return the force at a moment (s since it began), 1 at its largest."""
        if not 0.0 < t < self.seconds:
            return 0.0
        if not self.is_plateau:
            return float(np.sin(np.pi * t / self.seconds))
        ramp = min(0.15 * self.seconds, LONGEST_RAMP_S)
        return float(min(t / ramp, (self.seconds - t) / ramp, 1.0))


def pushed(
    arm: Arm,
    motion: Array,
    *,
    log: int,
    shape: Shape,
    share: float,
    usual: Array,
    rng: np.random.Generator,
) -> tuple[Effect, Push]:
    """Draw moment and direction of a push in a motion (N, n) rad.

    Its torque is a share, RMS while it lasts, of the `usual` torque (n,) N m of the
    joint where it is largest.
    """
    since = np.linspace(0.0, shape.seconds, MOMENTS)
    sizes = np.array([shape.at(t) for t in since])
    speed = np.abs(np.gradient(motion, STEP_S, axis=0))
    slow = np.array([SLOW * link.speed for link in arm.links[: arm.n]])
    n_end = round(EDGE_SHARE * MOMENTS)
    most_even, best = -1.0, (0.0, np.zeros(3), 1.0)
    for _ in range(DRAWS):
        start = float(rng.uniform(1.5, len(motion) * STEP_S - shape.seconds - 1.0))
        way = rng.normal(size=3)
        way /= np.linalg.norm(way)
        rows = ((start + since) / STEP_S).astype(int)
        torques = flange_torques(arm, motion[rows], way) / usual
        # What a joint at rest feels its friction holds.
        slides = speed[rows] > slow
        torques *= slides
        moves = slides.any(axis=1)
        share_moving = min(moves[:n_end].mean(), moves[-n_end:].mean())
        # Where a force turns no joint nobody can say that it is there.
        felt_of_joint = [
            np.sqrt(np.mean(part**2, axis=0))
            for part in (torques[:n_end], torques[-n_end:], torques)
        ]
        at_start, at_end, on_the_whole = (float(felt.max()) for felt in felt_of_joint)
        evenness = min(at_start, at_end) / max(on_the_whole, 1e-12)
        if share_moving < MOVING:
            evenness *= 0.1 * share_moving
        if evenness > most_even:
            of_joint = np.sqrt(np.mean((sizes[:, None] * torques) ** 2, axis=0))
            most_even, best = evenness, (start, way, float(of_joint.max()))
        if evenness > EVEN:
            break
    start, way, unit_share = best
    force = share / max(unit_share, 1e-6)

    def flange(scale: float, t: float) -> Array:
        return scale * force * shape.at(t - start) * way

    effect = Effect(None, flange=flange, name="external_contact")
    return effect, Push(log, start, start + shape.seconds)


def flange_torques(arm: Arm, postures: Array, way: Array) -> Array:
    """Return the torques (K, n) N m of a unit force (3,) at the last body, in postures
    (K, n) rad.
    """
    model = built(arm)
    data = mujoco.MjData(model)
    jacobian = np.zeros((3, model.nv))
    torques = np.empty((len(postures), arm.n))
    for k, posture in enumerate(postures):
        data.qpos[:] = posture
        mujoco.mj_fwdPosition(model, data)
        mujoco.mj_jacBodyCom(model, data, jacobian, None, model.nbody - 1)
        torques[k] = jacobian.T @ way
    return torques
