"""Prior knowledge of the robot before the experiment: its torque, noise and parameters.

The noise counts by its one-sided density S: 2 / S of information per second and (N
m)^2. An inertia stage has measured it as its parameters felt it. Without one, a
residual of standard deviation s below a cut-off f has S = s^2 / f, and the error of the
friction surface, of standard deviation r, which changes slowly, adds r^2 over
`friction_hz`.
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
from seqid_cli.plan.nuisance import (
    JointRows,
    NuisanceInformation,
    friction_size,
    move_terms,
)
from seqid_cli.robot.base_parameters import (
    Basis,
    base_regressor,
    free_basis,
    gear_ratios,
)
from seqid_cli.robot.types import Robot
from seqid_cli.typing import Array, Mask

if TYPE_CHECKING:
    from seqid_cli.plan.moves.floor import Floor
    from seqid_cli.robot.urdf_model import Geometry

NOISE_HZ = 25.0  # the bandwidth of that noise


@dataclass(frozen=True)
class Belief:
    """A robot before the experiment.

    `theta` (b,) are its base parameters, None where neither a stage nor a URDF gives
    any, with the covariance ``root @ root.T``, `root` (b, k). `friction` (n,) N m is
    the size of friction where no surface tells it. `density` (n,) is the information
    per second and (N m)^2, `sweep_variance` (n,) (N m)^2 what a friction stage has seen
    its surface leave of one way of a slow sweep (NaN: not seen); `prior` (b, b) that on
    the base parameters which earlier stages hold, `slow` (n,) the speed below which a
    joint's samples do not count.
    """

    robot: Robot
    basis: Basis
    limits: Limits
    surfaces: list[FrictionSurface | None]
    theta: Array | None
    root: Array
    friction: Array
    density: Array
    sweep_variance: Array
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
        touched = (
            np.zeros(len(q), dtype=bool) if self.floor is None else self.floor.below(q)
        )
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
        return base_regressor(self.robot, self.basis, *states).reshape(
            M, N, n, self.basis.size
        )

    def weights(self, moves: Moves) -> Array:
        """What samples (M, N, n) tell, per (N m)^2: those that slide, by the noise."""
        step = float(moves.t[1] - moves.t[0])
        return step * self.density * (moves.dq**2 / (moves.dq**2 + self.slow**2))

    def information(self, moves: Moves, H: Array) -> Array:
        """Information (M, b, b) of moves."""
        flat = (np.sqrt(self.weights(moves))[..., None] * H).reshape(
            len(H), -1, H.shape[3]
        )
        return np.asarray(flat.transpose(0, 2, 1) @ flat)

    def friction_sizes(self, states: Moves) -> Array:
        """Return the sizes (M, N, n) N m of the joints' friction."""
        sizes = np.empty(states.q.shape)
        for j, surface in enumerate(self.surfaces):
            q, dq = states.q[..., j], states.dq[..., j]
            size = friction_size(
                surface,
                float(self.friction[j]),
                q.ravel(),
                dq.ravel(),
                slowest=float(self.slow[j]),
            )
            sizes[..., j] = size.reshape(q.shape)
        return sizes

    def torque_rates(self, states: Moves) -> Array | None:
        """Return d tau / dt (M, N, n) N m/s of dense samples; None where no torque is known."""
        if self.theta is None:
            return None
        step = float(states.t[1] - states.t[0])
        rotors = gear_ratios(self.robot) ** 2 * known_rotors(self.robot)
        rigid = self.regressor(states) @ self.theta + rotors * states.ddq
        # Friction's step at a reversal is no rate: samples there do not count.
        friction = np.gradient(self.friction_sizes(states), step, axis=1)
        return np.asarray(
            np.gradient(rigid, step, axis=1) + np.sign(states.dq) * friction
        )

    def add_nuisances(
        self,
        total: NuisanceInformation,
        states: Moves,
        H: Array,
        weights: Array,
        rates: Array | None = None,
    ) -> None:
        """Add what nuisance terms share with the unknowns of rows.

        Parameters
        ----------
        total : NuisanceInformation
            What is added to.
        states : Moves
            Samples of M moves.
        H : (M, N, n, c) float
            Columns of the unknowns.
        weights : (M, N, n) float
            Information of the rows, per (N m)^2.
        rates : (M, N, n) float, optional
            Rates of the torque, which a delay turns into torque [N m/s].
        """
        sizes = self.friction_sizes(states)
        for j in range(self.robot.n):
            rows = JointRows(
                joint=j,
                H=H[:, :, j].reshape(-1, H.shape[3]),
                weight=weights[..., j].ravel(),
                friction=sizes[..., j].ravel(),
                torque_rate=None if rates is None else rates[..., j].ravel(),
            )
            total.add(rows)

    def torque(self, moves: Moves, H: Array, *, sigmas: float = 3.0) -> Array:
        """Torque (M, N, n) N m that the joints need, and `sigmas` standard errors on top."""
        if self.theta is None:
            return np.zeros(H.shape[:3])
        n = self.robot.n
        tau = (
            H @ self.theta
            + gear_ratios(self.robot) ** 2 * known_rotors(self.robot) * moves.ddq
        )
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
    friction_share: float = 0.1,
) -> Belief:
    """Collect the knowledge of a robot from stages and the URDF.

    Where no surface tells it, friction is a `friction_share` of the usual torque; below
    a `rest_share` of the largest speed samples count little.
    """
    basis = free_basis(robot)
    surfaces = friction_surfaces(stages, robot)
    theta, root = _parameters(robot, basis, stages)
    prior = gravity_prior(stages.gravity, basis, robot.joint_names)
    known = prior.A.T @ prior.A
    slow = np.maximum(slowest_speeds(surfaces), rest_share * limits.speed)
    blank = Belief(
        robot=robot,
        basis=basis,
        limits=limits,
        surfaces=surfaces,
        theta=theta,
        root=root,
        friction=np.zeros(robot.n),
        density=np.ones(robot.n),
        sweep_variance=np.full(robot.n, np.nan),
        prior=known,
        slow=slow,
        noise_origin="",
    )
    usual = _usual_torque(blank)
    density, origin = _density(blank, stages, usual)
    return replace(
        blank,
        friction=friction_share * usual,
        density=density,
        sweep_variance=_sweep_variance(robot, stages),
        noise_origin=origin,
        geometry=geometry,
        floor=floor,
    )


