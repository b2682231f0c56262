"""Equations of a body at the flange, from logs with it and a model without it.

A body at the flange adds its standard parameters phi (10,) to those of the last link,
so that with H the regressor of the base parameters (Eq. 4) and E their expression in
standard parameters

    tau - tau_model(q, dq, ddq) = H E_n phi + sum_k a_k f_k + e,

E_n the ten columns of E for the last link. Friction may have changed since the model
was identified: f is the joint's own friction and friction in proportion to its speed,
a_k their changes as a share, known to be about zero. Effects of the model that depend
on the load are evaluated with the payload found so far.
"""

from collections.abc import Iterable

import numpy as np

from seqid_cli.identify.prediction.predict import Predictor
from seqid_cli.identify.regression.equations import blocks, filtered_regressor
from seqid_cli.identify.regression.least_squares import (
    Accumulator,
    Prior,
    Solution,
    solve,
)
from seqid_cli.identify.regression.repeats import with_log
from seqid_cli.logs.recording import Recording
from seqid_cli.model.torque import sampled_friction
from seqid_cli.motion.motion import Motion
from seqid_cli.robot.base_parameters import free_basis
from seqid_cli.robot.regressor import PER_LINK
from seqid_cli.typing import Array

# Changes of each joint's friction: as it is, and in proportion to the speed.
FRICTION_TERMS = 2


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
        log_joints = [Accumulator(joint.size) for joint in self.joints]
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
                        log_joints[j],
                        H=H_block[sliding, j],
                        residual=residual[rows][sliding, j],
                        torque=prediction.tau[rows][sliding, j],
                        friction=friction[rows][sliding, j],
                        relative_speed=relative_speed[rows][sliding, j],
                    )
        self.joints = with_log(self.joints, log_joints)

    def _add_joint(
        self,
        j: int,
        equations: Accumulator,
        *,
        H: Array,
        residual: Array,
        torque: Array,
        friction: Array,
        relative_speed: Array,
    ) -> None:
        """Add sliding samples of joint `j` to its `equations`.

        H is (N, b), the others are (N,): N m, and speed over the largest of the log.
        """
        first_change = PER_LINK + FRICTION_TERMS * j
        columns = np.zeros((len(H), equations.size))
        columns[:, :PER_LINK] = H @ self.basis.last_link
        columns[:, first_change] = friction
        columns[:, first_change + 1] = friction * relative_speed
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
