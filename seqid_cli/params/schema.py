"""The parameter file, `seqid/params@1`, as typed data.

Keys of the contract keep their names; what stands beside them is what the next command
needs. Every number is finite: what the logs do not determine is listed by name, never
written as a value.
"""

from typing import Literal

from seqid_cli.params.bands_schema import BandCalibration
from seqid_cli.params.base import Document, Struct
from seqid_cli.params.evidence_schema import RefinementRound, RivalEntry
from seqid_cli.units import unit_of

SCHEMA = "seqid/params@1"

Matrix = list[list[float]]

# Standard error from which on no sample shows a parameter. Fits compute with it; files
# say null.
UNDETERMINED_STD_ERROR = 1e29


class Tool(Struct, kw_only=True):
    """The program that wrote a file."""

    name: str = "seqid"
    version: str


class Written(Document, kw_only=True):
    """Base of the documents: their schema, their date and the program."""

    schema: str
    created: str
    tool: Tool


class RobotId(Struct, kw_only=True):
    """The robot that a file is about; `prismatic` names its joints that slide."""

    name: str
    joints: list[str]
    sha256: str
    prismatic: list[str] = []

    def unit(self, unit: str, *joints: str) -> str:
        """Return a unit for some joints, given as for revolute ones: "N m or N".

        It is both where some of them turn and others slide.
        """
        units = [unit_of(unit, name in self.prismatic) for name in joints]
        return " or ".join(dict.fromkeys(units))


class OfRobot(Written, kw_only=True):
    """Base of the documents about one robot."""

    robot: RobotId


class InputLog(Struct, kw_only=True):
    """One log that a stage read.

    `recorded` are its first and last stamp: dates in UTC where the stamps are dates,
    else seconds of the log's own clock. Files of before it was known have none. `part`
    are the options `--from`, `--to` and `--exclude` of the part that was used; none
    where all of it was.
    """

    path: str
    sha256: str
    samples: int
    stage: str = ""
    recorded: list[str | float] = []
    part: list[str] = []


class UsedSettings(Struct, kw_only=True):
    """Settings that a result was made with: all, and those that are no defaults."""

    changed: dict[str, float]
    values: dict[str, float]


class Recipe(Struct, kw_only=True):
    """How a stage was asked to be identified, for `refine` to do it alike again.

    `position_order`, `velocity_order` and `beta` are friction's, null where they were
    not given. `source` is where joint motion was to come from, `consistent` whether
    only parameters that bodies can have were allowed. `reads_delays` stands in files
    of earlier programs, and nothing is made of it.
    """

    position_order: int | None = None
    velocity_order: int | None = None
    beta: float | None = None
    source: str = "auto"
    consistent: bool = False
    reads_delays: bool = True


Level = Literal["good", "usable", "poor"]
LEVELS: tuple[Level, ...] = ("good", "usable", "poor")  # the best first


class Verdict(Struct, kw_only=True):
    """A verdict on a joint's result, or on a whole stage's where `joint` is empty.

    `reason` says why it is not good.

    `good`: what is left of the torque is noise, and the stated standard errors hold.
    `usable`: the torque is predicted to the share that the reason gives, but more than
    noise is left, and the standard errors are widened by it. `poor`: not to be used.
    """

    joint: str = ""
    good: bool
    level: Level = "poor"
    reason: str = ""

    def __post_init__(self) -> None:
        """Set `level` by `good`, which earlier files have alone."""
        if self.good:
            self.level = "good"


class Parameter(Struct, kw_only=True):
    """One identified parameter.

    `terms` is the expression as factors of standard link parameters, `expression` the
    same to read. `std_error` is null where the logs do not determine the value.
    """

    name: str
    value: float
    std_error: float | None
    unit: str
    joint: str = ""
    expression: str = ""
    terms: dict[str, float] = {}

    def __post_init__(self) -> None:
        """Take an error that nothing determines for none: earlier files state it."""
        if self.std_error is not None and self.std_error >= UNDETERMINED_STD_ERROR:
            self.std_error = None

    @property
    def uncertainty(self) -> float:
        """Return the standard error to compute with, huge where there is none."""
        return UNDETERMINED_STD_ERROR if self.std_error is None else self.std_error


