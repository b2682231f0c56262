"""What a form loses of the file's torque: the RMS of the difference, while a joint slides.

For logs that are replayed it is the loss on these. The loss that is stated for the form
is the one to be expected on other motion of the kind. A handful of logs has few fast
moves, and these decide: another handful may lose a sixth more. Motions that are made
within the identified positions and speeds (`motions`) tell more, but are of another
kind. So both are taken together, as two estimates of the same mean square L^2 are:

    L^2 = (u L_logs^2 + v L_made^2) / (u + v),

u the inverse of the squared relative error of the logs' mean, as far as the logs agree
with each other, v the same of made motion.
"""

from collections.abc import Sequence
from dataclasses import dataclass

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

# Relative error of the mean square that made motion gives for the logs' kind of motion.
MADE_ERROR = 0.5
# Pieces by which the logs' agreement is judged: fewer logs than that are cut.
_FEWEST_PIECES = 4


def written_torque(model: ExportModel, motion: Motion, added: Array) -> Array:
    """Return what a model file's numbers make of a motion (N, n) N m, low-passed.

    `added` (11 n,): standard parameters that are left out.
    """
    robot, n = model.robot, model.robot.n
    phi = model.bodies - added[: PER_LINK * n].reshape(n, PER_LINK)
    armature = model.armature - gear_ratios(robot) ** 2 * added[PER_LINK * n :]
    states = motion.q, motion.dq, motion.ddq
    rigid = (
        inverse_dynamics(robot.chain, robot.gravity, phi, *states)
        + armature * motion.ddq
    )
    laws = [None if fit is None else law_of(fit, model) for fit in model.friction]
    friction = sampled_friction(laws, motion)
    return motion.filtered(rigid) + motion.filtered(friction, times=2)


def law_of(fit: ExportedFriction, model: ExportModel) -> CoulombViscous:
    """Return the friction that a form writes, the offset where it has a place for it."""
    return CoulombViscous(
        fit.coulomb, fit.viscous, fit.offset if model.writes_offset else 0.0
    )


def lost_torque(
    model: ExportModel, samples: Sequence[TorqueSamples], added: Array
) -> Array:
    """Return the RMS (n,) N m of the file's torque minus the form's, while joints slide.

    NaN for a joint that slides in none of the motions.
    """
    squares = np.zeros(model.robot.n)
    counts = np.zeros(model.robot.n)
    for part in samples:
        squares += _lost_squares(model, part, added).sum(axis=0)
        counts += part.sliding.sum(axis=0)
    with np.errstate(invalid="ignore", divide="ignore"):
        return np.sqrt(squares / counts)


def _lost_squares(model: ExportModel, part: TorqueSamples, added: Array) -> Array:
    """Return the squared loss (N, n) (N m)^2, zero where a joint does not slide."""
    by_form = written_torque(model, part.motion, added)
    lost = part.torque + part.left_out - by_form
    return np.where(part.sliding, lost**2, 0.0)


@dataclass(frozen=True, kw_only=True)
class _Pieces:
    """Sums of the squared loss (m, n) (N m)^2 of m pieces of logs, and their samples."""

    squares: Array
    counts: Array


def _piecewise(
    model: ExportModel, samples: Sequence[TorqueSamples], added: Array
) -> _Pieces:
    pieces_of_a_log = -(-_FEWEST_PIECES // max(len(samples), 1))
    squares = []
    counts = []
    for part in samples:
        lost = _lost_squares(model, part, added)
        for rows in np.array_split(np.arange(len(lost)), pieces_of_a_log):
            squares.append(lost[rows].sum(axis=0))
            counts.append(part.sliding[rows].sum(axis=0))
    return _Pieces(squares=np.array(squares), counts=np.array(counts))


def _relative_error(pieces: _Pieces, mean: Array) -> Array:
    """Return the relative error (n,) of the mean square by how pieces differ from it."""
    n_pieces = len(pieces.counts)
    usual_count = pieces.counts.mean(axis=0)
    deviations = (pieces.squares - mean * pieces.counts) / usual_count
    variance = np.sum(deviations**2, axis=0) / max(n_pieces - 1, 1) / n_pieces
    # Where nothing at all is lost, there is no ratio, and nothing to be told apart.
    relative = np.nan_to_num(np.sqrt(variance) / mean)
    return np.asarray(np.maximum(relative, 1e-6))


def stated_loss(
    model: ExportModel,
    samples: Sequence[TorqueSamples],
    made: Sequence[TorqueSamples],
    added: Array,
) -> Array:
    """Return the loss (n,) N m to be expected on motion like that of the logs.

    Parameters
    ----------
    model : ExportModel
        With the numbers that are written.
    samples, made : sequences of TorqueSamples
        The motions of the logs, and made ones, which may be missing.
    added : (11 n,) array
        Standard parameters that are no part of the samples' torque.

    Returns
    -------
    (n,) array
        NaN for a joint that slides nowhere.
    """
    if not made:
        return lost_torque(model, samples, added)
    pieces = _piecewise(model, samples, added)
    by_made = lost_torque(model, made, added) ** 2
    with np.errstate(invalid="ignore", divide="ignore"):
        total = pieces.squares.sum(axis=0)
        by_logs = total / pieces.counts.sum(axis=0)
        logs_weight = 1.0 / _relative_error(pieces, by_logs) ** 2
        made_weight = 1.0 / MADE_ERROR**2
        share = made_weight / (logs_weight + made_weight)
        together = (1.0 - share) * by_logs + share * by_made
    # A joint that slides in one kind of motion alone has the loss of that.
    together = np.where(np.isfinite(by_made), together, by_logs)
    together = np.where(np.isfinite(by_logs), together, by_made)
    return np.sqrt(together)
