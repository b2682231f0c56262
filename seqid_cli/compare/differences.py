"""Two results of one robot side by side, and the numbers that differ.

`judging` says when a number has changed. Its `least` size of a rigid-body parameter is
a thousandth of the largest of the same unit in its stage, so that parameters that are
really zero have a size too. Friction surfaces are compared over the positions and
speeds of both, not by coefficients.
"""

import math
from collections.abc import Iterator, Mapping, Sequence

import numpy as np
from msgspec.structs import replace

from seqid_cli.compare.judging import judged, missing, pairs
from seqid_cli.compare.results import diagnosis_differences, prediction_differences
from seqid_cli.errors import UsageError
from seqid_cli.model.friction import SLIDES, FrictionSurface
from seqid_cli.params import schema
from seqid_cli.params.dates import created_from
from seqid_cli.params.document import check_same_robot, head, poor_because, present
from seqid_cli.params.io import Document, Source
from seqid_cli.params.results.comparison import (
    COMPARISON_SCHEMA,
    ComparisonFile,
    Difference,
    RuleEntry,
)
from seqid_cli.params.results.diagnosis import DiagnosisFile
from seqid_cli.params.results.prediction import PredictionFile

# Points at which friction surfaces are compared, speeds in each direction.
_POSITIONS = 13
_SPEEDS = 12
_KINDS = ("parameter", "prediction", "diagnosis")
DEFAULT_SIGMA = 4.0  # one false alarm in 160 comparisons of 100 parameters each
DEFAULT_RTOL = 0.01


def rule_of(
    sigma: float | None, rtol: float | None, *, rounding: float = 1e-6
) -> RuleEntry:
    """Return the limits of a change.

    Parameters
    ----------
    sigma : float or None
        Combined standard errors beyond which a number has changed.
    rtol : float or None
        Share of its size beyond which it has changed. A limit that is given alone
        decides alone, but for the last digits.
    rounding : float
        Share of a number's size that rounding may change.
    """
    if sigma is None and rtol is None:
        return RuleEntry(sigma=DEFAULT_SIGMA, rtol=DEFAULT_RTOL)
    return RuleEntry(sigma=sigma, rtol=rounding if rtol is None else rtol)


def compared(
    a: Source[Document], b: Source[Document], rule: RuleEntry
) -> ComparisonFile:
    """Compare two files that were read, by a rule.

    Parameters
    ----------
    a, b : Source
        Files of one robot and of one kind.
    rule : RuleEntry
        Limits of a change.

    Raises
    ------
    UsageError
        The files are of two kinds, or of one that cannot be compared.
    ConfigError
        They are of different robots.
    """
    kind = _common_kind(a, b)
    first = a.content
    second = b.content
    check_same_robot(
        (a.path, first.robot), (b.path, second.robot), "Compare results of one robot."
    )

    notes = []
    if first.robot.sha256 != second.robot.sha256:
        notes.append(
            "the robot files differ: geometry, limits or drives may have changed"
        )
    differences: list[Difference] = []
    if isinstance(first, schema.ParameterFile) and isinstance(
        second, schema.ParameterFile
    ):
        differences += _stages(first.stages, second.stages, rule)
        notes += _verdict_notes(first.stages, second.stages)
    elif isinstance(first, PredictionFile) and isinstance(second, PredictionFile):
        differences += prediction_differences(first, second, rule)
    elif isinstance(first, DiagnosisFile) and isinstance(second, DiagnosisFile):
        differences += diagnosis_differences(first, second, rule)

    n_changed = sum(difference.different for difference in differences)
    return ComparisonFile(
        **head(COMPARISON_SCHEMA, created_from([first, second])),
        kind=kind,
        a=a.path,
        b=b.path,
        rule=rule,
        different=n_changed > 0,
        compared=len(differences),
        changed=n_changed,
        differences=differences,
        notes=notes,
    )


def _common_kind(a: Source[Document], b: Source[Document]) -> str:
    """Return the kind of two files; raise UsageError unless they can be compared."""
    kind = _kind(a.content)
    second_kind = _kind(b.content)
    if kind != second_kind:
        message = f"is a {second_kind} file, but {a.path} is a {kind} file"
        raise UsageError(message, where=b.path, hint="Compare files of one kind.")
    if kind not in _KINDS:
        message = f"is a {kind} file; what can be compared: {', '.join(_KINDS)}"
        hint = "Compare the parameter files that it was made from."
        raise UsageError(message, where=a.path, hint=hint)
    return kind


def _kind(content: Document) -> str:
    """Return the kind of a document in words."""
    if isinstance(content, schema.ParameterFile):
        return "parameter"
    return content.schema.removeprefix("seqid/").partition("@")[0]


