"""Least squares for the body at the flange, and its errors.

Errors come from the logs with the payload (blocks of time, jackknifed), from the parameters of the
model without it, from friction that may have changed, and from the torque constants, which scale
the payload as they scale the model.
"""

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from seqid_cli.errors import QualityError
from seqid_cli.identify.options import InertiaOptions
from seqid_cli.identify.regression.least_squares import Prior, Solution, solve
from seqid_cli.identify.rigid.posterior import constant_moves, moves_covariance
from seqid_cli.logs.recording import Recording, torque_of
from seqid_cli.model.bodies.nearest import identified
from seqid_cli.motion.imu.link_acceleration import log_motion
from seqid_cli.motion.motion import Motion
from seqid_cli.params.schema import Stages
from seqid_cli.payload.rows import FRICTION_TERMS, LoadedModel, PayloadRows
from seqid_cli.robot.regressor import PER_LINK
from seqid_cli.robot.types import Robot
from seqid_cli.typing import Array, Mask


@dataclass(frozen=True)
class PayloadFit:
    """Standard parameters `phi` (10,) of the body in the frame of the last joint.

    `covariance` (10, 10) is with all errors; `determined` (10,) says which the logs give by
    themselves. `before`, `after` (n,) N m are the RMS errors of the sliding samples without and
    with the body, `measured` that of the torque, `friction_change` (n,) by how much friction was
    found to differ [1].
    """

    phi: Array
    covariance: Array
    determined: Mask
    before: Array
    after: Array
    measured: Array
    samples: Array
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

    `recordings`: the logs; they are held with their motion, which the rounds share.
    `friction_change`: standard deviation of each joint's change of friction [1]. Raises InputError
    if a log carries neither torque nor current. Raises QualityError if no joint slides in these
    logs.
    """
    plain = LoadedModel.of(stages, robot, options)
    logs = []
    for log in recordings:
        torque_of(log)  # there, before the motion is worked out
        motion = log_motion(log, robot, options.motion, imu=stages.imu, source=options.source)
        logs.append((log, motion))
    first, solution = _solved(logs, plain, friction_change)
    rows, phi = first, solution.theta[:PER_LINK]
    for _ in range(rounds - 1 if plain.effects else 0):
        rows, solution = _solved(logs, plain.with_body(phi), friction_change)
        phi = phi + solution.theta[:PER_LINK]
    after = np.array(
        [joint.residual_rms(solution.theta) if joint.samples else 0.0 for joint in rows.joints]
    )
    count = np.maximum(first.samples, 1)
    return PayloadFit(
        phi=phi,
        covariance=_covariance(rows, solution, stages, robot)[:PER_LINK, :PER_LINK],
        determined=solution.determined[:PER_LINK],
        before=np.sqrt(first.before / count),
        after=after,
        measured=np.sqrt(first.measured / count),
        samples=first.samples,
        friction_change=solution.theta[PER_LINK::FRICTION_TERMS],
    )


def _solved(
    logs: Iterable[tuple[Recording, Motion]], loaded: LoadedModel, friction_change: float
) -> tuple[PayloadRows, Solution]:
    """Rows of the logs and what they say beyond a model."""
    rows = PayloadRows.of(loaded, logs)
    if not rows.samples.any():
        raise QualityError(
            "no joint slides in these logs", hint="Record moves of every joint with the load."
        )
    known = np.eye(rows.scaled.shape[1])[PER_LINK:] / friction_change
    return rows, solve(rows.joints, prior=Prior(known, np.zeros(len(known))))


def _covariance(rows: PayloadRows, solution: Solution, stages: Stages, robot: Robot) -> Array:
    """Own errors, those of the model's base parameters, those of the torque constants."""
    found = identified(stages, robot)
    weights = [sigma**-2.0 for sigma in solution.sigma]
    products = sum(w * cross for w, cross in zip(weights, rows.cross, strict=True))
    gain = -solution.bread @ products[:, list(found.rows)]
    computed = {
        j: solution.shares[j] - solution.bread @ sums * w
        for j, (sums, w) in enumerate(zip(rows.scaled, weights, strict=True))
    }
    through = {j: gain @ move for j, move in enumerate(found.moves) if move.any()}
    moves = constant_moves(solution, robot.torque_constant_errors, computed, through)
    total: Array = (
        solution.covariance
        + gain @ found.held_covariance @ gain.T
        + moves_covariance(moves, rows.scaled.shape[1])
    )
    return total
