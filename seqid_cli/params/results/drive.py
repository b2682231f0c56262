"""The drive file, `seqid/drive@1`: the controller of each joint, and the model."""

from seqid_cli.params.base import Struct
from seqid_cli.params.results.prediction import FileId
from seqid_cli.params.schema import (
    InputLog,
    OfRobot,
    Stages,
    UsedSettings,
    Verdict,
)

DRIVE_SCHEMA = "seqid/drive@1"


class DriveParameter(Struct, kw_only=True):
    """One number of a controller.

    `state` is "identified"; "absent" where the logs show that the part is not there, to
    within the standard error; "not_shown" where they cannot tell, and the `reason` says
    what to record; "not_reached" for a limit of which `low` is the least that it can
    be. `value` is null where nothing is known; a value that is not shown is a guess
    that goes with the others.
    """

    name: str
    value: float | None
    std_error: float | None
    unit: str
    state: str
    low: float | None = None
    high: float | None = None
    reason: str = ""


class JointDrive(Struct, kw_only=True):
    """The controller of one joint.

    `command` is how commands run between two stamps: held or interpolated;
    `command_known` whether the logs tell it. `left` is the share of the torque's RMS
    that the controller leaves, `rmse` the same in N m, `samples` those that were
    fitted, `offset` a constant torque [N m] beside the law, the mean of all logs.
    Simulated in `windows` of the logs, positions of those that were held out were off
    by `window_rms` [rad]; the first position and the change of the delayed command by
    `window_guess`. Windows tell as well what the model of the arm lacks: `armature`,
    `coulomb` and `viscous` friction (or `friction_factor` of the model's), `stribeck`
    and `stribeck_speed`, `load_friction`, and the `dead_band` of the controller.
    """

    parameters: list[DriveParameter]
    command: str
    command_known: bool
    left: float | None
    rmse: float | None
    samples: int
    offset: float = 0.0
    windows: int = 0
    window_rms: float | None = None
    window_guess: float | None = None

    def value(self, name: str) -> float:
        """Return a parameter's value, 0 where there is none."""
        for parameter in self.parameters:
            if parameter.name == name:
                return parameter.value or 0.0
        return 0.0

    def known(self, name: str) -> float | None:
        """Return a parameter's value where it was identified."""
        for parameter in self.parameters:
            if parameter.name == name and parameter.state == "identified":
                return parameter.value
        return None


class DriveFile(OfRobot, kw_only=True):
    """The whole document.

    `method` is "torque" where a measured torque was explained, "motion" where the
    model's torque stands for it. `command_delay` is that of all joints together, null
    where they differ. `stages` is the model of the arm that came in, so that the file
    alone simulates the robot. Joints without a controller that could be fitted have a
    verdict only.
    """

    inputs: list[InputLog]
    models: list[FileId]
    method: str
    command_delay: DriveParameter | None
    joints: dict[str, JointDrive]
    stages: Stages
    cutoff_hz: float | None = None
    verdicts: list[Verdict] = []
    notes: list[str] = []
    effective_settings: UsedSettings | None = None
