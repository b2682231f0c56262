"""Prior knowledge of the robot before the experiment: its torque, noise and parameters.

Letters: theta (b,) are the base parameters, H (..., n, b) the rows of the regressor, so
that H theta is the rigid body's torque [N m]. The covariance of theta is root root',
root (b, k).

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
from seqid_cli.identify.rigid.posterior import gravity_prior
from seqid_cli.logs.recording import Recording
from seqid_cli.model.friction import (
    FrictionSurface,
    friction_torque,
    slowest_speeds,
)
from seqid_cli.model.torque import friction_surfaces, known_rotors, standard_parameters
from seqid_cli.motion.options import MotionOptions
from seqid_cli.motion.planned import COEFFICIENTS, Shapes
from seqid_cli.params.schema import RigidStage, Stages
from seqid_cli.plan.limits import Limits
from seqid_cli.plan.moves.fourier import COARSE_HZ, SPARSE, Moves, placed
from seqid_cli.plan.nuisance import (
    JointRows,
    NuisanceInformation,
    friction_size,
    move_terms,
)
from seqid_cli.plan.settings import MarginSettings
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

NOISE_HZ = 25.0  # the bandwidth of the noise that is assumed


@dataclass(frozen=True, kw_only=True)
class Belief:
    """Knowledge of a robot before the experiment.

    Parameters
    ----------
    robot : Robot
    basis : Basis
        The base parameters.
    limits : Limits
    surfaces : list of FrictionSurface or None
        Friction of each joint, where a stage knows it.
    theta : (b,) float, optional
        Base parameters; None where neither a stage nor a URDF gives any.
    covariance_root : (b, k) float
        Root of their covariance ``covariance_root @ covariance_root.T``.
    friction : (n,) float
        Size of friction where there is no surface [N m].
    information_rate : (n,) float
        Information per second and (N m)^2 of each joint, by its noise.
    sweep_variance : (n,) float
        Variance [(N m)^2] that a friction surface leaves of one way of a slow sweep, as
        a friction stage measured it; NaN where none did.
    prior : (b, b) float
        Information on the base parameters from earlier stages.
    slow_speed : (n,) float
        Speed below which a joint's samples count little [rad/s; m/s where prismatic].
    noise_origin : str
        Where `information_rate` comes from, in words.
    geometry : Geometry, optional
        Shapes of the arm, and boxes to keep out of.
    floor : Floor, optional
    margins : MarginSettings
        How far moves stay from the limits of the torque.
    """

    robot: Robot
    basis: Basis
    limits: Limits
    surfaces: list[FrictionSurface | None]
    theta: Array | None
    covariance_root: Array
    friction: Array
    information_rate: Array
    sweep_variance: Array
    prior: Array
    slow_speed: Array
    noise_origin: str
    geometry: Geometry | None = None
    floor: Floor | None = None
    margins: MarginSettings = MarginSettings()

    @property
    def bounded(self) -> bool:
        """True where there is anything to touch: the arm itself, boxes or the floor."""
        return self.geometry is not None or self.floor is not None

    def touches(self, q: Array) -> Mask:
        """Return which postures q (N, n) touch something or have a point too low."""
        touched = np.zeros(len(q), dtype=bool)
        if self.floor is not None:
            touched = self.floor.below(q)
        # Shapes are dear to check: only postures above the floor are.
        if self.geometry is not None and not touched.all():
            touched[~touched] = self.geometry.collides(q[~touched])
        return touched

    def collides(self, q: Array) -> Mask:
        """Return which of moves or sweeps q (M, N, n) touch something at any time."""
        if not self.bounded:
            return np.zeros(len(q), dtype=bool)
        return np.array([self.touches(postures).any() for postures in q])

    def depth(self, q: Array) -> Array:
        """Return how far below the floor moves q (M, N, n) go at most (M,) [m]."""
        if self.floor is None:
            return np.zeros(len(q))
        height = self.floor.height(q.reshape(-1, q.shape[2])).reshape(q.shape[:2])
        return np.asarray(np.maximum(-height.min(axis=1), 0.0))

    def regressor(self, moves: Moves) -> Array:
        """Return the rows H (M, N, n, b) of the base parameters."""
        M, N, n = moves.q.shape
        H = base_regressor(
            self.robot,
            self.basis,
            moves.q.reshape(-1, n),
            moves.dq.reshape(-1, n),
            moves.ddq.reshape(-1, n),
        )
        return H.reshape(M, N, n, self.basis.size)

    def weights(self, moves: Moves) -> Array:
        """Return the information of samples (M, N, n) per (N m)^2: those that slide."""
        step_s = float(moves.t[1] - moves.t[0])
        certainty = moves.dq**2 / (moves.dq**2 + self.slow_speed**2)
        return step_s * self.information_rate * certainty

    def information(self, moves: Moves, H: Array) -> Array:
        """Return the information (M, b, b) of moves with rows H (M, N, n, b)."""
        weighted = np.sqrt(self.weights(moves))[..., None] * H
        flat = weighted.reshape(len(H), -1, H.shape[3])
        return np.asarray(flat.transpose(0, 2, 1) @ flat)

    def friction_sizes(self, states: Moves) -> Array:
        """Return the sizes (M, N, n) of the joints' friction [N m]."""
        sizes = np.empty(states.q.shape)
        for j, surface in enumerate(self.surfaces):
            q = states.q[..., j]
            size = friction_size(
                surface,
                float(self.friction[j]),
                q.ravel(),
                states.dq[..., j].ravel(),
                slowest=float(self.slow_speed[j]),
            )
            sizes[..., j] = size.reshape(q.shape)
        return sizes

    def torque_rates(self, states: Moves) -> Array | None:
        """Return d tau / dt (M, N, n) of dense samples [N m/s].

        None where no torque is known.
        """
        if self.theta is None:
            return None
        step_s = float(states.t[1] - states.t[0])
        rotor_inertia = gear_ratios(self.robot) ** 2 * known_rotors(self.robot)
        rigid = self.regressor(states) @ self.theta + rotor_inertia * states.ddq
        rigid_rate = np.gradient(rigid, step_s, axis=1)

        # Friction's step at a reversal is no rate: samples there do not count.
        size_rate = np.gradient(self.friction_sizes(states), step_s, axis=1)
        return np.asarray(rigid_rate + np.sign(states.dq) * size_rate)

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

    def torque(self, moves: Moves, H: Array) -> Array:
        """Return the torque that the joints need, with the margin for its error on top.

        The robot may be heavier than believed.

        Parameters
        ----------
        moves : Moves
            Samples of M moves.
        H : (M, N, n, b) float
            Their rows of the base parameters.

        Returns
        -------
        (M, N, n) array
            Largest size of the torque [N m]; zero where no torque is known.
        """
        if self.theta is None:
            return np.zeros(H.shape[:3])
        n = self.robot.n
        rotor_inertia = gear_ratios(self.robot) ** 2 * known_rotors(self.robot)
        tau = H @ self.theta + rotor_inertia * moves.ddq
        friction = friction_torque(
            self.surfaces, moves.q.reshape(-1, n), moves.dq.reshape(-1, n)
        )
        tau += friction.reshape(tau.shape)
        std_error = np.sqrt(np.sum((H @ self.covariance_root) ** 2, axis=3))
        return np.asarray(np.abs(tau) + self.margins.torque_sigma * std_error)

    def overload(self, moves: Moves, H: Array) -> Array:
        """Return each move's largest torque over its limit (M,); 1 is the most."""
        return np.asarray((self.torque(moves, H) / self.limits.torque).max(axis=(1, 2)))


