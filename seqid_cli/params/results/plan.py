"""The plan file, `seqid/plan@1`: which motions to record next and what errors they will give."""

from seqid_cli.params.base import Document, Struct
from seqid_cli.params.results.prediction import FileId
from seqid_cli.params.schema import RobotId, Tool, Verdict

PLAN_SCHEMA = "seqid/plan@1"


class JointLimits(Struct, kw_only=True):
    """What a plan uses of a joint's limits: rad, rad/s, rad/s^2, N m (prismatic: m, N).

    `torque` is null where neither robot file nor URDF tell it: torques were not checked there.
    """

    position: list[float]
    speed: float
    acceleration: float
    torque: float | None
    moves: bool


class FourierMotion(Struct, kw_only=True):
    """How one joint moves: q(t) = centre + w(t) sum_k [sine[k] sin(k W t) + cosine[k] cos(k W t)].

    k counts from 1, W = 2 pi / T with T the move's duration, and w rises from 0 to 1 within T / 10
    of the start as 10 x^3 - 15 x^4 + 6 x^5 and falls alike before the end.
    """

    centre: float
    sine: list[float]
    cosine: list[float]


class Stroke(Struct, kw_only=True):
    """One way of one joint at constant speed; ends are reached and left in cosine ramps."""

    start: float
    end: float
    speed: float
    acceleration: float


class PlannedMove(Struct, kw_only=True):
    """One motion to record, from rest to rest.

    `start` is where all joints stand before. Joints move by `fourier` or, one after the other way,
    by `strokes` of the only joint in `joints`; all others stay. `torque_share` is the largest
    torque that is expected, three standard errors added, over the joint's limit (null: not known);
    `torque` that torque (N m) in equal parts of the time, by joint (empty: not known).
    """

    name: str
    stage: str
    joints: list[str]
    duration_s: float
    start: dict[str, float]
    fourier: dict[str, FourierMotion] = {}
    strokes: list[Stroke] = []
    torque_share: float | None = None
    torque: dict[str, list[float]] = {}
    file: str = ""


class PredictedParameter(Struct, kw_only=True):
    """The standard error that a base parameter will have after the plan."""

    name: str
    joint: str
    unit: str
    std_error: float
    value: float | None  # so far; null: none
    expression: str = ""


class PlanGrowth(Struct, kw_only=True):
    """The torque error that parameters leave after the first `moves` of a stage, over noise.

    The error is the root mean square over typical all-joint moves, the noise that below 25 Hz.
    """

    moves: int
    duration_s: float
    rank: int
    error: float


class EffectSeparation(Struct, kw_only=True):
    """How well the moves tell two effects apart.

    `size` is the root mean square torque (N m) of the effect that is assumed; the two explanations
    lie `distance` standard deviations of the noise apart, so that a test of level 0.05 finds the
    right one with probability `power`; `seconds_needed` give 0.95. `imitated` is the largest share
    of an effect that the other one imitates on these moves, which no time lowers. `special_case`
    is the effect that the other one contains: it can be refuted, not shown.
    """

    between: list[str]
    joint: str | None
    size: float
    distance: float
    power: float
    seconds_needed: float | None
    imitated: float
    special_case: str | None = None


class PlannedStage(Struct, kw_only=True):
    """The standard errors that the moves of one stage will give.

    `torque_error` is the standard deviation of the predicted torque that the parameters' errors
    will make in typical all-joint moves, N m. `condition` is that of the scaled regressor.
    """

    parameters: list[PredictedParameter] = []
    rank: int | None = None
    structural_rank: int | None = None
    condition: float | None = None
    not_excited: list[str] = []
    torque_error: dict[str, float] = {}
    growth: list[PlanGrowth] = []
    duration_s: float = 0.0
    notes: list[str] = []
    separation: EffectSeparation | None = None


class PlanFile(Document, kw_only=True):
    """The whole document. `noise_density` is the torque's, N m/sqrt(Hz), one-sided."""

    schema: str
    created: str
    tool: Tool
    robot: RobotId
    what: str
    seed: int
    parameters: list[FileId]
    limits: dict[str, JointLimits]
    noise_density: dict[str, float]
    noise_origin: str
    moves: list[PlannedMove]
    stages: dict[str, PlannedStage]
    duration_s: float  # of all moves
    total_s: float  # with the ways between them
    speed_scale: float = 1.0  # of the trajectories' files
    verdicts: list[Verdict] = []
    notes: list[str] = []
