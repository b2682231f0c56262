"""Checks of documents beyond their types: shapes, ranges, names that refer to each other."""

from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import Any

import msgspec

from seqid_cli.errors import ConfigError
from seqid_cli.params import schema
from seqid_cli.params.evidence_schema import EvidenceEntry, RefinementRound
from seqid_cli.params.results.diagnosis import DiagnosisFile, FindingEntry, UnexplainedPart
from seqid_cli.params.results.prediction import LogPredictionError, PredictionFile

SMALLEST = 1e-12  # what is divided by: smaller numbers overflow
_Problem = tuple[str, str]  # key, fault
_ORDERED = "must be two numbers, the smaller one first"


def check_consistency(document: schema.OfRobot, where: str) -> None:
    """Check a decoded document about a robot.

    Raises ConfigError: two parts of the document contradict each other; the message names the key.
    """
    for key, what in _problems(document):
        hint = "The file was edited or damaged: run the command again that wrote it."
        raise ConfigError(f"{key}: {what}", where=where, hint=hint)


def _problems(document: schema.OfRobot) -> Iterator[_Problem]:
    joints = document.robot.joints
    if isinstance(document, schema.ParameterFile) and not 0 < len(joints) == len(set(joints)):
        yield "$.robot.joints", "must name each joint of the robot once"
    for key, struct in _structs("$", document):
        for field in _JOINTS.get(type(struct), ()):
            named = getattr(struct, field)
            for name in [named] if isinstance(named, str) else named or ():
                if name and name not in joints:
                    what = f"joint {name!r} is none of the robot's: {', '.join(joints)}"
                    yield f"{key}.{field}", what
        check = _CHECKS.get(type(struct))
        yield from check(key, struct) if check else ()


def _structs(key: str, value: object) -> Iterator[tuple[str, msgspec.Struct]]:
    """All structures of a document, each with its key's full path."""
    if isinstance(value, msgspec.Struct):
        yield key, value
        for name in value.__struct_fields__:
            yield from _structs(f"{key}.{name}", getattr(value, name))
    elif isinstance(value, Mapping):
        for name, item in value.items():
            yield from _structs(f"{key}.{name}", item)
    elif isinstance(value, list) and value and isinstance(value[0], msgspec.Struct):
        for index, item in enumerate(value):
            yield from _structs(f"{key}[{index}]", item)


def _friction(key: str, joint: schema.FrictionJoint) -> Iterator[_Problem]:
    bases = {"chebyshev": joint.position_order + 1, "fourier": 2 * joint.position_order + 1}
    if joint.position_basis not in bases:
        yield f"{key}.position_basis", f"is {joint.position_basis!r}, none of {', '.join(bases)}"
        return
    rows, columns = bases[joint.position_basis], joint.velocity_order + 1
    for name, surface in (("positive", joint.positive), ("negative", joint.negative)):
        if not _has_shape(surface, rows, columns):
            yield f"{key}.{name}", f"must have {rows} rows of {columns} coefficients"
    for name in ("position_range", "speed_range"):
        yield from _interval(f"{key}.{name}", getattr(joint, name) or [0.0])
    if not joint.sign_width >= SMALLEST:
        yield f"{key}.sign_width", f"must be positive, is {joint.sign_width}"
    if 0.0 < abs(joint.speed_range[0]) < SMALLEST:
        yield f"{key}.speed_range", f"begins at {joint.speed_range[0]} rad/s"
    sizes = (rows * columns, 2 * rows * columns)
    if joint.covariance and not any(_has_shape(joint.covariance, n, n) for n in sizes):
        yield f"{key}.covariance", f"must be square with {sizes[0]} or {sizes[1]} rows"
    if not 0.0 <= joint.torque_constant_error < 1.0:
        yield f"{key}.torque_constant_error", "must be at least 0 and below 1"


def _parameter(key: str, parameter: schema.Parameter) -> Iterator[_Problem]:
    if parameter.std_error < 0.0:
        yield f"{key}.std_error", "must not be negative"


