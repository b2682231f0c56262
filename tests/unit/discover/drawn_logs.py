"""Logs whose positions, torque and noise are made up, and scenes of them; 500 Hz, two
joints.
"""

import numpy as np

from seqid_cli.discover.scenes import scenes_of
from seqid_cli.discover.survey.rows import Rows, rows_of
from seqid_cli.effects.scene import Scene
from seqid_cli.identify.options import InertiaOptions
from seqid_cli.logs.recording import Recording
from seqid_cli.motion.filters.butterworth import Lowpass
from seqid_cli.motion.options import MotionOptions
from seqid_cli.params.schema import Stages
from tests import Array
from tests.plants.robots.made import made_recording
from tests.plants.robots.two_joint import two_joint_robot

RATE_HZ = 500.0
CUTOFF_HZ = 8.0
OPTIONS = InertiaOptions(motion=MotionOptions(cutoff_hz=CUTOFF_HZ))


def recording(
    q: Array, tau: Array, rate_hz: float = RATE_HZ, name: str = "log"
) -> Recording:
    return made_recording(q, tau, rate_hz=rate_hz, path=name)


def scene_of(log: Recording) -> tuple[Scene, Rows]:
    """Scene without a model, so that all torque is residual, and its rows."""
    found = scenes_of([log], two_joint_robot(), Stages(), options=OPTIONS)
    return found[0], rows_of(found)


def wander(seconds: float, seed: int) -> Array:
    """Positions (N, 2) rad that do not come back: sines of drawn frequencies up to 1.2
    Hz.
    """
    rng = np.random.default_rng(seed)
    t = np.arange(round(seconds * RATE_HZ))[:, None, None] / RATE_HZ
    f, phase = rng.uniform(0.1, 1.2, (12, 2)), rng.uniform(0.0, 2 * np.pi, (12, 2))
    return np.asarray(0.25 * np.sum(np.sin(2 * np.pi * f * t + phase), axis=1))


def resting(seconds: float, rest: float, seed: int) -> Array:
    """Positions (N, 2) rad: smooth moves of 1.5 s between drawn places, `rest` s at
    each.
    """
    rng = np.random.default_rng(seed)
    s = np.linspace(0.0, 1.0, round(1.5 * RATE_HZ))[:, None]
    step, here, parts = 10 * s**3 - 15 * s**4 + 6 * s**5, np.zeros(2), []
    for _ in range(int(seconds / (1.5 + rest))):
        there = rng.uniform(-1.5, 1.5, 2)
        parts += [
            here + (there - here) * step,
            np.tile(there, (round(rest * RATE_HZ), 1)),
        ]
        here = there
    return np.concatenate(parts)


def smooth_torque(q: Array) -> Array:
    """Inertia and friction with steps (N, 2) N m, known exactly."""
    dq = np.gradient(q, axis=0) * RATE_HZ
    return np.asarray(0.5 * np.gradient(dq, axis=0) * RATE_HZ + 2 * np.tanh(dq / 0.02))


def low_passed(values: Array, scene: Scene) -> Array:
    """Values (N, n) of a log as its scene's torque has them."""
    lowpass = Lowpass(CUTOFF_HZ, RATE_HZ)
    return lowpass(lowpass(values))[:: round(RATE_HZ / scene.motion.rate_hz)]
