"""The inspection document, `seqid/inspection@1`: the content and faults of logs."""

from typing import Literal

from seqid_cli.params.base import FrozenStruct, Struct
from seqid_cli.params.schema import UsedSettings, Written

INSPECTION_SCHEMA = "seqid/inspection@1"
InspectionVerdict = Literal["good", "usable", "faulty", "unreadable"]


class InspectedCommand(Struct, kw_only=True):
    """What a joint was asked for; the lag is of the whole loop.

    `form` is sent (with stamps of its own), held (slower than the rows) or sampled;
    `mode` the quantity that the joint follows: position, velocity, torque or empty.
    `saturated` is the share of samples at a limit of the torque.
    """

    quantities: list[str]
    form: str
    mode: str
    lag_s: float | None
    lag_std_s: float | None
    saturated: float | None


class InspectedJoint(Struct, kw_only=True):
    """One joint in a log: rad (m), rad/s (m/s), degC; `effort` is torque or current."""

    name: str
    moves: bool
    low: float
    high: float
    top_speed: float
    encoder_step: float | None
    effort: str
    effort_rms: float | None
    temperature: list[float] | None
    command: InspectedCommand | None = None


class InspectedImu(Struct, kw_only=True):
    """One IMU in a log; `rest_norm` in m/s^2, `delay_s` behind the encoders."""

    name: str
    accelerometers: int
    gyro: bool
    rate_hz: float
    rest_norm: float | None
    delay_s: float | None


class InspectedMoves(Struct, kw_only=True):
    """Intervals of constant velocity of one joint; speeds in rad/s (m/s)."""

    joint: str
    forward: int
    backward: int
    slowest: float
    fastest: float
    postures: int


class InspectionFinding(FrozenStruct, kw_only=True, frozen=True):
    """One fault, or something worth knowing, and the remedy.

    `log` is empty for a fault of the robot file or of all logs; `joint` (or IMU, or two
    joints) and `channel` are named where the fault is of one.
    """

    code: str
    severity: str
    log: str
    joint: str
    channel: str
    message: str
    remedy: str


class InspectedLog(Struct, kw_only=True):
    """One log, and what it shows.

    `missing` maps names of the robot file that the log lacks to the nearest name in it.

    `recorded` are its first and last stamp, as in `InputLog`.
    """

    path: str
    sha256: str
    format: str
    verdict: str
    samples: int = 0
    seconds: float = 0.0
    recorded: list[str | float] = []
    rate_hz: float = 0.0
    jitter: float = 0.0
    gaps: list[list[float]] = []
    non_monotonic: int = 0
    duplicates: int = 0
    log_minus_header_s: float | None = None
    channels: list[str] = []
    missing: dict[str, str] = {}
    joints: list[InspectedJoint] = []
    imus: list[InspectedImu] = []
    moves: list[InspectedMoves] = []
    moving_together: list[str] = []
    serves: list[str] = []
    partial: str = ""


class PlannedPart(Struct, kw_only=True):
    """One move of a plan, and how much of it the logs hold.

    `status` is recorded, missing or spoiled (with the `reason`); `start` is the time in
    `log` at which it begins, `share` how much of it is there.
    """

    move: str
    stage: str
    status: str
    reason: str = ""
    log: str = ""
    start: float | None = None
    share: float = 0.0


class InspectionFile(Written, kw_only=True):
    """The whole document."""

    robot: str
    verdict: str
    logs: list[InspectedLog]
    findings: list[InspectionFinding]
    advice: list[str]
    planned: list[PlannedPart] = []
    settings: UsedSettings | None = None
