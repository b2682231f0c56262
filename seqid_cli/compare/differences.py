"""Two results of one robot side by side, and the numbers that differ.

A number has changed when

    |b - a| > sigma sqrt(e_a^2 + e_b^2)    and    |b - a| > rtol max(|a|, |b|, least).

The first condition alone would report the last digits of another machine where data are
good; the second alone the noise of another log where they are poor. Numbers without a
standard error are judged by their size alone. `least` of a rigid-body parameter is a
thousandth of the largest of the same unit in its stage, so that parameters that are
really zero have a size too. Friction surfaces are compared over the positions and
speeds of both, not by coefficients.
"""

import math
from collections.abc import Iterator, Mapping, Sequence
from typing import TypeVar

import numpy as np
from msgspec.structs import replace

from seqid_cli.errors import UsageError
from seqid_cli.model.friction import SLIDES, FrictionSurface
from seqid_cli.params import schema
from seqid_cli.params.dates import created_from
from seqid_cli.params.document import check_same_robot, head, poor_because, present
from seqid_cli.params.io import Document, Source
from seqid_cli.params.results import comparison
from seqid_cli.params.results.comparison import ComparisonFile, Difference, RuleEntry
from seqid_cli.params.results.diagnosis import DiagnosisFile
from seqid_cli.params.results.prediction import PredictionFile

# points at which friction surfaces are compared, per direction
_POSITIONS, _SPEEDS = 13, 12
_KINDS = ("parameter", "prediction", "diagnosis")
DEFAULT_SIGMA = 4.0  # one false alarm in 160 comparisons of 100 parameters each
DEFAULT_RTOL = 0.01
Two = tuple[float, float]  # of the first and of the second file
Judged = PredictionFile | DiagnosisFile
K = TypeVar("K")
V = TypeVar("V")


def rule_of(
    sigma: float | None, rtol: float | None, *, rounding: float = 1e-6
) -> RuleEntry:
    """Return the limits of a change: one given alone decides alone, down to rounding."""
    if sigma is None and rtol is None:
        return RuleEntry(sigma=DEFAULT_SIGMA, rtol=DEFAULT_RTOL)
    return RuleEntry(sigma=sigma, rtol=rounding if rtol is None else rtol)


def compared(
    a: Source[Document], b: Source[Document], rule: RuleEntry
) -> ComparisonFile:
    """Compare two files that were read, by a rule."""
    kind, other = _kind(a.content), _kind(b.content)
    if kind != other:
        message = f"is a {other} file, but {a.path} is a {kind} file"
        raise UsageError(message, where=b.path, hint="Compare files of one kind.")
    if kind not in _KINDS:
        message = f"is a {kind} file; what can be compared: {', '.join(_KINDS)}"
        hint = "Compare the parameter files that it was made from."
        raise UsageError(message, where=a.path, hint=hint)
    left, right = a.content, b.content
    check_same_robot(
        (a.path, left.robot), (b.path, right.robot), "Compare results of one robot."
    )
    notes, found = [], []
    if left.robot.sha256 != right.robot.sha256:
        notes.append(
            "the robot files differ: geometry, limits or drives may have changed"
        )
    if isinstance(left, schema.ParameterFile) and isinstance(
        right, schema.ParameterFile
    ):
        found = [*_stages(left.stages, right.stages, rule)]
        notes += _verdict_notes(left.stages, right.stages)
    elif isinstance(left, PredictionFile) and isinstance(right, PredictionFile):
        found = [*_errors("prediction", left, right, ("rmse", "max_abs"), rule)]
    elif isinstance(left, DiagnosisFile) and isinstance(right, DiagnosisFile):
        found = [*_diagnoses(left, right, rule)]
    changed = sum(item.different for item in found)
    return ComparisonFile(
        **head(comparison.COMPARISON_SCHEMA, created_from([left, right])),
        kind=kind,
        a=a.path,
        b=b.path,
        rule=rule,
        different=changed > 0,
        compared=len(found),
        changed=changed,
        differences=found,
        notes=notes,
    )


def _kind(content: Document) -> str:
    kind = content.schema.removeprefix("seqid/").partition("@")[0]
    return "parameter" if isinstance(content, schema.ParameterFile) else kind


def _judged(
    where: Difference,
    rule: RuleEntry,
    values: Two,
    errors: Two = (0.0, 0.0),
    *,
    least: float = 0.0,
) -> Difference:
    """Judge two values and their standard errors; `least` is the size that they have at least."""
    a, b = values
    size, error = max(abs(a), abs(b), least), math.hypot(*errors)
    relative = abs(b - a) / size if size > 0.0 else 0.0
    sigmas = abs(b - a) / error if error > 0.0 else None
    within = sigmas is not None and rule.sigma is not None and sigmas <= rule.sigma
    judged = replace(where, different=not within and relative > rule.rtol)
    return replace(
        judged, a=a, b=b, std_error=error or None, sigmas=sigmas, relative=relative
    )


