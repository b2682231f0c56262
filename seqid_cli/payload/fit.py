"""Least squares for the body at the flange, and its errors.

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
from seqid_cli.identify.regression.least_squares import Solution
from seqid_cli.identify.rigid.posterior import constant_moves, moves_covariance
from seqid_cli.imu.link_acceleration import log_motion
from seqid_cli.logs.recording import Recording, torque_of
from seqid_cli.model.bodies.nearest import identified
from seqid_cli.model.torque import TorqueModel
from seqid_cli.params.schema import Stages
from seqid_cli.payload.rows import FRICTION_TERMS, PayloadRows
from seqid_cli.robot.regressor import PER_LINK
from seqid_cli.robot.types import Robot
from seqid_cli.typing import Array, Mask


@dataclass(frozen=True, kw_only=True)
class PayloadFit:
    """The body that the logs carry, and how well the model predicts them with it.

    RMS values are of the samples at which a joint slides, N m (N where prismatic).
    """

    # (10,) standard parameters of the body in the frame of the last joint.
    phi: Array
    # (10, 10) covariance of these, with all errors.
    covariance: Array
    # (10,) standard errors of these.
    std_errors: Array
    # (10,) whether the logs alone determine a parameter.
    determined: Mask
    # (n,) RMS error of the predicted torque without the body.
    rmse_without: Array
    # (n,) the same with the body.
    rmse_with: Array
    # RMS error with the body over that of the torque, of joints that slide.
    shares_left: dict[int, float]
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
    torque_rms = np.sqrt(unloaded_rows.squared_torque / n_samples)
    covariance = _covariance(rows, solution, stages, robot)[:PER_LINK, :PER_LINK]
    return PayloadFit(
        phi=phi,
        covariance=covariance,
        std_errors=np.sqrt(np.maximum(np.diag(covariance), 0.0)),
        determined=solution.determined[:PER_LINK],
        rmse_without=np.sqrt(unloaded_rows.squared_error / n_samples),
        rmse_with=np.array(rmse_with),
        shares_left={
            j: rmse_with[j] / max(float(torque_rms[j]), 1e-300)
            for j in np.flatnonzero(unloaded_rows.n_samples).tolist()
        },
        n_samples=unloaded_rows.n_samples,
        friction_change=solution.theta[PER_LINK::FRICTION_TERMS],
    )


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
