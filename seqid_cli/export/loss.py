"""What the numbers of a form lose of the torque of the whole model, on motions."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Self

import numpy as np

from seqid_cli.export.equations import CoulombViscous
from seqid_cli.export.model import ExportModel
from seqid_cli.export.motions import TorqueSamples
from seqid_cli.model.torque import sampled_friction
from seqid_cli.motion.motion import Motion
from seqid_cli.params.results.export import ExportedFriction
from seqid_cli.robot.base_parameters import gear_ratios
from seqid_cli.robot.regressor import PER_LINK, inverse_dynamics
from seqid_cli.typing import Array


def written_torque(model: ExportModel, motion: Motion, added: Array) -> Array:
    """Return what a model file's numbers make of a motion, low-passed.

    Parameters
    ----------
    model : ExportModel
        With the numbers that are written.
    motion : Motion
        N samples.
    added : (11 n,) array
        Standard parameters that are left out.

    Returns
    -------
    (N, n) array
        Torque, N m (N where prismatic).
    """
    robot = model.robot
    rotors = PER_LINK * robot.n
    phi = model.bodies - added[:rotors].reshape(robot.n, PER_LINK)
    armature = model.armature - gear_ratios(robot) ** 2 * added[rotors:]
    links = inverse_dynamics(
        robot.chain, robot.gravity, phi, motion.q, motion.dq, motion.ddq
    )
    rigid = links + armature * motion.ddq

    laws = [None if fit is None else law_of(fit, model) for fit in model.friction]
    friction = sampled_friction(laws, motion)
    return motion.filtered(rigid) + motion.filtered(friction, times=2)


def law_of(fit: ExportedFriction, model: ExportModel) -> CoulombViscous:
    """Return the friction that a form writes, without an offset that has no place."""
    return CoulombViscous(
        coulomb=fit.coulomb,
        viscous=fit.viscous,
        offset=fit.offset if model.writes_offset else 0.0,
    )


@dataclass(frozen=True, kw_only=True)
class LostTorque:
    """Sums of the squared difference between the torques of file and form.

    Attributes
    ----------
    squares : (k, n) array
        Over the sliding samples of each of k motions, (N m)^2.
    counts : (k, n) array
        How many these are.
    """

    squares: Array
    counts: Array

    @classmethod
    def of(
        cls,
        model: ExportModel,
        samples: Sequence[TorqueSamples],
        added: Array,
        *,
        held: float = 1.0,
    ) -> Self:
        """Compare a form with its file.

        Parameters
        ----------
        model : ExportModel
            With the numbers that are written.
        samples : sequence of TorqueSamples
            The motions.
        added : (11 n,) array
            Standard parameters of the bodies that are no part of the samples' torque.
        held : float
            1 where the form has the held effects, 0 where it has not.
        """
        squares = np.zeros((len(samples), model.robot.n))
        counts = np.zeros((len(samples), model.robot.n))
        for k, part in enumerate(samples):
            by_form = written_torque(model, part.motion, added)
            by_form = by_form + (held - 1.0) * part.held
            lost = np.where(part.sliding, part.of_model - by_form, 0.0)
            squares[k] = np.square(lost).sum(axis=0)
            counts[k] = part.sliding.sum(axis=0)
        return cls(squares=squares, counts=counts)

    @property
    def rms(self) -> Array:
        """RMS (n,) N m over all motions, NaN for a joint that slides in none."""
        with np.errstate(invalid="ignore", divide="ignore"):
            mean = self.squares.sum(axis=0) / self.counts.sum(axis=0)
        return np.asarray(np.sqrt(mean))

    @property
    def by_motion(self) -> Array:
        """RMS (k, n) N m, NaN for a joint that does not slide."""
        with np.errstate(invalid="ignore", divide="ignore"):
            mean = self.squares / self.counts
        return np.asarray(np.sqrt(mean))