def _rigid(key: str, stage: schema.RigidStage) -> Iterator[_Problem]:
    count = len(stage.parameters)
    if stage.covariance and not _has_shape(stage.covariance, count, count):
        yield f"{key}.covariance", f"must be square with {count} rows, one per parameter"
    yield from _errors(f"{key}.rmse", stage.rmse)
    for joint, moves in stage.torque_constant_moves.items():
        if len(moves) != count:
            yield f"{key}.torque_constant_moves.{joint}", f"must be {count} numbers"


def _imu(key: str, imu: schema.ImuCalibration) -> Iterator[_Problem]:
    if not _has_shape(imu.rotation, 3, 3):
        yield f"{key}.rotation", "must have 3 rows of 3 numbers"
        return
    rows = imu.rotation
    for i, j in ((0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2)):
        product = sum(a * b for a, b in zip(rows[i], rows[j], strict=True))
        if abs(product - (i == j)) > 1e-6:
            yield f"{key}.rotation", f"is no rotation: rows {i + 1} and {j + 1} give {product:.6g}"


def _effect(key: str, effect: schema.EffectOfJoint) -> Iterator[_Problem]:
    count, session = len(effect.coefficients), effect.session
    if effect.covariance and not _has_shape(effect.covariance, count, count):
        yield f"{key}.covariance", f"must be square with {count} rows, one per coefficient"
    if session is not None and session.starts and len(session.starts) != len(session.logs):
        yield f"{key}.session.starts", f"must be {len(session.logs)} times, one per log"
    if session is not None and (session.origin is None) != (not session.starts):
        yield f"{key}.session.origin", "must be there if the starts are, and only then"


def _closed_loop(key: str, loop: schema.ClosedLoop) -> Iterator[_Problem]:
    for name in ("rounds", "refused"):
        for index, tried in enumerate(getattr(loop, name)):
            if tried.accepted != (name == "rounds"):
                yield f"{key}.{name}[{index}].accepted", f"contradicts its place in {name}"
    for name in ("before", "after"):
        rmse = {joint: each.rmse for joint, each in getattr(loop, name).items()}
        yield from _errors(f"{key}.{name}", rmse)
    for name in ("gain_interval", "noise_floor_interval"):
        for joint, interval in getattr(loop, name).items():
            yield from _interval(f"{key}.{name}.{joint}", interval)


def _round(key: str, tried: RefinementRound) -> Iterator[_Problem]:
    yield from _interval(f"{key}.interval", tried.interval)
    yield from _interval(f"{key}.training_interval", tried.training_interval)


def _evidence(key: str, shown: EvidenceEntry) -> Iterator[_Problem]:
    if not shown.whole:
        yield key, "x, count, before and after must be of one length"


def _interval(key: str, interval: Sequence[float]) -> Iterator[_Problem]:
    if interval and (len(interval) != 2 or interval[0] > interval[1]):
        yield key, _ORDERED


def _errors(key: str, errors: Mapping[str, float]) -> Iterator[_Problem]:
    for joint, error in errors.items():
        if error < 0.0:
            yield f"{key}.{joint}", f"an RMS error must not be negative, is {error}"


def _has_shape(matrix: schema.Matrix, rows: int, columns: int) -> bool:
    return len(matrix) == rows and all(len(row) == columns for row in matrix)


_CHECKS: Mapping[type, Callable[[str, Any], Iterator[_Problem]]] = {
    schema.FrictionJoint: _friction,
    schema.Parameter: _parameter,
    schema.RigidStage: _rigid,
    schema.ImuCalibration: _imu,
    schema.EffectOfJoint: _effect,
    schema.ClosedLoop: _closed_loop,
    RefinementRound: _round,
    EvidenceEntry: _evidence,
}
# Where documents name joints: in a field, or as the keys of a dictionary in it.
_JOINTS: Mapping[type, Sequence[str]] = {
    schema.FrictionStage: ("joints",),
    schema.Parameter: ("joint",),
    schema.RigidStage: ("torque_constant_moves",),
    schema.EffectOfJoint: ("joint",),
    RefinementRound: ("joint",),
    schema.ClosedLoop: (
        "before", "after", "noise_floor", "noise_floor_interval", "gain_interval"
    ),
    EvidenceEntry: ("joint", "of"),
    FindingEntry: ("joint",),
    UnexplainedPart: ("joint",),
    DiagnosisFile: ("joints",),
    PredictionFile: ("joints",),
    LogPredictionError: ("joints",),
}  # fmt: skip