def belief_of(
    robot: Robot,
    stages: Stages,
    limits: Limits,
    *,
    geometry: Geometry | None = None,
    floor: Floor | None = None,
    margins: MarginSettings = MarginSettings(),
    rest_share: float = 0.02,
    friction_share: float = 0.1,
) -> Belief:
    """Collect the knowledge of a robot from stages and the URDF.

    Parameters
    ----------
    robot : Robot
    stages : Stages
        What is identified already.
    limits : Limits
    geometry : Geometry, optional
    floor : Floor, optional
    margins : MarginSettings
        How far moves stay from the limits of the torque.
    rest_share : float
        Share of the largest speed below which samples count little.
    friction_share : float
        Friction where there is no surface, over the usual torque.

    Returns
    -------
    Belief
    """
    basis = free_basis(robot)
    surfaces = friction_surfaces(stages, robot)
    theta, root = _parameters(robot, basis, stages)
    gravity = gravity_prior(stages.gravity, basis, robot.joint_names)

    # The usual torque, on which friction and noise depend, is computed from a belief
    # without them.
    without_noise = Belief(
        robot=robot,
        basis=basis,
        limits=limits,
        surfaces=surfaces,
        theta=theta,
        covariance_root=root,
        friction=np.zeros(robot.n),
        information_rate=np.ones(robot.n),
        sweep_variance=np.full(robot.n, np.nan),
        prior=gravity.A.T @ gravity.A,
        slow_speed=np.maximum(slowest_speeds(surfaces), rest_share * limits.speed),
        noise_origin="",
        margins=margins,
    )
    usual_torque = _usual_torque(without_noise)
    density, noise_origin = _density(without_noise, stages, usual_torque)
    return replace(
        without_noise,
        friction=friction_share * usual_torque,
        information_rate=density,
        sweep_variance=_sweep_variance(robot, stages),
        noise_origin=noise_origin,
        geometry=geometry,
        floor=floor,
    )


