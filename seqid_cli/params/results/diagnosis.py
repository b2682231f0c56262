"""The diagnosis file, `seqid/diagnosis@1`: effects that a model lacks."""

from typing import Literal

from seqid_cli.params.base import Struct
from seqid_cli.params.evidence_schema import EvidenceEntry, RivalEntry
from seqid_cli.params.results.prediction import FileId
from seqid_cli.params.schema import (
    ClosedLoop,
    InputLog,
    MotionUse,
    OfRobot,
    UsedSettings,
    Verdict,
)
from seqid_cli.shares import percent

DIAGNOSIS_SCHEMA = "seqid/diagnosis@1"
DiagnosisVerdict = Literal[
    "effect_found",
    "values_changed",
    "nothing_missing",
    "unexplained",
    "too_short",
    "nothing_seen",
]
_NOT_WHITE = "not white"
_MEASURES = {
    "driving_load": "load times direction",
    "recent_speed": "speed of the last seconds",
}
# Times what a right model leaves; on clean simulated arms 1.0 to 1.5.
MORE_THAN_NOISE = 2.5


class EffectParameter(Struct, kw_only=True):
    """A physical parameter of an effect; numbers that are not determined are null."""

    name: str
    value: float | None
    std_error: float | None
    unit: str


class FindingEntry(Struct, kw_only=True):
    """One effect that the model lacks; `joint` is null for an effect of the whole arm.

    `confidence` is the probability that it is this effect or one of `confusable_with`,
    which these logs do not separate from it; `name_confidence` that it is this one.
    `separate_by` says what to record to separate them. `explains` is the share of the
    held-out residual variance above the noise floor that the effect takes away, `gain`
    the share of the residual variance itself, `log_gain` that in log predictive
    density; `rivals` were tried in its place. `parameters` is empty where the logs do
    not determine them; the effect's torque is not linear in `settings`.
    """

    effect: str
    joint: str | None
    confidence: float
    explains: float
    confusable_with: list[str]
    separate_by: str
    gain: float
    name_confidence: float | None = None  # null: written before it was known
    parameters: list[EffectParameter] = []
    settings: dict[str, float] = {}
    note: str = ""
    log_gain: float | None = None  # null: of an event, or written before it was known
    evidence: EvidenceEntry | None = None
    rivals: list[RivalEntry] = []


class Curve(Struct, kw_only=True):
    """Shape of an unexplained residual over a quantity, in files without `evidence`."""

    quantity: str
    unit: str
    x: list[float]
    torque: list[float]  # N m (N where prismatic)


class ClosestEffect(Struct, kw_only=True):
    """The effect nearest to an unexplained part, and the `share` of its gain."""

    effect: str
    share: float


class UnexplainedPart(Struct, kw_only=True):
    """A part of a joint's residual that depends on quantities, but is no known effect.

    `depends_on` names the strongest first, out of position, velocity, direction,
    acceleration, load, temperature, time, time_frequency, other_joint:<name>; `share`
    is of the residual variance above the noise floor. `closest` is null where no effect
    comes near, and in files of before it was known.
    """

    joint: str
    depends_on: list[str]
    share: float
    curve: Curve | None = None
    closest: ClosestEffect | None = None
    log_gain: float | None = None
    evidence: EvidenceEntry | None = None
    rivals: list[RivalEntry] = []


class ChangeCause(Struct, kw_only=True):
    """An effect that may be what has changed; `joint` is null for one of the whole arm.

    `probability` is its share among the causes, `log_gain` its gain in log predictive
    density where it is all that has changed.
    """

    effect: str
    joint: str | None
    probability: float
    log_gain: float


class ChangedValues(Struct, kw_only=True):
    """A joint at which the form of the model is right and the file's values are not.

    `rmse` is what the file leaves, N m (N where prismatic), `floors` the same in noise
    floors, `rmse_refitted` what the model leaves on left-out blocks when it is fitted
    to the others. `since` is the first log in which more than noise is left, null where
    it is in all. `causes` compete for what has changed, the most probable first; empty
    where no single one is enough.
    """

    joint: str
    rmse: float
    floors: float
    rmse_refitted: float
    since: str | None = None
    causes: list[ChangeCause] = []


class ResidualEntry(Struct, kw_only=True):
    """Residual of one joint, N m: with the model as it is, and with findings in it.

    `rmse` counts all samples that the file sees, but for those of pushes that are
    found. `noise_floor` is the residual by torque noise and encoder alone, estimated by
    itself, and `noise_floor_interval` its 95 % interval. Numbers are null where no
    sample counts, or where these logs do not determine them. `white` says that nothing
    but noise is left. `verdict` is that of the document for this joint alone, null in
    files of before it was known. `tried` is what was not taken beside the findings.
    """

    rmse: float | None
    noise_floor: float | None
    noise_floor_interval: list[float] = []
    white: bool
    rmse_explained: float | None
    samples: int
    verdict: DiagnosisVerdict | None = None
    tried: list[RivalEntry] = []


class ContactPoint(Struct, kw_only=True):
    """Where a push acted: a point (m) in the frame of the link after a joint.

    Coordinates that the torques do not determine are null. `force` is its largest size,
    N. The link that was pushed may be one further out whose own joint did not move.
    """

    after_joint: str
    point: list[float | None]
    std_error: list[float | None]
    force: float


class EventEntry(Struct, kw_only=True):
    """An interval of a log (s since its start) in which something pushed the arm.

    `joints` felt it. `contact` is null where their torques do not determine a point.
    """

    log: str
    start: float
    end: float
    joints: list[str]
    contact: ContactPoint | None = None