def _stages(
    a: schema.Stages, b: schema.Stages, rule: RuleEntry
) -> Iterator[Difference]:
    """Yield the differences of all stages, also that one file lacks a stage."""
    for name, first, second in pairs(present(a), present(b)):
        # Effects that one file lacks are named one by one below.
        if name != "effects" and (first is None or second is None):
            yield missing(name, "stage", in_first=first is not None)

    if a.friction and b.friction:
        yield from _surfaces(a.friction, b.friction, rule)
    if a.gravity and b.gravity:
        yield from _rigid("gravity", a.gravity, b.gravity, rule)
    if a.inertia and b.inertia:
        yield from _rigid("inertia", a.inertia, b.inertia, rule)
    if a.imu and b.imu:
        yield from _imus(a.imu, b.imu, rule)
    yield from _effects(a.effects or [], b.effects or [], rule)


def _surfaces(
    a: schema.FrictionStage, b: schema.FrictionStage, rule: RuleEntry
) -> Iterator[Difference]:
    """Yield one difference of the friction surface of each joint."""
    for joint, first, second in pairs(a.joints, b.joints):
        if first and second:
            yield _surface(joint, first, second, rule)
        else:
            yield missing("friction", "surface", joint, in_first=first is not None)


def _surface(
    joint: str, a: schema.FrictionJoint, b: schema.FrictionJoint, rule: RuleEntry
) -> Difference:
    """Compare two surfaces on a grid; return the point that has changed most."""
    place = Difference(stage="friction", name="surface", joint=joint, unit=a.unit)
    low = max(a.position_range[0], b.position_range[0])
    high = min(a.position_range[1], b.position_range[1])
    # Below this speed a joint does not certainly slide.
    slow = max(
        a.speed_range[0],
        b.speed_range[0],
        SLIDES * a.sign_width,
        SLIDES * b.sign_width,
    )
    fast = min(a.speed_range[1], b.speed_range[1])
    if low > high or slow > fast:
        remark = "no position and speed is in the identified range of both"
        return replace(place, unit="", remark=remark)

    speeds = np.linspace(slow, fast, _SPEEDS)
    velocities = np.concatenate([-speeds, speeds])
    grid = np.meshgrid(np.linspace(low, high, _POSITIONS), velocities)
    q, dq = (axis.ravel() for axis in grid)
    first = FrictionSurface.from_stage(a)
    second = FrictionSurface.from_stage(b)
    torques = np.array([first.torque(q, dq), second.torque(q, dq)])
    std_errors = np.array([first.std_error(q, dq), second.std_error(q, dq)])

    # Friction may cross zero, where a share of it says nothing: the largest torque is
    # the size of every point.
    size = float(np.abs(torques).max())
    points = [
        judged(
            place,
            rule,
            (float(torques[0, k]), float(torques[1, k])),
            (float(std_errors[0, k]), float(std_errors[1, k])),
            least=size,
        )
        for k in range(len(q))
    ]
    order = [(point.different, abs(point.relative or 0.0)) for point in points]
    worst = order.index(max(order))
    remark = f"at {q[worst]:.3g}, speed {dq[worst]:.3g}"
    return replace(points[worst], remark=remark)


def _rigid(
    name: str,
    a: schema.RigidStage,
    b: schema.RigidStage,
    rule: RuleEntry,
    min_size: float = 1e-3,
) -> Iterator[Difference]:
    """Yield the differences of a rigid-body stage's parameters, and of its rotors."""
    least: dict[str, float] = {}
    for parameter in (*a.parameters, *b.parameters):
        size = min_size * abs(parameter.value)
        least[parameter.unit] = max(least.get(parameter.unit, 0.0), size)

    first = _torque_constants_held(a)
    second = _torque_constants_held(b)
    yield from _parameters(name, first, second, rule, least)
    if a.rotor_coupling != b.rotor_coupling and a.parameters and b.parameters:
        remark = f"rotors {a.rotor_coupling}, then {b.rotor_coupling}"
        yield Difference(stage=name, name="rotor coupling", joint="", remark=remark)


def _torque_constants_held(stage: schema.RigidStage) -> list[schema.Parameter]:
    """Return parameters without the errors of torque constants, which are common."""
    if not stage.torque_constant_moves or not stage.covariance:
        return stage.parameters
    variances = np.diag(np.array(stage.covariance))
    std_errors = np.sqrt(np.maximum(variances, 0.0)).tolist()
    return [
        replace(parameter, std_error=std_error)
        for parameter, std_error in zip(stage.parameters, std_errors, strict=True)
    ]