def information_of(belief: Belief, recordings: Iterable[Recording]) -> Array:
    """Sum up the information of logs, over samples in which joints slide.

    Each log has nuisance terms of its own, which are marginalised: logs of different
    sessions need not share them.

    Parameters
    ----------
    belief : Belief
    recordings : iterable of Recording

    Returns
    -------
    (b, b) array
        Information on the base parameters.
    """
    size = belief.basis.size
    total = np.zeros((size, size))
    for recording in recordings:
        motion = torque_motion(recording, belief.robot, MotionOptions())
        nuisance = NuisanceInformation(belief.robot.n, size, move_terms)
        for rows, H in filtered_regressor(motion, belief.robot, belief.basis):
            states = Moves(
                motion.t[rows],
                motion.q[None, rows],
                motion.dq[None, rows],
                motion.ddq[None, rows],
            )
            speed_squared = motion.dq[rows] ** 2
            weights = (
                belief.information_rate
                * speed_squared
                / (speed_squared + belief.slow_speed**2)
                / motion.rate_hz
            )
            weighted = (np.sqrt(weights)[..., None] * H).reshape(-1, size)
            total += weighted.T @ weighted

            belief.add_nuisances(
                nuisance, states, H[None], weights[None], belief.torque_rates(states)
            )
        total -= nuisance.lost
    return total


def typical(belief: Belief, seed: int, *, count: int = 60) -> Moves:
    """Draw moves of all joints that stand for the robot's work: errors count there.

    Parameters
    ----------
    belief : Belief
    seed : int
    count : int
        Number of moves.

    Returns
    -------
    Moves
        10 s each, at the rate of sparse samples.
    """
    rng = np.random.default_rng(seed)
    shape = (count, belief.robot.n)
    coefficients = rng.normal(size=(*shape, COEFFICIENTS))
    coefficients *= belief.limits.moves[:, None]
    places = rng.uniform(size=shape)
    drawn = np.dstack([coefficients, places, np.ones(shape)])
    return placed(Shapes.over(10.0, COARSE_HZ), drawn, belief.limits).every(SPARSE)


def _parameters(
    robot: Robot, basis: Basis, stages: Stages, *, urdf_share: float = 0.1
) -> tuple[Array | None, Array]:
    """Return the base parameters (b,) and the root (b, k) of their covariance.

    A stage takes the place of the URDF, and inertia that of gravity.
    """
    theta: Array | None = None
    root = np.zeros((basis.size, 0))
    if robot.nominal is not None:
        phi = np.append(robot.nominal.ravel(), np.zeros(robot.n))
        theta = basis.expression @ phi
        root = urdf_share * basis.expression * phi

    for stage in (stages.gravity, stages.inertia):
        if stage is None or not stage.parameters:
            continue
        if theta is None:
            theta = basis.expression @ _all_standard_parameters(stage, robot)
        of_stage = [basis.names.index(parameter.name) for parameter in stage.parameters]
        theta[of_stage] = [parameter.value for parameter in stage.parameters]

        variances, directions = np.linalg.eigh(np.array(stage.covariance))
        stage_root = np.zeros((basis.size, len(of_stage)))
        stage_root[of_stage] = directions * np.sqrt(np.maximum(variances, 0.0))
        root[of_stage] = 0.0
        root = np.hstack([root, stage_root])
    return theta, root


def _all_standard_parameters(stage: RigidStage, robot: Robot) -> Array:
    """Return the standard parameters of links and rotors, one after the other."""
    return np.concatenate([x.ravel() for x in standard_parameters(stage, robot.n)])


def _usual_torque(belief: Belief, *, moves: int = 20) -> Array:
    """Return the RMS torque (n,) [N m] of the rigid body in typical moves.

    Zero where no torque is known.
    """
    if belief.theta is None:
        return np.zeros(belief.robot.n)
    torque = belief.regressor(typical(belief, seed=0)[:moves]) @ belief.theta
    return np.asarray(np.sqrt(np.mean(torque**2, axis=(0, 1))))


def _density(
    belief: Belief,
    stages: Stages,
    usual_torque: Array,
    *,
    friction_hz: float = 2.0,
    noise_share: float = 0.03,
) -> tuple[Array, str]:
    """Return information (n,) per second and (N m)^2, and in words its origin."""
    std_dev = noise_share * usual_torque
    origin = "assumed: a thirtieth of the usual torque; errors are relative to that"
    if not std_dev.any():
        std_dev = np.ones(belief.robot.n)
        reason = "the links weigh nothing"
        if belief.theta is None:
            reason = "no torque is known"
        origin = f"assumed: 1 N m, as {reason}"
    # Joints that carry little have noise all the same.
    noise = np.maximum(std_dev, 0.1 * std_dev.max()) ** 2 / NOISE_HZ

    inertia = stages.inertia
    measured_density = inertia.noise_density if inertia else {}
    friction = stages.friction.joints if stages.friction else {}
    for j, name in enumerate(belief.robot.joint_names):
        if inertia and inertia.cutoff_hz and name in inertia.rmse:
            noise[j] = inertia.rmse[name] ** 2 / inertia.cutoff_hz
        if name in friction:
            noise[j] += friction[name].rmse ** 2 / friction_hz
        if name in measured_density:
            noise[j] = measured_density[name] ** 2

    if measured_density or (inertia and inertia.cutoff_hz):
        origin = "what the stages left of the torque"
    return 2.0 / noise, origin


def _sweep_variance(robot: Robot, stages: Stages, *, parts: int = 4) -> Array:
    """Return the variance (n,) [(N m)^2] that friction surfaces leave of one slow way.

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
