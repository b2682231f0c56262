"""The replay file, `seqid/replay@1`: a simulated robot against its logs."""

from seqid_cli.params.base import Struct
from seqid_cli.params.results.prediction import FileId
from seqid_cli.params.schema import InputLog, OfRobot, Verdict

REPLAY_SCHEMA = "seqid/replay@1"


class WorstWindow(Struct, kw_only=True):
    """The window with the largest RMS error: its log, its begin [s], and the error."""

    log: str
    start: float
    rms: float


class ReplayError(Struct, kw_only=True):
    """RMS error over all windows, and the worst of them; rad, rad/s or N m."""

    rms: float
    worst: WorstWindow


class ReplayTrace(Struct, kw_only=True):
    """Positions of one joint over `t` [s]: what was asked for, and what came of it.

    `measured` is empty where there is no measurement, as in a step response. All are in
    rad (m).
    """

    t: list[float]
    command: list[float]
    replayed: list[float]
    measured: list[float] = []


class ReplayJoint(Struct, kw_only=True):
    """The errors of one joint.

    `position`, `velocity` and `torque` are of the closed loop. The others are of the
    position: `delayed_command` is the command itself at the delay that suits it best,
    `start_plus_change` the first position and the change of that command, and
    `without_drive` the arm driven by the measured torque. Null where there is nothing
    to compare with. `typical_window` shows the window with the median error,
    `worst_window` that with the largest, and `step_response` what a step of the command
    makes of the simulated joint at rest.
    """

    position: ReplayError
    velocity: ReplayError
    torque: ReplayError | None
    delayed_command: ReplayError
    start_plus_change: ReplayError
    without_drive: ReplayError | None
    baseline_delay_s: float
    typical_window: ReplayTrace | None = None
    worst_window: ReplayTrace | None = None
    step_response: ReplayTrace | None = None


class ReplayFile(OfRobot, kw_only=True):
    """The whole document.

    `windows` of `window_s` each were simulated, each from the state that the log has
    there.
    """

    inputs: list[InputLog]
    drive: FileId
    window_s: float
    windows: int
    step_s: float
    joints: dict[str, ReplayJoint]
    verdicts: list[Verdict] = []
    notes: list[str] = []