class SpeedLevel(Struct, kw_only=True):
    """Constant-velocity data of one joint at one speed (rad/s).

    `friction` is its RMS there, `std_error` that of the surface, `rmse` and `left_out`
    its error with this speed and without, N m, of averages over a quarter of a trial.
    The slowest and the fastest speed are never left out. `points` are these averages,
    a row each: position (rad), direction (1 or -1), measured friction less that of the
    surface and its standard error (N m), both in the direction of the motion.
    """

    speed: float
    forward: int
    backward: int
    rmse: float
    friction: float = 0.0
    std_error: float = 0.0
    left_out: float | None = None
    points: Matrix = []


class Nuisance(Struct, kw_only=True):
    """A term that a joint's drive adds to its torque whatever the arm.

    A positive `delay` (s): torque is logged late against the positions. `offset`:
    torque that is always there. `asymmetry`: the share of dry friction that is added
    forward and taken off backward; `viscous_asymmetry`: the same of what friction has
    more at higher speeds. `thermal` (1/K): the share by which friction changes per
    kelvin of the joint's logged temperature. Where the logs do not show one its value
    is near zero and its standard error that of the prior.
    """

    name: str
    joint: str
    value: float
    std_error: float
    unit: str


class GravityOfTrial(Struct, kw_only=True):
    """p_xi of one locked configuration (kg m, Eq. 12-14), which takes gravity off."""

    configuration: list[float]
    p_xi: list[float]
    std_error: list[float]


class FrictionJoint(Struct, kw_only=True):
    """The friction surface of one joint (Eq. 7-10).

    tau_f = s(v) sum_jr d[j][r] T_j(x) T_r(u): T Chebyshev polynomials, x the position
    scaled from `position_range` and u the speed |v| scaled from `speed_range` to [-1,
    1]; s(v) = tanh(v / sign_width). With the `position_basis` "fourier" 1, cos q, sin
    q, cos 2q, ... stand for T_j(x), two to an order: 2 position_order + 1 rows.
    `negative` differs from `positive` where friction depends on direction. Beyond the
    fastest speed friction goes on as Coulomb and viscous friction, below the slowest it
    holds; beyond the positions it fades to its mean over them.

    Errors are of averages of the data over a quarter of a trial. `rmse` and `max_error`
    (Eq. 11) are those of the surface. `held_out_rmse`, `max_abs_error` (N m) and
    `max_error_left_out` (of the friction) are those of surfaces without the speed, and
    of the surface itself at the slowest and the fastest. `max_error_beyond_noise` is
    `max_error` after two standard errors of each average were taken off,
    `max_error_of_noise` what noise alone, white and of trials, makes of it.

    `nuisances` are the terms of the drive that the surface was identified with; offset
    and asymmetries are in `positive`, `negative` and `covariance`, and
    `nuisance_covariance` is theirs. All entries of the surface move by `term_moves` per
    unit by which the delay, or the thermal term, is another.

    `torque_constant_error` is the relative error that the torque constant adds to every
    torque: all entries move together. `covariance` is without it, the standard errors
    of `speeds` are with it. `law_error` is by how much friction waves about the law of
    a simultaneous fit over the positions, RMS: what the law itself errs, which no
    covariance of its coefficients says.
    """

    position_order: int
    velocity_order: int
    max_error: float
    rmse: float
    position_range: list[float]
    # or "fourier", for joints that turn more than once
    position_basis: str = "chebyshev"
    speed_range: list[float]
    # what u is scaled from: |v| ("linear") or its logarithm ("log")
    speed_scale: str = "linear"
    sign_width: float
    directional: bool
    positive: Matrix
    negative: Matrix
    covariance: Matrix  # of [positive, negative] (or of positive alone), row-major
    torque_constant_error: float = 0.0
    law_error: float = 0.0
    held_out_rmse: float | None = None
    max_abs_error: float | None = None
    max_error_beyond_noise: float | None = None
    max_error_of_noise: float | None = None
    max_error_left_out: float | None = None
    beta: float | None = None
    criterion_met: bool | None = None
    asymmetry: float | None = None  # share of friction that depends on direction
    temperature: float | None = None  # degC, mean over the trials, where it was logged
    gravity: list[GravityOfTrial] = []
    nuisances: list[Nuisance] = []
    nuisance_covariance: Matrix = []  # of offset and asymmetry
    # by the term's name, of the entries of `covariance`
    term_moves: dict[str, list[float]] = {}
    speeds: list[SpeedLevel] = []
    parameters: list[Parameter] = []  # Coulomb, viscous, offset of a simultaneous fit
    unit: str = "N m"


