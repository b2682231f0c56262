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
from seqid_cli.model.effects.fitted import fitted_effects
from seqid_cli.model.torque import TorqueModel, sampled_friction
from seqid_cli.motion.imu.link_acceleration import log_motion
from seqid_cli.motion.motion import Motion
from seqid_cli.params.schema import Stages
from seqid_cli.robot.base_parameters import free_basis
from seqid_cli.robot.regressor import PER_LINK
from seqid_cli.robot.types import Robot
from seqid_cli.typing import Array, Mask

# changes of each joint's friction: as it is, and in proportion to the speed
FRICTION_TERMS = 2


@dataclass(frozen=True)
class PayloadFit:
    """The body that the logs carry."""

    phi: Array  # (10,) standard parameters in the frame of the last joint
    covariance: Array  # (10, 10) with all errors
    determined: Mask  # (10,) what the logs give by themselves
    before: Array  # (n,) N m, RMS error of the sliding samples without the body
    after: Array  # with it
    measured: Array  # RMS of the torque
    samples: Array  # (n,) that slide
    friction_change: Array  # (n,) [1], by how much friction was found to differ


def fit_payload(
    recordings: Iterable[Recording],
    robot: Robot,
    stages: Stages,
    *,
    options: InertiaOptions,
    friction_change: float,
    rounds: int = 3,
) -> PayloadFit:
    """Identify what the logs carry beyond a model; they are held with their motion.

    `friction_change`: standard deviation of each joint's change of friction [1]. Raises
    InputError: no torque or current in a log; QualityError: no joint slides.
    """
    logs = []
    for log in recordings:
        torque_of(log)  # there, before the motion is worked out
        motion = log_motion(
            log, robot, options.motion, imu=stages.imu, source=options.source
        )
        logs.append((log, motion))
    model, effects = (
        TorqueModel.from_stages(stages, robot),
        fitted_effects(stages, robot),
    )
    bare = Predictor(model, stages, options, effects)
    first = rows = PayloadRows(bare, logs)
    if not rows.samples.any():
        hint = "Record moves of every joint with the load."
        raise QualityError("no joint slides in these logs", hint=hint)
    solution = rows.solved(friction_change)
    phi = solution.theta[:PER_LINK]
    for _ in range(rounds - 1 if effects else 0):
        assert model.phi is not None
        loaded = replace(model, phi=np.vstack([model.phi[:-1], model.phi[-1] + phi]))
        rows = PayloadRows(replace(bare, model=loaded), logs)
        solution = rows.solved(friction_change)
        phi = phi + solution.theta[:PER_LINK]
    left = [
        own.residual_rms(solution.theta) if own.samples else 0.0 for own in rows.joints
    ]
    count = np.maximum(first.samples, 1)
    return PayloadFit(
        phi=phi,
        covariance=_covariance(rows, solution, stages, robot)[:PER_LINK, :PER_LINK],
        determined=solution.determined[:PER_LINK],
        before=np.sqrt(first.before / count),
        after=np.array(left),
        measured=np.sqrt(first.measured / count),
        samples=first.samples,
        friction_change=solution.theta[PER_LINK::FRICTION_TERMS],
    )


class PayloadRows:
    """Rows of logs beyond a model, joint by joint.

    `joints` accumulate [H E_n, friction | left over torque]; `cross` (n, 10 + k, p) are
    their products with H, `scaled` (n, 10 + k) those with torque that a torque constant
    scales; `samples`, `before` and `measured` (n,) are counts of sliding samples, and
    their squares.
    """

    def __init__(
        self, predictor: Predictor, logs: Iterable[tuple[Recording, Motion]]
    ) -> None:
        self.predictor, self.robot = predictor, predictor.model.robot
        self.basis, n = free_basis(self.robot), self.robot.n
        size = PER_LINK + FRICTION_TERMS * n
        self.joints = [Accumulator(size) for _ in range(n)]
        self.cross, self.scaled = (
            np.zeros((n, size, self.basis.size)),
            np.zeros((n, size)),
        )
        self.samples, self.before, self.measured = np.zeros((3, n))
        for recording, motion in logs:
            self._add(recording, motion)

    def _add(self, recording: Recording, motion: Motion) -> None:
        log = self.predictor.part(motion, recording, slice(None))
        friction = motion.filtered(
            sampled_friction(self.predictor.model.surfaces, motion), times=2
        )
        speed = np.abs(motion.dq) / np.maximum(np.abs(motion.dq).max(axis=0), 1e-12)
        tables = log.residual, log.tau, friction, speed
        kept_hz = self.predictor.options.motion.samples_per_cutoff * motion.cutoff.hz
        every = max(1, int(motion.rate_hz / kept_hz))
        for chunk, H in filtered_regressor(motion, self.robot, self.basis):
            for block in blocks(len(H), motion.rate_hz):
                part = slice(chunk.start + block.start, chunk.start + block.stop, every)
                columns = H[block.start : block.stop : every]
                for j, joint in enumerate(self.joints):
                    used, first = log.sliding[part][:, j], PER_LINK + FRICTION_TERMS * j
                    own = columns[used, j]
                    left, tau, held, fast = (table[part][used, j] for table in tables)
                    wide = np.zeros((len(own), joint.size))
                    wide[:, :PER_LINK] = own @ self.basis.last_link
                    wide[:, first], wide[:, first + 1] = held, held * fast
                    joint.add(wide, left)
                    self.cross[j] += wide.T @ own
                    self.scaled[j] += wide.T @ (tau - held)
                    self.before[j] += float(left @ left)
                    self.measured[j] += float(tau @ tau)
                    self.samples[j] += len(left)

    def solved(self, friction_change: float) -> Solution:
        """Solve, friction known to have changed by about that share."""
        known = np.eye(self.scaled.shape[1])[PER_LINK:] / friction_change
        return solve(self.joints, prior=Prior(known, np.zeros(len(known))))


def _covariance(
    rows: PayloadRows, solution: Solution, stages: Stages, robot: Robot
) -> Array:
    """Own errors, those of the model's base parameters, those of the torque constants."""
    found, weights = identified(stages, robot), solution.sigma**-2.0
    gain = -solution.bread @ np.tensordot(weights, rows.cross, 1)[:, list(found.rows)]
    scaled = solution.shares - (weights[:, None] * rows.scaled) @ solution.bread
    through = {j: gain @ move for j, move in enumerate(found.moves) if move.any()}
    moves = constant_moves(
        solution, robot.torque_constant_errors, dict(enumerate(scaled)), through
    )
    inherited = gain @ found.held_covariance @ gain.T
    return solution.covariance + inherited + moves_covariance(moves, len(gain))
