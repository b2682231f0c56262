"""The prediction file, `seqid/prediction@1`: how well a model predicts the torque of some logs."""

from seqid_cli.params.base import Struct
from seqid_cli.params.schema import InputLog, MotionUse, OfRobot, Verdict

PREDICTION_SCHEMA = "seqid/prediction@1"


class FileId(Struct, kw_only=True):
    """One parameter file that the prediction was made with."""

    path: str
    sha256: str


class JointError(Struct, kw_only=True):
    """Error of the predicted torque of one joint, N m.

    `rmse`, `relative_rmse` (to the RMS of the measured torque) and `max_abs` are over the `samples`
    in which the joint slides. `rmse_all` is over all `samples_all` that count: at rest the model
    says an interval, and the error is the distance to it. `share_sliding` is `samples` over
    `samples_all`. Numbers are null where there is nothing to compute them from: a joint that never
    slides has no `rmse` and is not judged.
    """

    rmse: float | None
    relative_rmse: float | None
    max_abs: float | None
    samples: int
    rmse_all: float | None
    samples_all: int
    share_sliding: float | None


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