class FrictionStage(Struct, kw_only=True):
    """Friction of the joints (Sec. 2.2.1-2.2.2)."""

    joints: dict[str, FrictionJoint]
    method: str = "surface"
    cutoff_hz: float | None = None
    verdicts: list[Verdict] = []
    notes: list[str] = []
    settings: UsedSettings | None = None
    recipe: Recipe | None = None


class MotionUse(Struct, kw_only=True):
    """The source of a log's motion: "encoder", "imu" (Eq. 30-42) or "fused".

    Errors are standard deviations of the acceleration, rad/s^2 (m/s^2 where prismatic),
    of the joints that move: of what was used, and of what the encoders alone would have
    given at the cut-off that suits them. `fused_error` is that of fused motion below
    this cut-off, where there were IMUs to ask: `--motion auto` takes the source with
    the smaller one. `disagreement` is the part of both by which links do not follow
    their encoders, joints that bend. `velocity_error`, rad/s (m/s), is there where
    velocities are the IMUs' (Eq. 31, 41). `imus` took part; `warnings` say which did
    not, and why.
    """

    log: str
    source: str
    imus: list[str] = []
    cutoff_hz: float
    acceleration_error: dict[str, float] = {}
    encoder_error: dict[str, float] = {}
    fused_error: dict[str, float] = {}
    disagreement: dict[str, float] = {}
    velocity_error: dict[str, float] = {}
    warnings: list[str] = []


class RigidStage(Struct, kw_only=True):
    """Base parameters of gravity (Sec. 2.2.3) or inertia (Sec. 2.2.4).

    `representative` are standard parameters (most of them zero) that give the torque of
    this stage's model; for inertia, of the whole rigid body, gravity included. They are
    not physical by themselves. `encoder_std_errors` are what the parameters' standard
    errors would be, had the same logs been used with encoders alone (empty: they were,
    or it was not asked). `friction_sensitivity` holds, by joint, the change of every
    parameter (a row) per change of every entry of that joint's friction `covariance` (a
    column), through gravity as well: with the covariances it gives that of everything
    identified with everything. `torque_constant_moves` holds, by joint, what one
    standard error of its torque constant moves every parameter by, through gravity as
    well. `tolerance_moves` hold the same for what no log shows and the robot file gives
    a tolerance of. `covariance` is without these moves, the standard errors with them.
    `noise_density` (N m/sqrt(Hz)) is the white noise that would make the parameters'
    own errors. `noise_floor` (N m) is what noise alone would leave beside the `rmse` of
    the fit, and `noise_floor_high` the upper end of its 95 % interval. `bands` say how
    far predicted torques were off on left-out parts of the logs. `nuisances` are
    delays, offsets and asymmetries as this stage found them beside its parameters;
    `nuisance_covariance` is the joint covariance of the parameters and then of all of
    them.
    """

    parameters: list[Parameter]
    condition: float
    rank: int
    structural_rank: int = 0
    representative: dict[str, float] = {}
    covariance: Matrix = []
    friction_sensitivity: dict[str, Matrix] = {}
    torque_constant_moves: dict[str, list[float]] = {}
    tolerance_moves: dict[str, list[float]] = {}
    nuisances: list[Nuisance] = []
    nuisance_covariance: Matrix = []
    not_excited: list[str] = []
    rmse: dict[str, float] = {}
    noise_density: dict[str, float] = {}
    noise_floor: dict[str, float] = {}
    noise_floor_high: dict[str, float] = {}
    method: str = "sequential"
    rotor_coupling: str = "diagonal"
    motion: dict[str, str] = {}
    motion_use: list[MotionUse] = []
    encoder_std_errors: dict[str, float] = {}
    missing_pairs: list[list[str]] = []
    cutoff_hz: float | None = None
    bands: BandCalibration | None = None
    verdicts: list[Verdict] = []
    notes: list[str] = []
    settings: UsedSettings | None = None
    recipe: Recipe | None = None


class AxisReference(Struct, kw_only=True):
    """Rotation of a joint as an IMU sees it, joints before it locked (Eq. 29-31)."""

    axis: list[float]
    acceleration: float  # rad/s^2 of the joint
    angular_acceleration: list[float]  # rad/s^2 of the IMU
    velocity: float  # rad/s of the joint
    angular_velocity: list[float]  # rad/s of the IMU
    gain: float  # joint acceleration per angular acceleration along the axis
    gain_std_error: float


