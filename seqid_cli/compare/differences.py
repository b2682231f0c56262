"""Two results of one robot side by side, and the numbers that differ.

`comparison` says when a number differs. The size of a rigid-body parameter is at least a
thousandth of the largest of the same unit in its stage, so that parameters that are really zero
have one too; friction surfaces are compared over the positions and speeds of both, not by
coefficients.
"""

import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from typing import TypeVar

import numpy as np
from msgspec.structs import replace

from seqid_cli.compare.rule import Rule, judged, missing, unlike
from seqid_cli.errors import UsageError
from seqid_cli.model.friction import SLIDES, FrictionSurface
from seqid_cli.params.document import check_same_robot, now, present, tool
from seqid_cli.params.io import Document, Source
from seqid_cli.params.results.comparison import COMPARISON_SCHEMA, ComparisonFile, Difference
from seqid_cli.params.results.diagnosis import DiagnosisFile
from seqid_cli.params.results.prediction import PredictionFile
from seqid_cli.params.schema import (
    EffectOfJoint,
    FrictionJoint,
    ImuCalibration,
    ImuStage,
    Parameter,
    ParameterFile,
    RigidStage,
    RobotId,
    Stages,
    Verdict,
)
from seqid_cli.robot.types import Array

_POSITIONS, _SPEEDS = 13, 12  # points at which friction surfaces are compared, per direction

_KINDS = ("parameter", "prediction", "diagnosis")
K = TypeVar("K")
V = TypeVar("V")