class HiddenEntry(Struct, kw_only=True):
    """An effect that these motions cannot show.

    `visible` is the share of its torque that the model's own parameters do not absorb.
    """

    effect: str
    joint: str | None
    visible: float


class DiagnosisFile(OfRobot, kw_only=True):
    """The whole document; `findings` are ordered, the most certain first.

    `verdicts` are poor where the logs are damaged or the model is of no arm that can
    be: what is found then may be that.
    """

    inputs: list[InputLog]
    parameters: list[FileId]
    stages: list[str]  # names of the stages that took part
    verdict: DiagnosisVerdict
    findings: list[FindingEntry]
    unexplained: list[UnexplainedPart]
    changed: list[ChangedValues] = []
    joints: dict[str, ResidualEntry]
    events: list[EventEntry] = []
    hidden: list[HiddenEntry] = []
    motion: list[MotionUse] = []
    verdicts: list[Verdict] = []
    notes: list[str] = []
    settings: UsedSettings | None = None

    @property
    def leaves_more(self) -> bool:
        """True where more than noise is left of any joint's torque."""
        return any(map(beyond_noise, self.joints.values()))


def nothing_found(file: DiagnosisFile) -> str:
    """Return the sentence of a diagnosis without findings."""
    if file.verdict == "nothing_seen":
        return _nothing_seen(file)
    excess = {}
    for name, joint in file.joints.items():
        text = beyond_noise(joint)
        if text:
            excess[name] = text
    by_joint = "; ".join(f"{name}: {text}" for name, text in excess.items())
    if file.verdict == "too_short":
        reason = f" ({by_joint})" if by_joint else ""
        return f"These logs are too short to tell whether anything is missing{reason}."
    if not excess:
        return "Nothing is missing: what these logs leave of the torque is noise."
    if set(excess.values()) == {_NOT_WHITE}:
        return (
            "No effect was found. What is left is no larger than slow noise may be,"
            f" but it is {_NOT_WHITE} ({', '.join(excess)})."
        )
    return f"No effect was found, but not all that is left is noise ({by_joint})."


def _nothing_seen(file: DiagnosisFile) -> str:
    """Return the sentence of a diagnosis that could not look at some joints, or any."""
    unseen = unseen_joints(file)
    if len(unseen) == len(file.joints):
        return "Nothing was seen: these logs tell nothing of any joint."
    others = [name for name in file.joints if name not in unseen]
    return (
        f"Nothing was seen of {', '.join(unseen)}. Of {', '.join(others)} nothing is"
        " missing: what these logs leave of the torque there is noise."
    )


def unseen_joints(file: DiagnosisFile) -> list[str]:
    """Return the joints of which nothing can be said."""
    return [
        name
        for name, joint in file.joints.items()
        if joint.verdict == "nothing_seen" or joint.samples == 0
    ]


def values_sentence(file: DiagnosisFile) -> str:
    """Return the sentence of a file whose values do not hold."""
    sentences = " ".join(map(values_at, file.changed))
    return f"The form of the model is right, its values do not hold. {sentences}"


def values_at(changed: ChangedValues) -> str:
    """Return the sentence of a joint at which the file's values do not hold."""
    since = f" since {changed.since}" if changed.since else ""
    floors_refitted = changed.rmse_refitted / changed.rmse * changed.floors
    return (
        f"{changed.joint}: the file leaves {changed.floors:.3g} times the noise"
        f" floor{since}, identified anew it would leave {floors_refitted:.3g} times;"
        f" it may be {causes_in_words(changed)}."
    )


def causes_in_words(changed: ChangedValues) -> str:
    """Return the effects that compete for a change, with their probabilities."""
    causes = []
    for cause in changed.causes:
        where = "" if cause.joint else " of the whole arm"
        causes.append(f"{cause.effect}{where} ({percent(cause.probability, 0)})")
    return ", ".join(causes) or "several values at once"


def nothing_added(loop: ClosedLoop) -> str:
    """Return why a refinement added nothing."""
    if loop.unconfirmed:
        reason = "the held-out logs confirm nothing"
    elif loop.refused:
        reason = "no effect predicts left-out blocks better"
    else:
        reason = "nothing was found"
    return f"Nothing was added: {reason}"


def beyond_noise(joint: ResidualEntry) -> str:
    """Return why the residual of a joint may be more than noise; else empty."""
    reasons = []
    excess = times_noise(joint, joint.rmse)
    if excess:
        reasons.append(excess)
    if not joint.white and joint.rmse is not None:
        reasons.append(_NOT_WHITE)
    return ", ".join(reasons)


def times_noise(joint: ResidualEntry, rmse: float | None) -> str:
    """Return by how much an error is larger than noise makes it; else empty."""
    if not rmse or not joint.noise_floor:
        return ""
    limits = joint.noise_floor_interval
    most = limits[1] if limits else MORE_THAN_NOISE * joint.noise_floor
    if rmse <= most:
        return ""
    ratio = rmse / joint.noise_floor
    largest_ratio = most / joint.noise_floor
    return f"{ratio:.3g} times the noise floor, noise makes up to {largest_ratio:.3g}"


def over_words(evidence: EvidenceEntry) -> str:
    """Return the quantity that a residual is shown over, in words, without its unit."""
    if evidence.quantity == "torque":
        return "the effect's own torque"
    if evidence.quantity == "wave":
        return "place on its wave"
    quantity = _MEASURES.get(evidence.quantity, evidence.quantity)
    if evidence.of == evidence.joint:
        return quantity
    return f"{quantity} of {evidence.of}"
