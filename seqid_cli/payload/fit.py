"""Least squares for the body at the flange, and its errors.

A body at the flange adds its standard parameters phi (10,) to those of the last link,
so that with H the regressor of the base parameters (Eq. 4) and E their expression in
standard parameters

    tau - tau_model(q, dq, ddq) = H E_n phi + sum_k a_k f_k + e,

E_n the ten columns of E for the last link. Friction may have changed since the model
was identified: f is the joint's own friction and friction in proportion to its speed,
a_k their changes as a share, known to be about zero. Effects of the model that depend
on the load are evaluated with the payload found so far.

Errors come from the logs with the payload (blocks of time, jackknifed), from the
parameters of the model without it, from friction that may have changed, and from the
torque constants, which scale the payload as they scale the model.
"""

from collections.abc import Iterable
from dataclasses import dataclass, replace

import numpy as np

from seqid_cli.effects.fitted import fitted_effects
from seqid_cli.errors import QualityError
from seqid_cli.identify.options import InertiaOptions
from seqid_cli.identify.prediction.predict import Predictor
from seqid_cli.identify.regression.equations import blocks, filtered_regressor
from seqid_cli.identify.regression.least_squares import (
    Accumulator,
    Prior,
    Solution,
    solve,
)
from seqid_cli.identify.rigid.posterior import constant_moves, moves_covariance
from seqid_cli.logs.recording import Recording, torque_of
from seqid_cli.model.bodies.nearest import identified
from seqid_cli.model.torque import TorqueModel, sampled_friction
from seqid_cli.motion.imu.link_acceleration import log_motion
from seqid_cli.motion.motion import Motion
from seqid_cli.params.schema import Stages
from seqid_cli.robot.base_parameters import free_basis
from seqid_cli.robot.regressor import PER_LINK
from seqid_cli.robot.types import Robot
from seqid_cli.typing import Array, Mask

# Changes of each joint's friction: as it is, and in proportion to the speed.
FRICTION_TERMS = 2


@dataclass(frozen=True, kw_only=True)
class PayloadFit:
    """The body that the logs carry, and how well the model predicts them with it.

    RMS values are of the samples at which a joint slides, N m (N where prismatic).
    """

    # (10,) standard parameters of the body in the frame of the last joint.
    phi: Array
    # (10, 10) covariance of these, with all errors.
    covariance: Array
    # (10,) whether the logs alone determine a parameter.
    determined: Mask
    # (n,) RMS error of the predicted torque without the body.
    rmse_without: Array
    # (n,) the same with the body.
    rmse_with: Array
    # (n,) RMS of the measured torque.
    torque_rms: Array
    # (n,) number of samples at which a joint slides.
    n_samples: Array
    # (n,) share by which friction differs from the model's.
    friction_change: Array


def fit_payload(
    recordings: Iterable[Recording],
    robot: Robot,
    stages: Stages,
    *,
    options: InertiaOptions,
    friction_change: float,
    rounds: int = 3,
) -> PayloadFit:
    """Identify what the logs carry beyond a model.

    Parameters
    ----------
    recordings : iterable of Recording
        Logs with the payload. All of them are held with their motion.
    robot : Robot
        The arm, of n joints.
    stages : Stages
        The model without the payload.
    options : InertiaOptions
        How motion is estimated.
    friction_change : float
        Standard deviation of the change of each joint's friction, as a share of it.
    rounds : int
        Fits in all, where effects depend on the load and so on the payload.

    Returns
    -------
    PayloadFit
        The body in the frame of the last joint.

    Raises
    ------
    InputError
        A log has neither torque nor current.
    QualityError
        No joint slides.
    """
    logs = []
    for recording in recordings:
        # Asked for first: a log without torque is refused before its motion, which
        # takes long, is worked out.
        torque_of(recording)
        motion = log_motion(
            recording, robot, options.motion, imu=stages.imu, source=options.source
        )
        logs.append((recording, motion))

    model = TorqueModel.from_stages(stages, robot)
    effects = fitted_effects(stages, robot)
    unloaded = Predictor(model=model, stages=stages, options=options, effects=effects)
    unloaded_rows = PayloadRows(unloaded, logs)
    if not unloaded_rows.n_samples.any():
        hint = "Record moves of every joint with the load."
        raise QualityError("no joint slides in these logs", hint=hint)

    rows = unloaded_rows
    solution = rows.solved(friction_change)
    phi = solution.theta[:PER_LINK]
    if effects:
        # Friction that grows with the load, say, is another one with the payload. Each
        # round adds the body to the last link, and fits what is still missing of it.
        for _ in range(rounds - 1):
            assert model.phi is not None
            loaded_links = np.vstack([model.phi[:-1], model.phi[-1] + phi])
            loaded = replace(unloaded, model=replace(model, phi=loaded_links))
            rows = PayloadRows(loaded, logs)
            solution = rows.solved(friction_change)
            phi = phi + solution.theta[:PER_LINK]

    rmse_with = [
        equations.residual_rms(solution.theta) if equations.samples else 0.0
        for equations in rows.joints
    ]
    n_samples = np.maximum(unloaded_rows.n_samples, 1)
    covariance = _covariance(rows, solution, stages, robot)
    return PayloadFit(
        phi=phi,
        covariance=covariance[:PER_LINK, :PER_LINK],
        determined=solution.determined[:PER_LINK],
        rmse_without=np.sqrt(unloaded_rows.squared_error / n_samples),
        rmse_with=np.array(rmse_with),
        torque_rms=np.sqrt(unloaded_rows.squared_torque / n_samples),
        n_samples=unloaded_rows.n_samples,
        friction_change=solution.theta[PER_LINK::FRICTION_TERMS],
    )