class JointDeflection(Struct, kw_only=True):
    """Acceleration of a link before an IMU beyond what its joint's encoder shows."""

    joint: str
    acceleration: float  # rad/s^2 (m/s^2), RMS below the stage's cut-off
    significance: float  # standard deviations beyond what the readings' jolts explain


class ImuClock(Struct, kw_only=True):
    """The clock of an IMU against the encoders' in one log."""

    log: str
    # the IMU's stamp minus the encoder's of the same instant, as the log begins
    time_offset_s: float
    time_offset_std_error_s: float
    time_rate: float  # s/s, by which the IMU's clock gains on the encoders'
    time_rate_std_error: float


class ImuCalibration(Struct, kw_only=True):
    """Calibration of an IMU (Eq. 29-38).

    `rotation` turns IMU coordinates into those of the link that carries it.

    Accelerometer k at r_k of the robot file, on a link with the specific force f at its
    origin, angular velocity w and acceleration dw, all in the link's frame, reads

        y_k = scale_k axis_k' R' [f + dw x p + w x (w x p)] + bias_k,

    R the rotation, p = lever + R r_k; a gyro reads gyro_scale_k gyro_axis_k' R' w +
    gyro_bias_k. What was felt t seconds of the encoders' clock after the log began has
    the stamp t + time_offset_s + time_rate t, a gyro's gyro_delay_s more. `clocks` has
    both of every log. `time_offset_s` and `time_rate` are those that one more log is
    expected to have, with the scatter from log to log in their errors. An empty list
    was not calibrated; an entry that the logs do not determine is null, and
    `not_determined` says so in words. Axes are units in the IMU's frame.
    """

    rotation: Matrix
    std_error_deg: float
    std_errors_deg: list[float] = []  # about the link's x, y, z
    configurations: int = 0
    condition: float = 0.0
    references: dict[str, AxisReference] = {}
    not_determined: list[str] = []
    axis_rmse_deg: float | None = None
    noise_density: float | None = None  # rad/s^2/sqrt(Hz), of the angular acceleration
    # the IMU's stamp minus the encoder's of the same instant, as a log begins
    time_offset_s: float = 0.0
    # null: not determined, the offset is taken as 0
    time_offset_std_error_s: float | None = None
    time_rate: float = 0.0  # s/s, by which the IMU's clock gains on the encoders'
    time_rate_std_error: float | None = None  # null: not determined
    clocks: list[ImuClock] = []  # of every log
    # the gyro's stamp minus the accelerometers' of the same instant
    gyro_delay_s: float = 0.0
    gyro_delay_std_error_s: float | None = None  # null without a gyro
    # relative, of the last joint's own acceleration
    acceleration_std_error: float | None = None
    lever: list[float | None] = []  # m, the IMU's origin in the link's frame
    lever_std_errors: list[float | None] = []
    accelerometer_bias: list[float | None] = []  # m/s^2
    accelerometer_bias_std_errors: list[float | None] = []
    accelerometer_scale: list[float | None] = []  # reading per true m/s^2
    accelerometer_scale_std_errors: list[float | None] = []
    accelerometer_axes: Matrix = []  # of the robot file where `tilt` says null
    accelerometer_tilt_std_errors_deg: list[float | None] = []
    # m/s^2/sqrt(Hz), one-sided: per sample x sqrt(rate / 2)
    accelerometer_noise: list[float] = []
    gyro_bias: list[float | None] = []  # rad/s
    gyro_bias_std_errors: list[float | None] = []
    gyro_scale: list[float | None] = []
    gyro_scale_std_errors: list[float | None] = []
    gyro_axes: Matrix = []
    gyro_tilt_std_errors_deg: list[float | None] = []
    gyro_noise: list[float] = []  # rad/s/sqrt(Hz), one-sided
    samples: int = 0  # readings that the fit used
    outliers: int = 0  # readings that were left out
    holdout: float | None = None  # RMS of a left-out trial's residual over the noise
    deflections: list[JointDeflection] = []  # one per joint before the IMU


class ImuStage(Struct, kw_only=True):
    """Calibrations of the IMUs (Sec. 3)."""

    imus: dict[str, ImuCalibration]
    cutoff_hz: float | None = None
    verdicts: list[Verdict] = []
    notes: list[str] = []
    settings: UsedSettings | None = None