def compare(a: Source[Document], b: Source[Document], *, rule: Rule) -> ComparisonFile:
    """Compare two parameter, prediction or diagnosis files of one robot."""
    kind = _kind(a.content)
    if kind != _kind(b.content):
        raise UsageError(
            f"is a {_kind(b.content)} file, but {a.path} is a {kind} file",
            where=b.path,
            hint="Compare files of one kind.",
        )
    if kind not in _KINDS:
        raise UsageError(
            f"is a {kind} file; what can be compared: {', '.join(_KINDS)}",
            where=a.path,
            hint="Compare the parameter files that it was made from.",
        )
    left, right = a.content, b.content
    check_same_robot((a.path, left.robot), (b.path, right.robot), "Compare results of one robot.")
    notes = []
    if left.robot.sha256 != right.robot.sha256:
        notes.append("the robot files differ: geometry, limits or drives may have changed")
    if isinstance(left, ParameterFile) and isinstance(right, ParameterFile):
        found = list(_stages(left.stages, right.stages, rule))
        notes += _verdict_notes(left.stages, right.stages)
    elif isinstance(left, PredictionFile) and isinstance(right, PredictionFile):
        found = list(_predictions(left, right, rule))
    elif isinstance(left, DiagnosisFile) and isinstance(right, DiagnosisFile):
        found = list(_diagnoses(left, right, rule))
    changed = sum(item.different for item in found)
    return ComparisonFile(
        schema=COMPARISON_SCHEMA,
        created=now(),
        tool=tool(),
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
    if isinstance(content, ParameterFile):
        return "parameter"
    return content.schema.removeprefix("seqid/").partition("@")[0]


def _stages(a: Stages, b: Stages, rule: Rule) -> Iterator[Difference]:
    """Yield the differences of all stages; a stage that one file lacks is a difference."""
    left, right = present(a), present(b)
    for name in {**left, **right}:
        if name != "effects" and (name not in left or name not in right):
            yield missing(name, "stage", there=name in left)
    if a.friction and b.friction:
        joints = a.friction.joints, b.friction.joints
        for name, one, other in _both(*joints):
            if one and other:
                yield _surface(name, one, other, rule)
            else:
                yield missing("friction", "surface", joint=name, there=one is not None)
    for stage, mine, theirs in (
        ("gravity", a.gravity, b.gravity),
        ("inertia", a.inertia, b.inertia),
    ):
        if mine and theirs:
            yield from _rigid(stage, mine, theirs, rule)
    if a.imu and b.imu:
        yield from _imus(a.imu, b.imu, rule)
    yield from _effects(a.effects or [], b.effects or [], rule)


def _both(left: Mapping[K, V], right: Mapping[K, V]) -> Iterator[tuple[K, V | None, V | None]]:
    """All keys of two mappings with what stands under each; None where it is missing."""
    for key in {**left, **right}:
        yield key, left.get(key), right.get(key)


def _rigid(
    name: str, a: RigidStage, b: RigidStage, rule: Rule, *, min_size: float = 1e-3
) -> Iterator[Difference]:
    largest: dict[str, float] = {}
    for parameter in (*a.parameters, *b.parameters):
        size = max(largest.get(parameter.unit, 0.0), abs(parameter.value))
        largest[parameter.unit] = size
    least = {unit: min_size * size for unit, size in largest.items()}
    one, other = (_torque_constants_held(stage) for stage in (a, b))
    yield from _parameters(name, one, other, rule, least)
    if a.rotor_coupling != b.rotor_coupling and a.parameters and b.parameters:
        remark = f"rotors {a.rotor_coupling}, then {b.rotor_coupling}"
        yield unlike(name, "rotor coupling", "", remark)


def _torque_constants_held(stage: RigidStage) -> list[Parameter]:
    """Parameters without the errors of torque constants: both files have the same ones."""
    if not stage.torque_constant_moves or not stage.covariance:
        return stage.parameters
    errors = np.sqrt(np.maximum(np.diag(np.array(stage.covariance)), 0.0))
    return [
        replace(parameter, std_error=float(error))
        for parameter, error in zip(stage.parameters, errors, strict=True)
    ]


def _parameters(
    stage: str,
    a: Sequence[Parameter],
    b: Sequence[Parameter],
    rule: Rule,
    least: Mapping[str, float] | None = None,
    prefix: str = "",
) -> Iterator[Difference]:
    left, right = ({parameter.name: parameter for parameter in side} for side in (a, b))
    for name, one, other in _both(left, right):
        if one is None or other is None:
            joint = (left.get(name) or right[name]).joint
            yield missing(stage, prefix + name, joint=joint, there=one is not None)
            continue
        pair, errors = (one.value, other.value), (one.std_error, other.std_error)
        size = (least or {}).get(one.unit, 0.0)
        yield judged(stage, prefix + name, one.joint, one.unit, pair, errors, rule, least=size)


def _surface(name: str, a: FrictionJoint, b: FrictionJoint, rule: Rule) -> Difference:
    """Compare two surfaces over the positions and speeds of both; report the point most changed."""
    q, v = _shared_grid(a, b)
    if not len(q):
        remark = "no position and speed is in the identified range of both"
        return unlike("friction", "surface", name, remark)
    one, other = FrictionSurface.from_stage(a), FrictionSurface.from_stage(b)
    tau_a, tau_b = one.torque(q, v), other.torque(q, v)
    error = np.hypot(one.std_error(q, v), other.std_error(q, v))
    size = max(float(np.abs(tau_a).max()), float(np.abs(tau_b).max()))
    points = [
        judged(
            "friction",
            "surface",
            name,
            a.unit,
            (float(tau_a[k]), float(tau_b[k])),
            (float(error[k]), 0.0),
            rule,
            least=size,
            remark=f"at {q[k]:.3g}, speed {v[k]:.3g}",
        )
        for k in range(len(q))
    ]
    return max(points, key=lambda point: (point.different, point.relative or 0.0))


def _shared_grid(a: FrictionJoint, b: FrictionJoint) -> tuple[Array, ...]:
    """Positions and velocities (K,) inside the identified range of both; none if there is none."""
    (low, high), (slow, fast) = (
        (max(one[0], other[0]), min(one[1], other[1]))
        for one, other in ((a.position_range, b.position_range), (a.speed_range, b.speed_range))
    )
    slow = max(slow, SLIDES * a.sign_width, SLIDES * b.sign_width)
    if low > high or slow > fast:
        return np.empty(0), np.empty(0)
    speeds = np.linspace(slow, fast, _SPEEDS)
    q, v = np.meshgrid(np.linspace(low, high, _POSITIONS), np.concatenate([-speeds, speeds]))
    return q.ravel(), v.ravel()


def _imus(a: ImuStage, b: ImuStage, rule: Rule) -> Iterator[Difference]:
    for name, one, other in _both(a.imus, b.imus):
        if one is None or other is None:
            yield missing("imu", name, there=one is not None)
            continue
        angle, remark = _angle_between(one, other)
        values, errors = (0.0, math.degrees(angle)), (one.std_error_deg, other.std_error_deg)
        what, least = f"{name} rotation", math.degrees(1.0)
        yield judged("imu", what, "", "deg", values, errors, rule, least=least, remark=remark)


def _angle_between(
    one: ImuCalibration, other: ImuCalibration, *, unknown_deg: float = 30.0
) -> tuple[float, str]:
    """Angle between two mountings [rad], and what it is.

    The angle about one axis of the link may not be determined, `unknown_deg` being a standard error
    that says so: any value does, and it plays no part.
    """
    turn = np.array(other.rotation) @ np.array(one.rotation).T  # in the link's frame
    errors = [each.std_errors_deg for each in (one, other) if len(each.std_errors_deg) == 3]
    free = [k for k in range(3) if any(each[k] > unknown_deg for each in errors)]
    if len(free) == 1:
        k = free[0]
        across = math.hypot(*np.delete(turn[:, k], k))
        remark = f"angle between the link's {'xyz'[k]} in the two; about it neither is determined"
        return math.atan2(across, float(turn[k, k])), remark
    cosine = 0.5 * (float(np.trace(turn)) - 1.0)
    angle = math.atan2(float(np.linalg.norm(turn - turn.T)) / math.sqrt(8.0), cosine)
    return angle, "angle between the two mountings"


def _effects(
    a: Sequence[EffectOfJoint], b: Sequence[EffectOfJoint], rule: Rule
) -> Iterator[Difference]:
    left, right = ({(item.effect, item.joint or ""): item for item in side} for side in (a, b))
    for (effect, joint), one, other in _both(left, right):
        if one is None or other is None:
            yield missing("effects", effect, joint=joint, there=one is not None)
            continue
        prefix = f"{effect}: "
        yield from _parameters("effects", one.parameters, other.parameters, rule, prefix=prefix)
        stated = {parameter.name for parameter in (*one.parameters, *other.parameters)}
        for name in sorted(one.settings.keys() & other.settings.keys() - stated):
            values = (one.settings[name], other.settings[name])
            if all(isinstance(x, int | float) and not isinstance(x, bool) for x in values):
                numbers = (float(values[0]), float(values[1]))
                yield judged("effects", prefix + name, joint, "", numbers, None, rule)


def _predictions(a: PredictionFile, b: PredictionFile, rule: Rule) -> Iterator[Difference]:
    for joint, one, other in _both(a.joints, b.joints):
        if one is None or other is None:
            yield missing("prediction", "joint", joint=joint, there=one is not None)
            continue
        pairs = (("rmse", one.rmse, other.rmse), ("max_abs", one.max_abs, other.max_abs))
        yield from _optional("prediction", joint, pairs, a.robot, rule)


def _diagnoses(a: DiagnosisFile, b: DiagnosisFile, rule: Rule) -> Iterator[Difference]:
    if a.verdict != b.verdict:
        yield unlike("diagnosis", "verdict", "", f"{a.verdict}, then {b.verdict}")
    left, right = ({(f.effect, f.joint or ""): f for f in side.findings} for side in (a, b))
    for (effect, joint), before, after in _both(left, right):
        if before is None or after is None:
            yield missing("diagnosis", effect, joint=joint, there=before is not None)
    for joint, one, other in _both(a.joints, b.joints):
        if one and other:
            floors = ("noise_floor", one.noise_floor, other.noise_floor)
            pairs = (("rmse", one.rmse, other.rmse), floors)
            yield from _optional("diagnosis", joint, pairs, a.robot, rule)


def _optional(
    stage: str,
    joint: str,
    pairs: Iterable[tuple[str, float | None, float | None]],
    robot: RobotId,
    rule: Rule,
) -> Iterator[Difference]:
    """Judge numbers that either file may lack; yield nothing where both lack them."""
    for name, a, b in pairs:
        if a is not None and b is not None:
            yield judged(stage, name, joint, robot.unit("N m", joint), (a, b), None, rule)
        elif a is not None or b is not None:
            yield missing(stage, name, joint=joint, there=a is not None)


def _poor(verdicts: Sequence[Verdict]) -> dict[str, str]:
    """Why each joint is poor, empty where it is good: all verdicts on it must be."""
    reasons: dict[str, list[str]] = {}
    for verdict in verdicts:
        reasons.setdefault(verdict.joint, []).extend([] if verdict.good else [verdict.reason])
    return {joint: "; ".join(own) for joint, own in reasons.items()}


def _verdict_notes(a: Stages, b: Stages) -> list[str]:
    notes = []
    for name in ("friction", "gravity", "imu", "inertia"):
        one, other = getattr(a, name), getattr(b, name)
        if one is None or other is None:
            continue
        before, after = _poor(one.verdicts), _poor(other.verdicts)
        for joint, reason in after.items():
            if bool(before.get(joint, reason)) != bool(reason):
                now = f"poor: {reason}" if reason else "good"
                notes.append(f"{name}: the verdict on {joint or 'the stage'} is now {now}")
    return notes