def _parameters(
    stage: str,
    a: Sequence[schema.Parameter],
    b: Sequence[schema.Parameter],
    rule: RuleEntry,
    least: Mapping[str, float] = {},
    prefix: str = "",
) -> Iterator[Difference]:
    """Yield the differences of parameters by name; `least` is their size by unit."""
    first_by_name = {parameter.name: parameter for parameter in a}
    second_by_name = {parameter.name: parameter for parameter in b}
    for name, first, second in pairs(first_by_name, second_by_name):
        if first is None or second is None:
            parameter = first or second_by_name[name]
            yield missing(
                stage, prefix + name, parameter.joint, in_first=first is not None
            )
            continue
        place = Difference(
            stage=stage, name=prefix + name, joint=first.joint, unit=first.unit
        )
        yield judged(
            place,
            rule,
            (first.value, second.value),
            (first.std_error, second.std_error),
            least=least.get(first.unit, 0.0),
        )


def _imus(
    a: schema.ImuStage, b: schema.ImuStage, rule: RuleEntry
) -> Iterator[Difference]:
    """Yield the angle between the two mountings of each IMU."""
    for name, first, second in pairs(a.imus, b.imus):
        if first is None or second is None:
            yield missing("imu", name, in_first=first is not None)
            continue
        angle, remark = _angle_between(first, second)
        place = Difference(
            stage="imu", name=f"{name} rotation", joint="", unit="deg", remark=remark
        )
        # An angle has no size of its own: shares are of a radian.
        yield judged(
            place,
            rule,
            (0.0, math.degrees(angle)),
            (first.std_error_deg, second.std_error_deg),
            least=math.degrees(1.0),
        )


def _angle_between(
    a: schema.ImuCalibration,
    b: schema.ImuCalibration,
    *,
    unknown_deg: float = 30.0,
) -> tuple[float, str]:
    """Return the angle between two mountings [rad], and what it is in words.

    An axis with a standard error above `unknown_deg` is not determined, and plays no
    part.
    """
    turn = np.array(b.rotation) @ np.array(a.rotation).T  # in the link's frame
    std_errors = [x.std_errors_deg for x in (a, b) if len(x.std_errors_deg) == 3]
    undetermined = [
        k for k in range(3) if any(errors[k] > unknown_deg for errors in std_errors)
    ]
    if len(undetermined) == 1:
        k = undetermined[0]
        across = math.hypot(*np.delete(turn[:, k], k))
        remark = (
            f"angle between the link's {'xyz'[k]} in the two; about it neither is"
            " determined"
        )
        return math.atan2(across, float(turn[k, k])), remark

    # By sine and cosine: the cosine alone loses small angles to rounding.
    sine = float(np.linalg.norm(turn - turn.T)) / math.sqrt(8.0)
    cosine = 0.5 * (float(np.trace(turn)) - 1.0)
    return math.atan2(sine, cosine), "angle between the two mountings"


def _effects(
    a: Sequence[schema.EffectOfJoint],
    b: Sequence[schema.EffectOfJoint],
    rule: RuleEntry,
) -> Iterator[Difference]:
    """Yield the differences of effects, and effects that one file lacks."""
    first_by_place = {(entry.effect, entry.joint or ""): entry for entry in a}
    second_by_place = {(entry.effect, entry.joint or ""): entry for entry in b}
    for (effect, joint), first, second in pairs(first_by_place, second_by_place):
        if first is None or second is None:
            yield missing("effects", effect, joint, in_first=first is not None)
            continue

        prefix = f"{effect}: "
        yield from _parameters(
            "effects", first.parameters, second.parameters, rule, prefix=prefix
        )
        # A setting that is among the parameters too has been compared with its error.
        parameters = {p.name for p in (*first.parameters, *second.parameters)}
        for name in sorted(first.settings.keys() & second.settings.keys() - parameters):
            value = first.settings[name]
            other_value = second.settings[name]
            if _is_number(value) and _is_number(other_value):
                place = Difference(stage="effects", name=prefix + name, joint=joint)
                yield judged(place, rule, (float(value), float(other_value)))


def _is_number(value: object) -> bool:
    """Return whether a setting is a number, and neither a word nor a flag."""
    return isinstance(value, int | float) and not isinstance(value, bool)


def _verdict_notes(a: schema.Stages, b: schema.Stages) -> Iterator[str]:
    """Yield a note for each verdict that has turned from good to poor, or back."""
    for name in ("friction", "gravity", "imu", "inertia"):
        first = getattr(a, name)
        second = getattr(b, name)
        if first is None or second is None:
            continue
        joints_before = {verdict.joint for verdict in first.verdicts}
        for joint in dict.fromkeys(verdict.joint for verdict in second.verdicts):
            reason_before = poor_because(first.verdicts, joint)
            reason_now = poor_because(second.verdicts, joint)
            if joint in joints_before and bool(reason_before) != bool(reason_now):
                verdict = f"poor: {reason_now}" if reason_now else "good"
                yield f"{name}: the verdict on {joint or 'the stage'} is now {verdict}"
