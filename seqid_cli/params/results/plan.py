"""The plan file, `seqid/plan@1`: motions to record next, and errors they will give."""

import math

from seqid_cli.params.base import Struct
from seqid_cli.params.results.prediction import FileId
from seqid_cli.params.schema import OfRobot, UsedSettings, Verdict

PLAN_SCHEMA = "seqid/plan@1"
HARMONICS = 5  # of a Fourier motion
SMALLEST = 1e-12  # of divisors: by smaller numbers results overflow
SHORTEST_S = 0.01  # of a move: its duration says how finely it is drawn


class JointLimits(Struct, kw_only=True):
    """Limits of a joint in a plan: rad, rad/s, rad/s^2, N m (prismatic: m, N).

    `torque` is null where neither robot file nor URDF tell it: torques were not checked
    there.
    """

    position: list[float]
    speed: float
    acceleration: float
    torque: float | None
    moves: bool

    def __post_init__(self) -> None:
        if len(self.position) != 2 or self.position[0] > self.position[1]:
            raise ValueError("position must be two numbers, the smaller one first")
        width = self.position[1] - self.position[0]
        for size in (width, self.speed, self.torque or 0.0):
            if 0.0 < abs(size) < SMALLEST:
                raise ValueError(f"a limit must be 0 or at least {SMALLEST}")


class FourierMotion(Struct, kw_only=True):
    """Motion of one joint, a Fourier series that rises from rest and falls to it.

    q(t) = centre + w(t) sum_k [sine[k] sin(k W t) + cosine[k] cos(k W t)]. k counts
    from 1, W = 2 pi / T with T the move's duration, and w rises from 0 to 1 within T /
    10 of the start as 10 x^3 - 15 x^4 + 6 x^5 and falls alike before the end.
    """

    centre: float
    sine: list[float]
    cosine: list[float]

    def __post_init__(self) -> None:
        if not len(self.sine) == len(self.cosine) == HARMONICS:
            raise ValueError(f"sine and cosine must have {HARMONICS} numbers each")


class ChirpMotion(Struct, kw_only=True):
    """Waves of one joint whose frequency rises from the lowest to the highest.

    q(t) = centre + w(t) A(f) sin(2 pi int f dt), f = lowest (highest / lowest)^(t / T),
    A(f) = amplitude / (1 + (f / corner)^2), and w as in `FourierMotion`. Above the
    corner the acceleration is the same at all frequencies. Frequencies are in Hz.
    """

    centre: float
    amplitude: float
    lowest_hz: float
    highest_hz: float
    corner_hz: float

    def __post_init__(self) -> None:
        if not 0.0 < self.lowest_hz < self.highest_hz or not self.corner_hz > 0.0:
            raise ValueError("frequencies must be positive and rise")


class Stroke(Struct, kw_only=True):
    """One way of a joint at constant speed; its ends are reached in cosine ramps."""

    start: float
    end: float
    speed: float
    acceleration: float

    def __post_init__(self) -> None:
        if not min(self.speed, self.acceleration) >= SMALLEST:
            raise ValueError("speed and acceleration must be positive")

    @property
    def seconds(self) -> float:
        """Duration, s."""
        distance = abs(self.end - self.start)
        ramps = math.pi * self.speed / (2.0 * self.acceleration)
        return distance / self.speed + ramps


class PlannedMove(Struct, kw_only=True):
    """One motion to record, from rest to rest.

    `start` is where all joints stand before. Joints move by `fourier`, by `chirp` or,
    one after the other way, by `strokes` of the only joint in `joints`; others stay.
    `torque_share` is the largest torque that is expected, three standard errors added,
    over the joint's limit (null: not known); `torque` that torque (N m) in equal parts
    of the time, by joint (empty: not known).
    """

    name: str
    stage: str
    joints: list[str]
    duration_s: float
    start: dict[str, float]
    fourier: dict[str, FourierMotion] = {}
    chirp: dict[str, ChirpMotion] = {}
    strokes: list[Stroke] = []
    torque_share: float | None = None
    torque: dict[str, list[float]] = {}
    file: str = ""

    def __post_init__(self) -> None:
        shortest = max(SHORTEST_S, sum(stroke.seconds for stroke in self.strokes))
        if not self.duration_s >= shortest:
            raise ValueError(f"duration_s must be at least {shortest:.3g}")
        if self.strokes and len(self.joints) != 1:
            raise ValueError("strokes move one joint")
        parts = {len(torque) for torque in self.torque.values()}
        if len(parts) > 1 or 0 in parts:
            raise ValueError("torque must have as many parts for each joint")


class PredictedParameter(Struct, kw_only=True):
    """The standard error that a base parameter will have after the plan."""

    name: str
    joint: str
    unit: str
    std_error: float
    value: float | None  # so far; null: none
    expression: str = ""


class PlanGrowth(Struct, kw_only=True):
    """Torque error that parameters leave after the first `moves` of a stage.

    It is over the noise. The error is the root mean square over typical all-joint
    moves, the noise that below 25 Hz.
    """

    moves: int
    duration_s: float
    rank: int
    error: float


class EffectSeparation(Struct, kw_only=True):
    """Power of the moves to tell two effects apart, as the diagnosis will ask.

    `size` is the root mean square torque (N m) of the effect that is assumed. `powers`
    are the probabilities, in the order of `between`, that the diagnosis drops the other
    effect where this one is there, over the settings and coefficients that it may have;
    `imitations` the largest share of its gain that the other one reaches then, which no
    time lowers. `power` is the smaller and `imitated` the larger of both.
    `seconds_needed` give a power of 0.95 (null: no time does). The explanations lie
    `distance` standard deviations of the noise apart in the middle of the cases.
    `special_case` is the effect that the other one contains: it can be refuted, not
    shown.
    """

    between: list[str]
    joint: str | None
    size: float
    distance: float
    power: float
    seconds_needed: float | None
    imitated: float
    powers: list[float] = []
    imitations: list[float] = []
    special_case: str | None = None


class PlanCriterion(Struct, kw_only=True):
    """The criterion that was minimised, in words, and its value for the moves."""

    minimised: str
    value: float


class PlannedStage(Struct, kw_only=True):
    """The standard errors that the moves of one stage will give.

    `torque_error` is the standard deviation of the predicted torque that the
    parameters' errors will make in typical all-joint moves, N m. `condition` is that of
    the regressor, rows weighted by the noise and columns scaled to length 1.
    `criterion` is what was minimised. Of gravity, `plain_condition` is Eq. 20 to the
    letter, cond(Phi(H_g)) in SI units without weights, and `scaled_condition` the same
    with columns of length 1.
    """

    parameters: list[PredictedParameter] = []
    rank: int | None = None
    structural_rank: int | None = None
    condition: float | None = None
    criterion: PlanCriterion | None = None
    plain_condition: float | None = None
    scaled_condition: float | None = None
    not_excited: list[str] = []
    torque_error: dict[str, float] = {}
    growth: list[PlanGrowth] = []
    duration_s: float = 0.0
    notes: list[str] = []
    separation: EffectSeparation | None = None


class PlanFile(OfRobot, kw_only=True):
    """The whole document. `noise_density` is the torque's, N m/sqrt(Hz), one-sided."""

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
    settings: UsedSettings | None = None
    notes: list[str] = []

    def __post_init__(self) -> None:
        joints = set(self.limits)
        for index, move in enumerate(self.moves):
            named = {*move.joints, *move.fourier, *move.chirp, *move.torque}
            if set(move.start) != joints or not named <= joints:
                raise ValueError(f"moves[{index}] names other joints than limits")
