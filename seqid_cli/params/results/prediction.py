"""The prediction file, `seqid/prediction@1`: errors of predicted torques on logs."""

from seqid_cli.params.base import Struct
from seqid_cli.params.schema import InputLog, MotionUse, OfRobot, UsedSettings, Verdict

PREDICTION_SCHEMA = "seqid/prediction@1"


class FileId(Struct, kw_only=True):
    """One parameter file that the prediction was made with."""

    path: str
    sha256: str


class BandCoverage(Struct, kw_only=True):
    """Coverage of a joint's bands: shares of samples in the 90 and the 95 % band.

    The bands are 1.645 and 1.96 standard deviations to either side. `blocks` are blocks
    of 2 s of time, about as many independent tests.
    """

    band_90: float | None
    band_95: float | None
    samples: int
    blocks: int


class JointCoverage(Struct, kw_only=True):
    """Coverage of a joint's bands where it slides: over all, by speed and by load.

    What is slow and what a low load is the parameter file says
    (`stages.inertia.bands`); without a calibration there it is null.
    """

    overall: BandCoverage
    slow: BandCoverage | None = None
    fast: BandCoverage | None = None
    low_load: BandCoverage | None = None
    high_load: BandCoverage | None = None


class JointError(Struct, kw_only=True):
    """Error of the predicted torque of one joint, N m.

    `rmse`, `relative_rmse` (to the RMS of the measured torque) and `max_abs` are over
    the `samples` in which the joint slides. `rmse_all` is over all `samples_all` that
    count: at rest the model says an interval, and the error is the distance to it.
    `share_sliding` is `samples` over `samples_all`. Numbers are null where there is
    nothing to compute them from: a joint that never slides has no `rmse` and is not
    judged.

    The parts of both: `rmse_inside` and `rmse_outside` are of sliding samples within
    and beyond the positions and speeds at which friction was identified,
    `share_outside` is the share of the latter, and `rmse_rest` is over the samples that
    do not slide. With the parts' shares the squares add up. `std` is the RMS standard
    deviation that the model states of its prediction where the joint slides,
    `parameter_std` the part of it that errors of parameters and effects make,
    `coverage` how often its bands held.
    """

    rmse: float | None
    relative_rmse: float | None
    max_abs: float | None
    samples: int
    rmse_all: float | None
    samples_all: int
    share_sliding: float | None
    rmse_inside: float | None = None
    rmse_outside: float | None = None
    share_outside: float | None = None
    rmse_rest: float | None = None
    std: float | None = None
    parameter_std: float | None = None
    coverage: JointCoverage | None = None


class LogPredictionError(Struct, kw_only=True):
    """The errors on one log."""

    path: str
    sha256: str
    samples: int
    cutoff_hz: float
    joints: dict[str, JointError]
    notes: list[str] = []
    motion: MotionUse | None = None


class PredictionFile(OfRobot, kw_only=True):
    """The whole document; `joints` is over all logs together."""

    inputs: list[InputLog]
    parameters: list[FileId]
    stages: list[str]  # names of the stages that took part
    joints: dict[str, JointError]
    logs: list[LogPredictionError]
    cutoff_origin: str = ""  # where the cut-off of the logs came from
    verdicts: list[Verdict] = []
    notes: list[str] = []
    settings: UsedSettings | None = None
