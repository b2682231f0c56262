"""Rows of the payload equation: torque that the model without the payload leaves.

A body at the flange adds its standard parameters phi (10,) to those of the last link, so that with
H the regressor of the base parameters (Eq. 4) and E their expression in standard parameters

    tau - tau_model(q, dq, ddq) = H E_n phi + sum_k a_k f_k + e,

E_n the ten columns of E for the last link. Friction may have changed since the model was
identified: f is the joint's own friction and friction in proportion to its speed, a_k their changes
as a share, known to be about zero. Effects of the model that depend on the load are evaluated with
the payload found so far.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace

import numpy as np

from seqid_cli.identify.options import InertiaOptions
from seqid_cli.identify.prediction.predict import LogPrediction, predicted, slides_from
from seqid_cli.identify.regression.equations import blocks, filtered_regressor
from seqid_cli.identify.regression.least_squares import Accumulator
from seqid_cli.logs.recording import Recording
from seqid_cli.model.effects.fitted import Fitted, fitted_effects
from seqid_cli.model.torque import TorqueModel, sampled_friction
from seqid_cli.motion.motion import Motion
from seqid_cli.params.schema import Stages
from seqid_cli.robot.base_parameters import Basis, free_basis
from seqid_cli.robot.regressor import PER_LINK
from seqid_cli.robot.types import Robot
from seqid_cli.typing import Array

FRICTION_TERMS = 2  # changes of each joint's friction: as it is, and in proportion to the speed


@dataclass(frozen=True)
class LoadedModel:
    """The model of a parameter file, with a body added to the last link."""

    model: TorqueModel
    effects: tuple[Fitted, ...]
    options: InertiaOptions
    basis: Basis

    @classmethod
    def of(cls, stages: Stages, robot: Robot, options: InertiaOptions) -> LoadedModel:
        """Take a file's stages, a rigid body among them."""
        model = TorqueModel.from_stages(stages, robot)
        return cls(model, tuple(fitted_effects(stages, robot)), options, free_basis(robot))

    def with_body(self, phi: Array) -> LoadedModel:
        """Add a body to the last link."""
        assert self.model.phi is not None
        links = self.model.phi.copy()
        links[-1] += phi
        return replace(self, model=replace(self.model, phi=links))

    def predicted(self, recording: Recording, motion: Motion) -> LogPrediction:
        """Predict a log."""
        slowest = slides_from(self.model, self.options)
        return predicted(self.model, self.effects, slowest, motion, recording, slice(None))


@dataclass(frozen=True)
class PayloadRows:
    """Rows of any number of logs with the model that they are beyond, joint by joint.

    `joints` accumulate [H E_n, friction | left over torque]; `cross` (n, 10 + k, p) are their
    products with H, `scaled` (n, 10 + k) those with torque that a torque constant scales;
    `samples`, `before` and `measured` (n,) are counts of sliding samples, and their squares.
    """

    joints: list[Accumulator]
    cross: Array
    scaled: Array
    samples: Array
    before: Array
    measured: Array

    @classmethod
    def of(cls, loaded: LoadedModel, logs: Iterable[tuple[Recording, Motion]]) -> PayloadRows:
        """Gather logs with their motions."""
        n, p = loaded.model.robot.n, loaded.basis.size
        size = PER_LINK + FRICTION_TERMS * n
        sums = (np.zeros((n, size, p)), np.zeros((n, size)), *np.zeros((3, n)))
        found = cls([Accumulator(size) for _ in range(n)], *sums)
        for recording, motion in logs:
            found.add(loaded, recording, motion)
        return found

    def add(self, loaded: LoadedModel, recording: Recording, motion: Motion) -> None:
        """Add one log with its motion."""
        log, options = loaded.predicted(recording, motion), loaded.options.motion
        friction = motion.filtered(sampled_friction(loaded.model.surfaces, motion), times=2)
        every = max(1, int(motion.rate_hz / (options.samples_per_cutoff * motion.cutoff.hz)))
        for part, H in _regressors(loaded, motion, every):
            speed = np.abs(motion.dq[part]) / np.maximum(np.abs(motion.dq).max(axis=0), 1e-12)
            for j, joint in enumerate(self.joints):
                slides, first = log.sliding[part][:, j], PER_LINK + FRICTION_TERMS * j
                own, left, tau = (x[slides, j] for x in (H, log.residual[part], log.tau[part]))
                held = friction[part][slides, j]
                wide = np.zeros((len(own), self.scaled.shape[1]))
                wide[:, :PER_LINK] = own @ loaded.basis.last_link
                wide[:, first], wide[:, first + 1] = held, held * speed[slides, j]
                joint.add(wide, left)
                self.cross[j] += wide.T @ own
                self.scaled[j] += wide.T @ (tau - held)
                self.before[j] += float(left @ left)
                self.measured[j] += float(tau @ tau)
                self.samples[j] += len(left)


def _regressors(loaded: LoadedModel, motion: Motion, every: int) -> Iterator[tuple[slice, Array]]:
    """H of every k-th sample, in blocks of about a second."""
    for chunk, H in filtered_regressor(motion, loaded.model.robot, loaded.basis):
        for block in blocks(len(H), motion.rate_hz):
            where = slice(chunk.start + block.start, chunk.start + block.stop, every)
            yield where, H[block.start : block.stop : every]
