"""Standard deviations of predicted torques, calibrated on left-out samples.

The variance of a sample's error is modelled as v = p + s^2. The errors of the
parameters make p (`variance`); noise and the model's own error make s^2. The scores

    z = |r| / sqrt(v)

of left-out residuals r show by which factor the bands must be wider or narrower. This
holds for any distribution of the residuals (conformal prediction: V. Vovk,
A. Gammerman, G. Shafer, "Algorithmic Learning in a Random World", 2005). Neighbouring
samples are not exchangeable, so whole logs or stretches of time are left out.

Errors are larger at some speeds and loads than at others. There are therefore four
cells, slow or fast and lightly or heavily loaded. Each cell has a factor of its own if
such factors predict left-out logs better than a common factor. Factors are compared by
the interval score of T. Gneiting and A. Raftery, "Strictly proper scoring rules",
J. Am. Stat. Assoc. 102, 2007: it rewards narrow bands that hold.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from seqid_cli.distributions import normal_quantile
from seqid_cli.identify.bands.left_out import FEWEST_LOGS, Fit, left_out_residuals
from seqid_cli.identify.bands.rows import BandRows, BandRowsCollector
from seqid_cli.identify.bands.variance import ParameterVariance
from seqid_cli.model.torque import TorqueModel
from seqid_cli.params.bands_schema import BandCalibration, BandCell, JointBand
from seqid_cli.params.schema import Stages
from seqid_cli.robot.types import Robot
from seqid_cli.typing import Array, Index, Mask

LEVELS = (0.5, 0.8, 0.9, 0.95, 0.99)  # of the quantiles in the parameter file
BAND_LEVELS = (0.9, 0.95)  # of the bands for which a factor is calibrated
BLOCK_S = 2.0  # length of a block of time: longer than a residual's memory
CELLS = 4
FEWEST_SAMPLES = 20  # with fewer, a joint has no band
# Share of the squared error that is never put down to errors of the parameters.
LEAST_LEFT = 0.1


@dataclass(frozen=True, kw_only=True)
class Scores:
    """Scores of one joint's left-out errors at K samples.

    Attributes
    ----------
    score : array (K,)
        |residual| over the modelled standard deviation.
    std : array (K,)
        Modelled standard deviation [N m].
    cell : array (K,)
        Number of the cell of speed and load, 0 to 3.
    group, block : array (K,)
        Numbers of the part of the logs and of the block of time.
    """

    score: Array
    std: Array
    cell: Index
    group: Index
    block: Index


def calibrate(
    collected: BandRowsCollector,
    fit: Fit,
    stages: Stages,
    robot: Robot,
    *,
    cutoff_hz: float,
) -> BandCalibration | None:
    """Calibrate the bands of a model on the logs that it was identified from.

    Parameters
    ----------
    collected : BandRowsCollector
        Thinned rows of the stage's equations, with columns for the whole of
        `fit.theta`.
    fit : Fit
        The stage's solution.
    stages : Stages
        The model, with the stage in it, as it will stand in the file.
    robot : Robot
        The robot.
    cutoff_hz : float
        Cut-off of the low-pass on the rows [Hz].

    Returns
    -------
    BandCalibration or None
        Bands of every joint with enough samples; None where no joint has enough.
    """
    rows = collected.joined()
    if rows is None:
        return None

    left_out = left_out_residuals(rows, fit)
    parameter_variance = ParameterVariance.from_stages(stages, robot)
    variance = parameter_variance.of(rows.q, rows.dq, rows.ddq)
    load = load_of(robot, stages, rows.q, rows.dq, rows.ddq)
    block = _blocks(rows)

    # The cells must also suit a motion of another kind. Whole logs decide on them
    # where there are enough logs, because stretches of one log move alike.
    n_logs = rows.log.max() + 1
    group = rows.log if n_logs >= FEWEST_LOGS else left_out.fold

    joints = {}
    for j, name in enumerate(robot.joint_names):
        judged = rows.judged[:, j]
        if np.count_nonzero(judged) < FEWEST_SAMPLES:
            continue
        joints[name] = joint_band(
            residual=left_out.residual[judged, j],
            variance=variance[judged, j],
            speed=np.abs(rows.dq[judged, j]),
            load=load[judged, j],
            group=group[judged],
            block=block[judged],
        )

    if not joints:
        return None
    return BandCalibration(
        levels=list(LEVELS),
        left_out=left_out.kind,
        folds=left_out.folds,
        cutoff_hz=cutoff_hz,
        joints=joints,
    )


def load_of(robot: Robot, stages: Stages, q: Array, dq: Array, ddq: Array) -> Array:
    """Return the size of the model's torque without friction.

    Parameters
    ----------
    robot : Robot
        The robot.
    stages : Stages
        The model.
    q, dq, ddq : array (N, n)
        Joint positions [rad], speeds [rad/s] and accelerations [rad/s^2].

    Returns
    -------
    array (N, n)
        Torque without sign [N m].
    """
    return np.abs(TorqueModel.from_stages(stages, robot).rigid(q, dq, ddq))


def joint_band(
    *,
    residual: Array,
    variance: Array,
    speed: Array,
    load: Array,
    group: Index,
    block: Index,
) -> JointBand:
    """Calibrate one joint on K left-out samples.

    Parameters
    ----------
    residual : array (K,)
        Measured minus predicted torque [N m].
    variance : array (K,)
        Variance of the prediction by the errors of the parameters [(N m)^2].
    speed, load : array (K,)
        Speed [rad/s] and torque without friction [N m], without sign.
    group, block : array (K,)
        Numbers of the part of the logs and of the block of time of a sample. Groups
        differ from each other as much as a new log differs from all of them.

    Returns
    -------
    JointBand
        Standard deviation beside the parameters' errors, edges and factors of cells.
    """
    # Where the parameters seem to explain the whole error, their errors are
    # overstated. A share of the squared error is therefore never theirs.
    mean_square = float(np.mean(residual**2))
    unexplained = mean_square - float(np.mean(variance))
    unexplained = max(unexplained, LEAST_LEFT * mean_square)
    left_std = float(np.sqrt(max(unexplained, 1e-300)))

    std = np.sqrt(variance + left_std**2)
    speed_edge = float(np.median(speed))
    load_edge = float(np.median(load))
    scores = Scores(
        score=np.abs(residual) / std,
        std=std,
        cell=cell_of(speed >= speed_edge, load >= load_edge),
        group=group,
        block=block,
    )

    factors = _factors(scores, _best_share(scores))
    cells = []
    for number in range(CELLS):
        in_cell = scores.cell == number
        # Quantiles of a cell with few samples would say nothing: all samples stand in.
        cell_scores = scores.score
        if np.count_nonzero(in_cell) >= FEWEST_SAMPLES:
            cell_scores = scores.score[in_cell]
        cells.append(
            BandCell(
                fast=bool(number // 2),
                loaded=bool(number % 2),
                factor=float(factors[number]),
                quantiles=_relative_quantiles(cell_scores, LEVELS).tolist(),
                blocks=len(np.unique(block[in_cell])),
            )
        )

    return JointBand(
        left_std=left_std,
        left_out_rmse=float(np.sqrt(mean_square)),
        speed_edge=speed_edge,
        load_edge=load_edge,
        cells=cells,
        blocks=len(np.unique(block)),
    )


def cell_of(fast: Mask, loaded: Mask) -> Index:
    """Return the number of each sample's cell, as `JointBand.cells` are ordered."""
    return np.asarray(2 * fast.astype(np.intp) + loaded.astype(np.intp))