class EffectSession(Struct, kw_only=True):
    """Logs that an effect was identified from which depends on time or on the log.

    `logs` are hashes in the order in which the effect counts them. `starts` [s] count
    from `origin`, the earliest start on the logs' own clock; both are missing if they
    share no clock.
    """

    logs: list[str]
    starts: list[float] = []
    origin: float | None = None


class EffectOfJoint(Struct, kw_only=True):
    """A physical effect that was added to the model.

    Its torque is linear in `coefficients`, with their `covariance`, once the `settings`
    are fixed; `parameters` are the same in physical terms. One that is `late` came
    after friction, gravity and inertia were identified: their logs do not have it.
    """

    effect: str
    joint: str | None = None
    parameters: list[Parameter] = []
    settings: dict[str, str | float | int | bool] = {}
    coefficients: list[float] = []
    covariance: Matrix = []
    session: EffectSession | None = None
    late: bool = False


class JointRmse(Struct, kw_only=True, omit_defaults=True):
    """RMS error of one joint on the held-out logs where it slides, N m.

    `rmse_inside` is within the positions and speeds at which friction was identified,
    `rmse_outside` beyond them, `share_outside` the share of the samples there.
    """

    rmse: float
    rmse_inside: float | None = None
    rmse_outside: float | None = None
    share_outside: float | None = None


class EffectOfPlace(Struct, kw_only=True):
    """An effect by its name, at a joint or, where that is null, of the whole arm."""

    effect: str
    joint: str | None = None


class StoppedAt(Struct, kw_only=True):
    """The limit of rounds that a refinement has reached, and effects left untried."""

    rounds: int
    untried: list[EffectOfPlace]


class Stages(Struct, kw_only=True, omit_defaults=True):
    """Stages that have been identified so far."""

    friction: FrictionStage | None = None
    gravity: RigidStage | None = None
    imu: ImuStage | None = None
    inertia: RigidStage | None = None
    effects: list[EffectOfJoint] | None = None


class ClosedLoop(Struct, kw_only=True):
    """The rounds of a refinement, measured on the held-out logs alone.

    `rounds` are the effects that the model has, in the order in which they were added;
    `unconfirmed` those that were added and taken out again, as the held-out logs do not
    confirm them; `refused` those that were tried and did not help; `tried`, by joint,
    what was looked at last beside all that was found there. The `verdict` is
    poor if an effect of `rounds` is not confirmed or one of `verdicts` is poor, which
    say what is wrong with the logs. `stopped_at` is null where no limit of rounds has
    stopped the search. `before` is by the model as it came in, `after` by the one that
    is written; `gain_interval` is of 1 - (after / before)^2, 95 %. All are over the
    same samples, those in which a joint slides. `noise_floor` is what torque noise and
    encoder alone leave there, N m, estimated by itself, with its 95 % interval.
    `held_out` identifies the logs that `evaluated_on` names. `incoming` are friction,
    gravity and inertia as they came into the first refinement, for forms that have no
    place for effects; null where the stages are still the same.
    """

    verdict: Literal["good", "poor"] = "good"
    rounds: list[RefinementRound]
    unconfirmed: list[RefinementRound] = []
    refused: list[RefinementRound] = []
    tried: dict[str, list[RivalEntry]] = {}
    stopped_at: StoppedAt | None = None
    before: dict[str, JointRmse] = {}
    after: dict[str, JointRmse] = {}
    noise_floor: dict[str, float] = {}
    noise_floor_interval: dict[str, list[float]] = {}
    gain_interval: dict[str, list[float]] = {}
    evaluated_on: list[str] = []
    held_out: list[InputLog] = []
    incoming: Stages | None = None
    motion: list[MotionUse] = []
    verdicts: list[Verdict] = []
    notes: list[str] = []
    settings: UsedSettings | None = None

    @property
    def doubtful(self) -> list[RefinementRound]:
        """Effects that the model has and the held-out logs do not confirm."""
        return [item for item in self.rounds if item.confirmed is False]


class ParameterFile(OfRobot, kw_only=True, omit_defaults=True):
    """The whole document."""

    inputs: list[InputLog]
    stages: Stages
    closed_loop: ClosedLoop | None = None

    def _gist(self) -> list[str]:
        """Return the robot and the stages that the file has."""
        names = Stages.__struct_fields__
        present = [name for name in names if getattr(self.stages, name) is not None]
        return [self.robot.name, *present]
