"""Standard deviations of predicted torques, calibrated on samples that were left out of the fit.

A sample's variance is modelled as v = p + s^2: p by the errors of the parameters
(`variance`), s^2 what noise and the model leave besides. The scores

    z = |r| / sqrt(v)

of left-out residuals r tell by which factor the bands must be wider or narrower,
whatever their distribution (conformal prediction: V. Vovk, A. Gammerman, G. Shafer,
"Algorithmic Learning in a Random World", 2005). Neighbouring samples are not
exchangeable, so what is left out are whole logs or stretches of time.

Errors are larger at some speeds and loads than at others. Factors are therefore those
of four cells, slow or fast and lightly or heavily loaded, as far as this predicts
left-out logs better than one factor for all. What counts there is the interval score of
T. Gneiting and A. Raftery, "Strictly proper scoring rules", J. Am. Stat. Assoc. 102,
2007: narrow bands that hold.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.stats import norm

from seqid_cli.identify.bands.left_out import FEWEST_LOGS, Fit, left_out_residuals
from seqid_cli.identify.bands.rows import BandRows, BandRowsCollector
from seqid_cli.identify.bands.variance import ParameterVariance
from seqid_cli.model.torque import TorqueModel
from seqid_cli.params.bands_schema import BandCalibration, BandCell, JointBand
from seqid_cli.params.schema import Stages
from seqid_cli.robot.types import Robot
from seqid_cli.typing import Array, Index, Mask

LEVELS = (0.5, 0.8, 0.9, 0.95, 0.99)  # of the quantiles that the file keeps
BAND_LEVELS = (0.9, 0.95)  # that the factor is made for
BLOCK_S = 2.0  # of a block of time: longer than the memory of a residual
CELLS = 4
FEWEST_SAMPLES = 20  # with fewer, a joint has no band
LEAST_LEFT = 0.1  # of the squared error, that is not the parameters'


@dataclass(frozen=True, kw_only=True)
class Scores:
    """Left-out errors of one joint, K samples: scores, and what tells the samples apart.

    `score` (K,) is |residual| over the modelled standard deviation, `std` (K,) N m the
    latter; `cell` (K,) from 0 to 3, `group` and `block` (K,) are numbers.
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
        Low-pass of the rows [Hz].

    Returns
    -------
    BandCalibration or None
        None where no joint has enough samples.
    """
    rows = collected.joined()
    if rows is None:
        return None
    left_out = left_out_residuals(rows, fit)
    variance = ParameterVariance.from_stages(stages, robot).of(
        rows.q, rows.dq, rows.ddq
    )
    load = load_of(robot, stages, rows.q, rows.dq, rows.ddq)
    # Cells must do for a motion of another kind: where there are logs enough, whole
    # ones decide.
    group = rows.log if rows.log.max() + 1 >= FEWEST_LOGS else left_out.fold

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
            block=_blocks(rows)[judged],
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
    """Return the size (N, n) N m of the torque without friction, by the model."""
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
        Its variance by the errors of the parameters [(N m)^2].
    speed, load : array (K,)
        Speed [rad/s] and torque without friction [N m], without sign.
    group, block : array (K,)
        The part of the logs, and the block of time, that a sample is of. Groups are as
        unlike each other as new logs are unlike all of them.
    """
    mean_square = float(np.mean(residual**2))
    # Where parameters seem to explain all of it, their errors are overstated.
    left = max(mean_square - float(np.mean(variance)), LEAST_LEFT * mean_square)
    left_std = float(np.sqrt(max(left, 1e-300)))
    std = np.sqrt(variance + left_std**2)
    speed_edge, load_edge = float(np.median(speed)), float(np.median(load))
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
        own = scores.cell == number
        found = (
            scores.score[own]
            if np.count_nonzero(own) >= FEWEST_SAMPLES
            else scores.score
        )
        cells.append(
            BandCell(
                fast=bool(number // 2),
                loaded=bool(number % 2),
                factor=float(factors[number]),
                quantiles=_relative_quantiles(found, LEVELS).tolist(),
                blocks=len(np.unique(block[own])),
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
    """Return quantiles of scores, over those of the size of a normal variable."""
    return np.asarray(
        np.quantile(score, levels) / norm.ppf(0.5 + 0.5 * np.array(levels))
    )


def _factor(score: Array) -> float:
    """Return the factor with which bands of both levels come nearest to holding.

    Where tails are heavy the two differ. Their mean errs on neither by much: where one
    level asks for 10 % more, 95 % bands hold in 94.3 or 95.9 % and 90 % bands in 90.6
    or 89.0 %.
    """
    return float(np.mean(_relative_quantiles(score, BAND_LEVELS)))


def _factors(scores: Scores, share: float) -> Array:
    """Return the factors (4,) of the cells, moved from the common one by a share of the way."""
    common = _factor(scores.score)
    factors = np.full(CELLS, common)
    for number in range(CELLS):
        own = scores.score[scores.cell == number]
        if len(own) >= FEWEST_SAMPLES:
            factors[number] = common ** (1.0 - share) * _factor(own) ** share
    return factors


def _best_share(
    scores: Scores, *, shares: Sequence[float] = (0.0, 0.5), sigmas: float = 2.0
) -> float:
    """Return the share with which factors of the other groups predict a group best.

    Cells count only where the gain over a common factor is `sigmas` standard errors,
    over the groups. What is large in one log alone looks like a matter of speed or load
    as well, and bands of 0.2 standard deviations were stated for logs that had errors
    as large as any.
    """
    numbers = np.unique(scores.group)
    losses = np.zeros((len(numbers), len(shares)))
    for row, number in enumerate(numbers):
        own = scores.group == number
        others = _part(scores, ~own)
        if len(others.score) < FEWEST_SAMPLES:
            return 0.0
        for k, share in enumerate(shares):
            factor = _factors(others, share)[scores.cell[own]]
            losses[row, k] = _interval_score(scores.score[own], scores.std[own], factor)

    best = int(np.argmin(losses.sum(axis=0)))
    gain = losses[:, 0] - losses[:, best]
    count = len(numbers)
    if count < 2 or gain.sum() <= sigmas * float(np.std(gain, ddof=1)) * np.sqrt(count):
        return 0.0
    return float(shares[best])


def _interval_score(score: Array, std: Array, factor: Array) -> float:
    """Return the interval score of both bands [N m], summed over samples: small is good."""
    total = 0.0
    for level in BAND_LEVELS:
        half_width = float(norm.ppf(0.5 + 0.5 * level)) * factor
        beyond = np.maximum(score - half_width, 0.0)
        total += float(np.sum(std * (2.0 * half_width + 2.0 / (1.0 - level) * beyond)))
    return total


def _part(scores: Scores, where: Mask) -> Scores:
    """Return some of the samples."""
    return Scores(**{name: values[where] for name, values in vars(scores).items()})


def _blocks(rows: BandRows) -> Index:
    """Return the number (M,) of each sample's block of time; logs share none."""
    within = (rows.t / BLOCK_S).astype(np.intp)
    return np.asarray(rows.log * (int(within.max(initial=0)) + 1) + within)