def _relative_quantiles(score: Array, levels: Sequence[float]) -> Array:
    """Return quantiles of scores, relative to those of |x| of a standard normal x."""
    normal_quantiles = [normal_quantile(0.5 + 0.5 * level) for level in levels]
    return np.asarray(np.quantile(score, levels) / normal_quantiles)


def _factor(score: Array) -> float:
    """Return the factor with which bands of both levels come nearest to holding.

    The two levels ask for different factors where tails are heavy. The mean of the two
    is wrong by little for either. Where one level asks for 10 % more, 95 % bands hold
    in 94.3 or 95.9 %, and 90 % bands in 90.6 or 89.0 %.
    """
    return float(np.mean(_relative_quantiles(score, BAND_LEVELS)))


def _factors(scores: Scores, share: float) -> Array:
    """Return a factor for each cell (4,), between the common and the cell's own factor.

    With `share` 0 all factors are the common one, with 1 each is that of its cell.
    """
    common_factor = _factor(scores.score)
    factors = np.full(CELLS, common_factor)
    for number in range(CELLS):
        cell_scores = scores.score[scores.cell == number]
        if len(cell_scores) < FEWEST_SAMPLES:
            continue
        cell_factor = _factor(cell_scores)
        factors[number] = common_factor ** (1.0 - share) * cell_factor**share
    return factors


def _best_share(
    scores: Scores, *, shares: Sequence[float] = (0.0, 0.5), sigmas: float = 2.0
) -> float:
    """Return the share with which factors of the other groups predict a group best.

    Cells count only where the gain over a common factor is more than `sigmas` standard
    errors, taken over the groups. An error that is large in one log alone looks like
    one of speed or load as well. Without this condition, bands of 0.2 standard
    deviations were stated for logs that had errors as large as any.
    """
    groups = np.unique(scores.group)
    n_groups = len(groups)
    losses = np.zeros((n_groups, len(shares)))
    for row, group in enumerate(groups):
        in_group = scores.group == group
        training = _part(scores, ~in_group)
        if len(training.score) < FEWEST_SAMPLES:
            return 0.0

        score = scores.score[in_group]
        std = scores.std[in_group]
        cell = scores.cell[in_group]
        for column, share in enumerate(shares):
            factor = _factors(training, share)[cell]
            losses[row, column] = _interval_score(score, std, factor)

    best = int(np.argmin(losses.sum(axis=0)))
    gain = losses[:, 0] - losses[:, best]
    if n_groups < 2:
        return 0.0
    gain_std_error = float(np.std(gain, ddof=1)) * np.sqrt(n_groups)
    if gain.sum() <= sigmas * gain_std_error:
        return 0.0
    return float(shares[best])


def _interval_score(score: Array, std: Array, factor: Array) -> float:
    """Return the interval score of both bands [N m], summed over the samples.

    A smaller score is better.
    """
    total = 0.0
    for level in BAND_LEVELS:
        half_width = normal_quantile(0.5 + 0.5 * level) * factor
        excess = np.maximum(score - half_width, 0.0)
        penalty = 2.0 / (1.0 - level) * excess
        total += float(np.sum(std * (2.0 * half_width + penalty)))
    return total


def _part(scores: Scores, where: Mask) -> Scores:
    """Return the scores of the marked samples."""
    return Scores(
        score=scores.score[where],
        std=scores.std[where],
        cell=scores.cell[where],
        group=scores.group[where],
        block=scores.block[where],
    )


def _blocks(rows: BandRows) -> Index:
    """Return the number (M,) of each sample's block of time; logs share no block."""
    block_in_log = (rows.t / BLOCK_S).astype(np.intp)
    blocks_per_log = int(block_in_log.max(initial=0)) + 1
    return np.asarray(rows.log * blocks_per_log + block_in_log)
