"""Logs of the hand-made two-joint arm whose torque above and below the cut-off is
known.
"""

from collections.abc import Callable, Iterable, Sequence
from dataclasses import replace

import numpy as np

from seqid_cli.discover.candidates import Candidate
from seqid_cli.discover.select.model import FREE, Model, PriorScale, SelectionProblem
from seqid_cli.discover.select.options import Options
from seqid_cli.discover.select.results import SelectionResult
from seqid_cli.discover.select.selection import select
from seqid_cli.discover.survey.rows import rows_of
from seqid_cli.effects.effect import Effect
from seqid_cli.effects.registry import CATALOGUE
from seqid_cli.effects.scene import Scene
from seqid_cli.params.schema import Parameter, RigidStage, Stages
from seqid_cli.robot.base_parameters import free_basis
from tests import Array
from tests.unit.effects.scenes import scene_of, wander

Extra = Callable[[Scene], Array]  # (N, n) N m, not filtered

NOISE = (0.3, 0.1)  # N m per sample
DRAG = 0.3  # N m s^2/rad^2
HUMP = 1.2  # N m
MASS, OUT = 0.8, 0.3  # kg, m


def arm_scenes(
    extra: Extra | None = None,
    *,
    seed: int = 0,
    logs: int = 3,
    seconds: float = 16.0,
    noise: tuple[float, float] = NOISE,
) -> list[Scene]:
    """Return logs on one clock: the model's torque, white noise, and what is added to
    it.
    """
    rng, scenes = np.random.default_rng(seed), []
    for log in range(logs):
        q = wander(seconds, seed=10 * seed + log, rests=())
        scene = scene_of(q, log=log, start=40.0 * log, shared_clock=True)
        tau = scene.modelled + rng.normal(size=q.shape) * np.array(noise)
        scenes.append(measuring(scene, tau if extra is None else tau + extra(scene)))
    return scenes


def measuring(scene: Scene, tau: Array) -> Scene:
    motion = replace(scene.motion, tau=scene.motion.filtered(tau, times=2))
    return replace(
        scene, motion=motion, measured=tau, period=1.0 / scene.motion.rate_hz
    )


def at_joint(joint: int, torque: Callable[[Scene], Array]) -> Extra:
    """Return a torque (N,) at one joint as one of all."""

    def extra(scene: Scene) -> Array:
        result = np.zeros_like(scene.motion.q)
        result[:, joint] = torque(scene)
        return result

    return extra


def drag(scene: Scene) -> Array:
    """Torque (N,) of the first joint that grows with the square of its speed."""
    v = scene.motion.dq[:, 0]
    return DRAG * v * np.abs(v)


def stribeck(speed: float) -> Extra:
    """A hump in the second joint's friction, at low speed (rad/s)."""
    return at_joint(
        1, lambda s: HUMP * np.exp(-((s.motion.dq[:, 1] / speed) ** 2)) * s.sign[:, 1]
    )


def payload(scene: Scene) -> Array:
    """A point mass at the last link's frame, some way out, in all logs."""
    X = CATALOGUE["payload"].columns(scene, None, {"from_log": 0.0})
    body = MASS * np.array([1.0, OUT, 0, 0, 0, 0, OUT**2, 0, 0, OUT**2])
    return np.stack([X[j] @ body for j in range(scene.robot.n)], axis=1)


def selected(
    scenes: Sequence[Scene],
    effects: Iterable[str | Effect],
    options: Options | None = None,
    stages: Stages | None = None,
) -> SelectionResult:
    """Return what is selected of some effects of the catalogue, or of others."""
    chosen = [CATALOGUE[one] if isinstance(one, str) else one for one in effects]
    return select(ground_of(scenes, stages, options), chosen).told()


def model_of(
    scenes: Sequence[Scene], hold: PriorScale = FREE, stages: Stages | None = None
) -> Model:
    return Model(ground_of(scenes, stages), hold)


def ground_of(
    scenes: Sequence[Scene],
    stages: Stages | None = None,
    options: Options | None = None,
) -> SelectionProblem:
    """Return the rows of scenes, and what they have to be explained by."""
    return SelectionProblem.of(rows_of(scenes), stages or Stages(), options)


def candidate(name: str, joint: int | None, **settings: float) -> Candidate:
    return Candidate(CATALOGUE[name], joint, settings)


def file_of(scene: Scene) -> Stages:
    """Return a parameter file whose rigid body is known to a part in a thousand."""
    basis = free_basis(scene.robot)
    parameters = [
        Parameter(name=name, value=0.0, std_error=1e-3, unit=basis.unit(k))
        for k, name in enumerate(basis.names)
    ]
    kinds = {"condition": 1.0, "rank": basis.size}
    covariance = (1e-6 * np.eye(basis.size)).tolist()
    return Stages(
        inertia=RigidStage(parameters=parameters, covariance=covariance, **kinds)
    )


ALIKE = 0.6  # share of the first joint's motion in the second's


def related_scenes(seed: int, logs: int = 4, seconds: float = 20.0) -> list[Scene]:
    """Return logs in which the second joint moves partly like the first."""
    scenes = []
    for log in range(logs):
        q = wander(seconds, seed=100 * seed + log, top_hz=0.6, rests=())
        q[:, 1] = ALIKE * q[:, 0] + np.sqrt(1 - ALIKE**2) * q[:, 1]
        scenes.append(scene_of(q, log=log))
    return scenes


def coloured(scene: Scene, rng: np.random.Generator) -> Array:
    """Return noise (N, n) N m as the twice low-passed torque has it."""
    white = scene.motion.filtered(rng.normal(size=scene.motion.q.shape), times=2)
    return white / np.std(white, axis=0) * np.array(NOISE)
