"""Errors of predicted torques on left-out logs, as the parameter file holds them."""

from seqid_cli.params.base import Struct


class BandCell(Struct, kw_only=True):
    """Errors of one joint in one cell of speed and load.

    `fast` and `loaded` say which side of the joint's edges the cell is on. `factor` is
    what the standard deviation is multiplied by. `quantiles` are the measured quantiles
    of the error at the calibration's `levels`, each over that of a normal distribution;
    `blocks` is the number of blocks of time that they are from.
    """

    fast: bool
    loaded: bool
    factor: float
    quantiles: list[float] = []
    blocks: int = 0


class JointBand(Struct, kw_only=True):
    """Errors of one joint's predicted torque on samples that were not fitted.

    A prediction's standard deviation is factor * sqrt(p + left_std^2), p its variance
    by the errors of the parameters and `factor` that of the sample's cell. `left_std`
    (N m) is what noise and the model leave besides. A sample is fast from `speed_edge`
    (rad/s) on, and loaded where the torque without friction is above `load_edge` (N m).
    `left_out_rmse` (N m) is the RMS error of the left-out samples, `blocks` the number
    of blocks of time.
    """

    left_std: float
    left_out_rmse: float
    speed_edge: float
    load_edge: float
    cells: list[BandCell]
    blocks: int


class BandCalibration(Struct, kw_only=True):
    """Bands of predicted torques, calibrated where the logs were.

    `left_out` says what was left out at once: whole "logs", or "stretches" of time of
    them, in so many `folds`. `cutoff_hz` is that of the logs.
    """

    levels: list[float]
    left_out: str
    folds: int
    cutoff_hz: float
    joints: dict[str, JointBand]