class PayloadRows:
    """Equations of logs for what a model lacks, joint by joint, at sliding samples.

    The p = 10 + 2 n unknowns are the standard parameters of the body and the changes of
    friction of all n joints.

    Attributes
    ----------
    joints : list of Accumulator
        Rows [H E_n, friction | residual torque] of each joint.
    products_with_base : (n, p, b) array
        Products of the columns of each joint with its H, for what errors of the model's
        b base parameters do.
    products_with_torque : (n, p) array
        Products of these columns with the torque that a torque constant scales.
    n_samples : (n,) array
        Number of samples.
    squared_error, squared_torque : (n,) arrays
        Sums of squares of the residual and of the measured torque, (N m)^2.
    """

    def __init__(
        self, predictor: Predictor, logs: Iterable[tuple[Recording, Motion]]
    ) -> None:
        self.predictor = predictor
        self.robot = predictor.model.robot
        self.basis = free_basis(self.robot)

        n = self.robot.n
        size = PER_LINK + FRICTION_TERMS * n
        self.joints = [Accumulator(size) for _ in range(n)]
        self.products_with_base = np.zeros((n, size, self.basis.size))
        self.products_with_torque = np.zeros((n, size))
        self.n_samples = np.zeros(n)
        self.squared_error = np.zeros(n)
        self.squared_torque = np.zeros(n)

        for recording, motion in logs:
            self._add_log(recording, motion)

    def _add_log(self, recording: Recording, motion: Motion) -> None:
        """Add a log, block by block of about a second."""
        prediction = self.predictor.part(motion, recording, slice(None))
        residual = prediction.residual
        # The measured torque passes the low-pass twice, and so must computed friction.
        friction = motion.filtered(
            sampled_friction(self.predictor.model.surfaces, motion), times=2
        )
        top_speed = np.maximum(np.abs(motion.dq).max(axis=0), 1e-12)
        relative_speed = np.abs(motion.dq) / top_speed

        # Above the cut-off neighbouring samples repeat each other: a few are enough.
        kept_hz = self.predictor.options.motion.samples_per_cutoff * motion.cutoff.hz
        stride = max(1, int(motion.rate_hz / kept_hz))
        for chunk, H in filtered_regressor(motion, self.robot, self.basis):
            for block in blocks(len(H), motion.rate_hz):
                H_block = H[block.start : block.stop : stride]
                rows = slice(
                    chunk.start + block.start, chunk.start + block.stop, stride
                )
                for j in range(self.robot.n):
                    sliding = prediction.sliding[rows][:, j]
                    self._add_joint(
                        j,
                        H=H_block[sliding, j],
                        residual=residual[rows][sliding, j],
                        torque=prediction.tau[rows][sliding, j],
                        friction=friction[rows][sliding, j],
                        relative_speed=relative_speed[rows][sliding, j],
                    )

    def _add_joint(
        self,
        j: int,
        *,
        H: Array,
        residual: Array,
        torque: Array,
        friction: Array,
        relative_speed: Array,
    ) -> None:
        """Add sliding samples of joint `j`.

        H is (N, b), the others are (N,): N m, and speed over the largest of the log.
        """
        equations = self.joints[j]
        own_friction = PER_LINK + FRICTION_TERMS * j
        columns = np.zeros((len(H), equations.size))
        columns[:, :PER_LINK] = H @ self.basis.last_link
        columns[:, own_friction] = friction
        columns[:, own_friction + 1] = friction * relative_speed
        equations.add(columns, residual)

        # Friction is the model's, not measured here: a torque constant scales the rest.
        scaled_torque = torque - friction
        self.products_with_base[j] += columns.T @ H
        self.products_with_torque[j] += columns.T @ scaled_torque

        self.squared_error[j] += float(residual @ residual)
        self.squared_torque[j] += float(torque @ torque)
        self.n_samples[j] += len(residual)

    def solved(self, friction_change: float) -> Solution:
        """Solve for all joints, friction known to have changed by about that share."""
        size = self.products_with_torque.shape[1]
        friction_rows = np.eye(size)[PER_LINK:] / friction_change
        prior = Prior(A=friction_rows, b=np.zeros(len(friction_rows)))
        return solve(self.joints, prior=prior)


def _covariance(
    rows: PayloadRows, solution: Solution, stages: Stages, robot: Robot
) -> Array:
    """Return the covariance (p, p) with errors of model and torque constants."""
    model_parameters = identified(stages, robot)
    weights = solution.sigma**-2.0

    # By how much the solution moves with each base parameter of the model, (p, b).
    products = np.tensordot(weights, rows.products_with_base, 1)
    sensitivity = -solution.bread @ products[:, list(model_parameters.rows)]
    of_model = sensitivity @ model_parameters.held_covariance @ sensitivity.T

    # A torque constant scales the measured torque, and has scaled the model's
    # parameters before: its moves by both ways add up.
    weighted_products = weights[:, None] * rows.products_with_torque
    measured_moves = solution.shares - weighted_products @ solution.bread
    model_moves = {
        j: sensitivity @ move
        for j, move in enumerate(model_parameters.moves)
        if move.any()
    }
    moves = constant_moves(
        solution,
        robot.torque_constant_errors,
        dict(enumerate(measured_moves)),
        model_moves,
    )
    of_torque_constants = moves_covariance(moves, len(sensitivity))
    return solution.covariance + of_model + of_torque_constants