def information_of(belief: Belief, recordings: Iterable[Recording]) -> Array:
    """Sum up the information (b, b) of logs, over samples in which joints slide.

    Each log has nuisance terms of its own, which are marginalised: logs of different
    sessions need not share them.
    """
    total = np.zeros((belief.basis.size, belief.basis.size))
    for recording in recordings:
        motion = torque_motion(recording, belief.robot, MotionOptions())
        nuisance = NuisanceInformation(belief.robot.n, belief.basis.size, move_terms)
        for where, H in filtered_regressor(motion, belief.robot, belief.basis):
            states = Moves(
                motion.t[where],
                motion.q[None, where],
                motion.dq[None, where],
                motion.ddq[None, where],
            )
            speed = motion.dq[where] ** 2
            weights = belief.density * speed / (speed + belief.slow**2) / motion.rate_hz
            flat = (np.sqrt(weights)[..., None] * H).reshape(-1, belief.basis.size)
            total += flat.T @ flat
            belief.add_nuisances(
                nuisance, states, H[None], weights[None], belief.torque_rates(states)
            )
        total -= nuisance.lost
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
            phi = np.concatenate(
                [x.ravel() for x in standard_parameters(stage, robot.n)]
            )
            theta = basis.expression @ phi
        own = [basis.names.index(parameter.name) for parameter in stage.parameters]
        theta[own] = [parameter.value for parameter in stage.parameters]
        spread[own] = 0.0
        values, vectors = np.linalg.eigh(np.array(stage.covariance))
        added = np.zeros((basis.size, len(own)))
        added[own] = vectors * np.sqrt(np.maximum(values, 0.0))
        spread = np.hstack([spread, added])
    return theta, spread


def _usual_torque(belief: Belief, *, moves: int = 20) -> Array:
    """Return the RMS torque (n,) N m of the rigid body in typical moves; 0 where none is known."""
    if belief.theta is None:
        return np.zeros(belief.robot.n)
    torque = belief.regressor(typical(belief, seed=0)[:moves]) @ belief.theta
    return np.asarray(np.sqrt(np.mean(torque**2, axis=(0, 1))))


def _density(
    belief: Belief,
    stages: Stages,
    usual: Array,
    *,
    friction_hz: float = 2.0,
    noise_share: float = 0.03,
) -> tuple[Array, str]:
    """Information per second and (N m)^2 of each joint, and where it comes from."""
    sizes = noise_share * usual
    origin = "assumed: a thirtieth of the usual torque; errors are relative to that"
    if not sizes.any():
        why = (
            "no torque is known" if belief.theta is None else "the links weigh nothing"
        )
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


def _sweep_variance(robot: Robot, stages: Stages, *, parts: int = 4) -> Array:
    """Return the variance (n,) (N m)^2 of what friction surfaces leave of one slow way.

    Friction trials are such ways, so that nothing has to be assumed. The RMSE of a
    surface is that of averages over a quarter of a trial: a way has so many `parts`,
    and their mean that much less. NaN for joints without a surface.
    """
    friction = stages.friction.joints if stages.friction else {}
    rmse = [
        friction[name].rmse if name in friction else np.nan
        for name in robot.joint_names
    ]
    return np.array(rmse) ** 2 / parts
