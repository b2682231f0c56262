"""Prior knowledge of the robot before the experiment: its torque, noise and parameters.

The noise counts by its one-sided density S: 2 / S of information per second and (N m)^2. An inertia
stage has measured it as its parameters felt it. Without one, a residual of standard deviation s
below a cut-off f has S = s^2 / f, and the error of the friction surface, of standard deviation r,
which changes slowly, adds r^2 over `friction_hz`.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from seqid_cli.identify.regression.equations import filtered_regressor, torque_motion
from seqid_cli.identify.rigid.inertia_equations import slowest_speeds
from seqid_cli.identify.rigid.posterior import gravity_prior
from seqid_cli.logs.recording import Recording
from seqid_cli.model.friction import FrictionSurface, friction_torque
from seqid_cli.model.torque import friction_surfaces, known_rotors, standard_parameters
from seqid_cli.motion.options import MotionOptions
from seqid_cli.motion.planned import COEFFICIENTS, Shapes
from seqid_cli.params.schema import Stages
from seqid_cli.plan.limits import Limits
from seqid_cli.plan.moves.fourier import COARSE_HZ, SPARSE, Moves, placed
from seqid_cli.robot.base_parameters import Basis, base_regressor, free_basis, gear_ratios
from seqid_cli.robot.types import Robot
from seqid_cli.typing import Array, Mask

if TYPE_CHECKING:
    from seqid_cli.plan.moves.floor import Floor
    from seqid_cli.robot.urdf_model import Geometry

NOISE_HZ = 25.0  # the bandwidth of that noise


@dataclass(frozen=True)
class Belief:
    """A robot before the experiment.

    `theta` (b,) are its base parameters, None where neither a stage nor a URDF gives any, with the
    covariance ``root @ root.T``, `root` (b, k). `density` (n,) is the information per second and
    (N m)^2, `prior` (b, b) that on the base parameters which earlier stages hold, `slow` (n,) the
    speed below which a joint's samples do not count.
    """

    robot: Robot
    basis: Basis
    limits: Limits
    surfaces: list[FrictionSurface | None]
    theta: Array | None
    root: Array
    density: Array
    prior: Array
    slow: Array
    noise_origin: str
    geometry: Geometry | None = None
    floor: Floor | None = None

    @property
    def bounded(self) -> bool:
        """Whether there is anything that the arm may touch: itself, boxes, the floor."""
        return self.geometry is not None or self.floor is not None

    def touches(self, q: Array) -> Mask:
        """Return which of the postures q (N, n) touch something or have a point below the floor."""
        touched = np.zeros(len(q), dtype=bool) if self.floor is None else self.floor.below(q)
        if self.geometry is not None and not touched.all():
            touched[~touched] = self.geometry.collides(q[~touched])
        return touched

    def collides(self, q: Array) -> Mask:
        """Return which of moves or sweeps q (M, N, n) touch something at any time."""
        if not self.bounded:
            return np.zeros(len(q), dtype=bool)
        return np.array([self.touches(posture).any() for posture in q])

    def depth(self, q: Array) -> Array:
        """Return how far moves q (M, N, n) go below the floor at their lowest (M,) [m]."""
        if self.floor is None:
            return np.zeros(len(q))
        height = self.floor.height(q.reshape(-1, q.shape[2])).reshape(q.shape[:2])
        return np.asarray(np.maximum(-height.min(axis=1), 0.0))

    def regressor(self, moves: Moves) -> Array:
        """Rows H (M, N, n, b) of the base parameters."""
        M, N, n = moves.q.shape
        states = (x.reshape(-1, n) for x in (moves.q, moves.dq, moves.ddq))
        return base_regressor(self.robot, self.basis, *states).reshape(M, N, n, self.basis.size)

    def weights(self, moves: Moves) -> Array:
        """What samples (M, N, n) tell, per (N m)^2: those that slide, by the noise."""
        step = float(moves.t[1] - moves.t[0])
        return step * self.density * (moves.dq**2 / (moves.dq**2 + self.slow**2))

    def information(self, moves: Moves, H: Array) -> Array:
        """Information (M, b, b) of moves."""
        flat = (np.sqrt(self.weights(moves))[..., None] * H).reshape(len(H), -1, H.shape[3])
        return np.asarray(flat.transpose(0, 2, 1) @ flat)

    def torque(self, moves: Moves, H: Array, *, sigmas: float = 3.0) -> Array:
        """Torque (M, N, n) N m that the joints need, and `sigmas` standard errors on top."""
        if self.theta is None:
            return np.zeros(H.shape[:3])
        n = self.robot.n
        tau = H @ self.theta + gear_ratios(self.robot) ** 2 * known_rotors(self.robot) * moves.ddq
        states = (moves.q.reshape(-1, n), moves.dq.reshape(-1, n))
        tau += friction_torque(self.surfaces, *states).reshape(tau.shape)
        doubt = np.sqrt(np.sum((H @ self.root) ** 2, axis=3))
        return np.asarray(np.abs(tau) + sigmas * doubt)

    def overload(self, moves: Moves, H: Array) -> Array:
        """Largest torque of each move over its limit (M,); at most 1 where the limits hold."""
        return np.asarray((self.torque(moves, H) / self.limits.torque).max(axis=(1, 2)))


def belief_of(
    robot: Robot,
    stages: Stages,
    limits: Limits,
    *,
    geometry: Geometry | None = None,
    floor: Floor | None = None,
    rest_share: float = 0.02,
) -> Belief:
    """Collect the knowledge of a robot from stages and the URDF."""
    basis = free_basis(robot)
    surfaces = friction_surfaces(stages, robot)
    theta, root = _parameters(robot, basis, stages)
    prior = gravity_prior(stages.gravity, basis, robot.joint_names)
    known = prior.A.T @ prior.A
    slow = np.maximum(slowest_speeds(surfaces), rest_share * limits.speed)
    blank = Belief(robot, basis, limits, surfaces, theta, root, np.ones(robot.n), known, slow, "")
    density, origin = _density(blank, stages)
    return replace(blank, density=density, noise_origin=origin, geometry=geometry, floor=floor)


def information_of(belief: Belief, recordings: Iterable[Recording]) -> Array:
    """Sum up H' D H (b, b) over the samples of logs in which joints slide."""
    total = np.zeros((belief.basis.size, belief.basis.size))
    for recording in recordings:
        motion = torque_motion(recording, belief.robot, MotionOptions())
        for where, H in filtered_regressor(motion, belief.robot, belief.basis):
            speed = motion.dq[where] ** 2
            slide = speed / (speed + belief.slow**2)
            weight = np.sqrt(belief.density * slide / motion.rate_hz)
            flat = (weight[..., None] * H).reshape(-1, belief.basis.size)
            total += flat.T @ flat
    return total