def _missing(stage: str, name: str, joint: str = "", *, there: bool) -> Difference:
    """Return the change that one file lacks a number that is `there` in the first, or not."""
    remark = "only in the first" if there else "only in the second"
    return Difference(stage=stage, name=name, joint=joint, remark=remark)


def _both(
    left: Mapping[K, V], right: Mapping[K, V]
) -> Iterator[tuple[K, V | None, V | None]]:
    """All keys of two mappings with what stands under each; None where it is missing."""
    for key in {**left, **right}:
        yield key, left.get(key), right.get(key)


def _stages(
    a: schema.Stages, b: schema.Stages, rule: RuleEntry
) -> Iterator[Difference]:
    """Yield the differences of all stages; a stage that one file lacks is a difference."""
    for name, one, other in _both(present(a), present(b)):
        if name != "effects" and (one is None or other is None):
            yield _missing(name, "stage", there=one is not None)
    if a.friction and b.friction:
        for joint, mine, theirs in _both(a.friction.joints, b.friction.joints):
            if mine and theirs:
                yield _surface(joint, mine, theirs, rule)
            else:
                yield _missing("friction", "surface", joint, there=mine is not None)
    if a.gravity and b.gravity:
        yield from _rigid("gravity", a.gravity, b.gravity, rule)
    if a.inertia and b.inertia:
        yield from _rigid("inertia", a.inertia, b.inertia, rule)
    if a.imu and b.imu:
        yield from _imus(a.imu, b.imu, rule)
    yield from _effects(a.effects or [], b.effects or [], rule)


def _rigid(
    name: str,
    a: schema.RigidStage,
    b: schema.RigidStage,
    rule: RuleEntry,
    min_size: float = 1e-3,
) -> Iterator[Difference]:
    least: dict[str, float] = {}
    for x in (*a.parameters, *b.parameters):
        least[x.unit] = max(least.get(x.unit, 0.0), min_size * abs(x.value))
    one, other = (_torque_constants_held(stage) for stage in (a, b))
    yield from _parameters(name, one, other, rule, least)
    if a.rotor_coupling != b.rotor_coupling and a.parameters and b.parameters:
        remark = f"rotors {a.rotor_coupling}, then {b.rotor_coupling}"
        yield Difference(stage=name, name="rotor coupling", joint="", remark=remark)


def _torque_constants_held(stage: schema.RigidStage) -> list[schema.Parameter]:
    """Parameters without the errors of torque constants: both files have the same ones."""
    if not stage.torque_constant_moves or not stage.covariance:
        return stage.parameters
    errors = np.sqrt(np.maximum(np.diag(np.array(stage.covariance)), 0.0)).tolist()
    return [
        replace(p, std_error=e) for p, e in zip(stage.parameters, errors, strict=True)
    ]


def _parameters(
    stage: str,
    a: Sequence[schema.Parameter],
    b: Sequence[schema.Parameter],
    rule: RuleEntry,
    least: Mapping[str, float] = {},
    prefix: str = "",
) -> Iterator[Difference]:
    left, right = ({parameter.name: parameter for parameter in side} for side in (a, b))
    for name, one, other in _both(left, right):
        known = one or right[name]
        if one is None or other is None:
            yield _missing(stage, prefix + name, known.joint, there=one is not None)
            continue
        where = Difference(
            stage=stage, name=prefix + name, joint=known.joint, unit=known.unit
        )
        values, errors = (one.value, other.value), (one.std_error, other.std_error)
        yield _judged(where, rule, values, errors, least=least.get(one.unit, 0.0))


def _surface(
    joint: str, a: schema.FrictionJoint, b: schema.FrictionJoint, rule: RuleEntry
) -> Difference:
    """Compare two surfaces over the positions and speeds of both; report the point most changed."""
    where = Difference(stage="friction", name="surface", joint=joint, unit=a.unit)
    ranges = (a.position_range, b.position_range), (a.speed_range, b.speed_range)
    (low, high), (slow, fast) = ((max(x[0], y[0]), min(x[1], y[1])) for x, y in ranges)
    slow = max(slow, SLIDES * a.sign_width, SLIDES * b.sign_width)
    if low > high or slow > fast:
        remark = "no position and speed is in the identified range of both"
        return replace(where, unit="", remark=remark)
    speeds = np.linspace(slow, fast, _SPEEDS)
    grid = np.meshgrid(
        np.linspace(low, high, _POSITIONS), np.concatenate([-speeds, speeds])
    )
    q, v = (axis.ravel() for axis in grid)
    surfaces = FrictionSurface.from_stage(a), FrictionSurface.from_stage(b)
    torques = np.array([surface.torque(q, v) for surface in surfaces]).T
    errors = np.array([surface.std_error(q, v) for surface in surfaces]).T
    size = float(np.abs(torques).max())
    both = zip(torques.tolist(), errors.tolist(), strict=True)
    points = [_judged(where, rule, tuple(x), tuple(e), least=size) for x, e in both]
    k = max(
        range(len(points)),
        key=lambda k: (points[k].different, points[k].relative or 0.0),
    )
    return replace(points[k], remark=f"at {q[k]:.3g}, speed {v[k]:.3g}")