def typical(belief: Belief, seed: int, *, count: int = 60) -> Moves:
    """All-joint moves that stand for the robot's work: errors of the torque count there."""
    rng = np.random.default_rng(seed)
    size = (count, belief.robot.n)
    coefficients = rng.normal(size=(*size, COEFFICIENTS)) * belief.limits.moves[:, None]
    drawn = np.dstack([coefficients, rng.uniform(size=size), np.ones(size)])
    return placed(Shapes.over(10.0, COARSE_HZ), drawn, belief.limits).every(SPARSE)


def _parameters(
    robot: Robot, basis: Basis, stages: Stages, *, urdf_share: float = 0.1
) -> tuple[Array | None, Array]:
    """Base parameters, best source last, and the root of their covariance."""
    theta, spread = None, np.zeros((basis.size, 0))
    if robot.nominal is not None:
        phi = np.append(robot.nominal.ravel(), np.zeros(robot.n))
        theta = basis.expression @ phi
        spread = urdf_share * basis.expression * phi
    for stage in (stages.gravity, stages.inertia):
        if stage is None or not stage.parameters:
            continue
        if theta is None:
            phi = np.concatenate([x.ravel() for x in standard_parameters(stage, robot.n)])
            theta = basis.expression @ phi
        own = [basis.names.index(parameter.name) for parameter in stage.parameters]
        theta[own] = [parameter.value for parameter in stage.parameters]
        spread[own] = 0.0
        values, vectors = np.linalg.eigh(np.array(stage.covariance))
        added = np.zeros((basis.size, len(own)))
        added[own] = vectors * np.sqrt(np.maximum(values, 0.0))
        spread = np.hstack([spread, added])
    return theta, spread


def _density(
    belief: Belief, stages: Stages, *, friction_hz: float = 2.0, noise_share: float = 0.03
) -> tuple[Array, str]:
    """Information per second and (N m)^2 of each joint, and where it comes from."""
    sizes = np.zeros(belief.robot.n)
    if belief.theta is not None:
        torque = belief.regressor(typical(belief, seed=0)[:20]) @ belief.theta
        sizes = noise_share * np.sqrt(np.mean(torque**2, axis=(0, 1)))
    origin = "assumed: a thirtieth of the usual torque; errors are relative to that"
    if not sizes.any():
        why = "no torque is known" if belief.theta is None else "the links weigh nothing"
        sizes, origin = np.ones(belief.robot.n), f"assumed: 1 N m, as {why}"
    noise = np.maximum(sizes, 0.1 * sizes.max()) ** 2 / NOISE_HZ
    inertia = stages.inertia
    measured = inertia.noise_density if inertia else {}
    friction = stages.friction.joints if stages.friction else {}
    for j, name in enumerate(belief.robot.joint_names):
        if inertia and inertia.cutoff_hz and name in inertia.rmse:
            noise[j] = inertia.rmse[name] ** 2 / inertia.cutoff_hz
        if name in friction:
            noise[j] += friction[name].rmse ** 2 / friction_hz
        if name in measured:
            noise[j] = measured[name] ** 2
    known = measured or (inertia and inertia.cutoff_hz)
    return 2.0 / noise, "what the stages left of the torque" if known else origin