def _imus(
    a: schema.ImuStage, b: schema.ImuStage, rule: RuleEntry
) -> Iterator[Difference]:
    for name, one, other in _both(a.imus, b.imus):
        if one is None or other is None:
            yield _missing("imu", name, there=one is not None)
            continue
        angle, remark = _angle_between(one, other)
        what = f"{name} rotation"
        where = Difference(stage="imu", name=what, joint="", unit="deg", remark=remark)
        values, errors = (
            (0.0, math.degrees(angle)),
            (one.std_error_deg, other.std_error_deg),
        )
        yield _judged(where, rule, values, errors, least=math.degrees(1.0))


def _angle_between(
    one: schema.ImuCalibration,
    other: schema.ImuCalibration,
    *,
    unknown_deg: float = 30.0,
) -> tuple[float, str]:
    """Angle between two mountings [rad], and what it is.

    An axis with a standard error above `unknown_deg` is not determined, and plays no
    part.
    """
    turn = np.array(other.rotation) @ np.array(one.rotation).T  # in the link's frame
    errors = [
        each.std_errors_deg for each in (one, other) if len(each.std_errors_deg) == 3
    ]
    free = [k for k in range(3) if any(each[k] > unknown_deg for each in errors)]
    if len(free) == 1:
        k = free[0]
        across = math.hypot(*np.delete(turn[:, k], k))
        remark = (
            f"angle between the link's {'xyz'[k]} in the two; about it neither is"
            " determined"
        )
        return math.atan2(across, float(turn[k, k])), remark
    cosine = 0.5 * (float(np.trace(turn)) - 1.0)
    angle = math.atan2(float(np.linalg.norm(turn - turn.T)) / math.sqrt(8.0), cosine)
    return angle, "angle between the two mountings"


def _effects(
    a: Sequence[schema.EffectOfJoint],
    b: Sequence[schema.EffectOfJoint],
    rule: RuleEntry,
) -> Iterator[Difference]:
    left, right = (
        {(item.effect, item.joint or ""): item for item in side} for side in (a, b)
    )
    for (effect, joint), one, other in _both(left, right):
        if one is None or other is None:
            yield _missing("effects", effect, joint, there=one is not None)
            continue
        prefix = f"{effect}: "
        yield from _parameters(
            "effects", one.parameters, other.parameters, rule, prefix=prefix
        )
        stated = {parameter.name for parameter in (*one.parameters, *other.parameters)}
        for name in sorted(one.settings.keys() & other.settings.keys() - stated):
            values = (one.settings[name], other.settings[name])
            if all(
                isinstance(x, int | float) and not isinstance(x, bool) for x in values
            ):
                where = Difference(stage="effects", name=prefix + name, joint=joint)
                yield _judged(where, rule, (float(values[0]), float(values[1])))


def _diagnoses(
    a: DiagnosisFile, b: DiagnosisFile, rule: RuleEntry
) -> Iterator[Difference]:
    if a.verdict != b.verdict:
        remark = f"{a.verdict}, then {b.verdict}"
        yield Difference(stage="diagnosis", name="verdict", joint="", remark=remark)
    left, right = (
        {(f.effect, f.joint or ""): f for f in side.findings} for side in (a, b)
    )
    for (effect, joint), before, after in _both(left, right):
        if before is None or after is None:
            yield _missing("diagnosis", effect, joint, there=before is not None)
    yield from _errors("diagnosis", a, b, ("rmse", "noise_floor"), rule)


def _errors(
    stage: str, a: Judged, b: Judged, names: Sequence[str], rule: RuleEntry
) -> Iterator[Difference]:
    """Judge errors of every joint; one that neither file has is left out."""
    for joint, one, other in _both(a.joints, b.joints):
        if one is None or other is None:
            if stage == "prediction":  # a diagnosis names the joints that its logs move
                yield _missing(stage, "joint", joint, there=one is not None)
            continue
        for name in names:
            before, after = getattr(one, name), getattr(other, name)
            if before is not None and after is not None:
                unit = a.robot.unit("N m", joint)
                where = Difference(stage=stage, name=name, joint=joint, unit=unit)
                yield _judged(where, rule, (before, after))
            elif before is not None or after is not None:
                yield _missing(stage, name, joint, there=before is not None)


def _verdict_notes(a: schema.Stages, b: schema.Stages) -> Iterator[str]:
    for name in ("friction", "gravity", "imu", "inertia"):
        one, other = getattr(a, name), getattr(b, name)
        if one is None or other is None:
            continue
        judged = {verdict.joint for verdict in one.verdicts}
        for joint in dict.fromkeys(verdict.joint for verdict in other.verdicts):
            before, after = (
                poor_because(stage.verdicts, joint) for stage in (one, other)
            )
            if joint in judged and bool(before) != bool(after):
                said = f"poor: {after}" if after else "good"
                yield f"{name}: the verdict on {joint or 'the stage'} is now {said}"
