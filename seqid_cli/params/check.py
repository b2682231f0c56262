"""Checks of documents beyond their types: shapes, ranges, and names of joints."""

from collections.abc import Callable, Iterator, Mapping
from operator import mul
from typing import Any

import msgspec

from seqid_cli.errors import ConfigError
from seqid_cli.params import schema
from seqid_cli.params.bands_schema import JointBand
from seqid_cli.params.evidence_schema import EvidenceEntry

SMALLEST = 1e-12  # of divisors: by smaller numbers results overflow
_Problem = tuple[str, str]  # key, fault
# Fields that name joints, themselves or by their keys.
_OF_JOINTS = frozenset(
    {
        "joint",
        "joints",
        "of",
        "before",
        "after",
        "torque_constant_moves",
        "noise_floor",
        "noise_floor_interval",
        "gain_interval",
    }
)
# Fields of two numbers, the smaller one first.
_RANGES = frozenset({"position_range", "speed_range"})
# The same, or empty.
_INTERVALS = frozenset(
    {"interval", "training_interval", "gain_interval", "noise_floor_interval"}
)


def check_consistency(document: schema.OfRobot, where: str) -> None:
    """Raise ConfigError where two parts of a document contradict each other.

    `where` is its path, for the message.
    """
    for key, fault in _problems(document):
        hint = "The file was edited or damaged: run the command again that wrote it."
        raise ConfigError(f"{key}: {fault}", where=where, hint=hint)


def _problems(document: schema.OfRobot) -> Iterator[_Problem]:
    """Yield all faults of a document."""
    joints = document.robot.joints
    if isinstance(document, schema.ParameterFile):
        is_unique = len(joints) == len(set(joints))
        if not joints or not is_unique:
            yield "$.robot.joints", "must name each joint of the robot once"
    for key, struct in _structs("$", document):
        for name in struct.__struct_fields__:
            value = getattr(struct, name)
            # A verdict may be about an IMU.
            if name in _OF_JOINTS and not isinstance(struct, schema.Verdict):
                yield from _names(f"{key}.{name}", value, joints)
            entries = value if isinstance(value, Mapping) else {"": value}
            for entry_name, entry in entries.items():
                entry_key = f"{key}.{name}.{entry_name}".removesuffix(".")
                yield from _numbers(entry_key, name, entry)
        check = _CHECKS.get(type(struct))
        if check is not None:
            yield from check(key, struct)


def _structs(key: str, value: object) -> Iterator[tuple[str, msgspec.Struct]]:
    """Yield all structures of a document, each with its key's full path."""
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


def _names(key: str, value: Any, joints: list[str]) -> Iterator[_Problem]:
    """Yield names that are none of the robot's joints; "" is of the whole arm."""
    names = value if isinstance(value, Mapping | list) else [value]
    for name in names:
        if isinstance(name, str) and name and name not in joints:
            listed = ", ".join(joints)
            yield key, f"joint {name!r} is none of the robot's: {listed}"


def _numbers(key: str, name: str, value: Any) -> Iterator[_Problem]:
    """Yield faults of numbers that the field's name says enough of."""
    is_range = name in _RANGES or (name in _INTERVALS and value)
    if is_range and not (len(value) == 2 and value[0] <= value[1]):
        yield key, "must be two numbers, the smaller one first"
    if name in ("std_error", "rmse") and isinstance(value, float) and value < 0.0:
        yield key, f"must not be negative, is {value}"


def _friction(key: str, joint: schema.FrictionJoint) -> Iterator[_Problem]:
    # Imported here because it imports numpy: other faults of a file are told first.
    from seqid_cli.position_families import FAMILIES, family_named

    family = family_named(joint.position_basis)
    if family is None:
        listed = ", ".join(family.name for family in FAMILIES)
        fault = f"is {joint.position_basis!r}, none of {listed}"
        yield f"{key}.position_basis", fault
        return
    rows = family.size(joint.position_order)
    columns = joint.velocity_order + 1
    for name, surface in (("positive", joint.positive), ("negative", joint.negative)):
        if not _has_shape(surface, rows, columns):
            yield f"{key}.{name}", f"must have {rows} rows of {columns} coefficients"

    if not joint.sign_width >= SMALLEST:
        yield f"{key}.sign_width", f"must be positive, is {joint.sign_width}"
    if 0.0 < abs(joint.speed_range[0]) < SMALLEST:
        yield f"{key}.speed_range", f"begins at {joint.speed_range[0]} rad/s"
    # Of one surface for both directions, or of two.
    entries = rows * columns * (2 if joint.directional else 1)
    if not _has_shape(joint.covariance, entries, entries):
        yield f"{key}.covariance", f"must be square with {entries} rows"
    elif not _may_be_covariance(joint.covariance):
        yield f"{key}.covariance", "must have its largest number on the diagonal"
    if not 0.0 <= joint.torque_constant_error < 1.0:
        yield f"{key}.torque_constant_error", "must be at least 0 and below 1"
    if joint.law_error < 0.0:
        yield f"{key}.law_error", "must be at least 0"
    for place, level in enumerate(joint.speeds):
        if not _has_shape(level.points, len(level.points), 4):
            yield f"{key}.speeds[{place}].points", "must have rows of 4 numbers"


def _rigid(key: str, stage: schema.RigidStage) -> Iterator[_Problem]:
    count = len(stage.parameters)
    yield from _square(key, stage.covariance, count)
    for joint, moves in stage.torque_constant_moves.items():
        if len(moves) != count:
            yield f"{key}.torque_constant_moves.{joint}", f"must be {count} numbers"
    for name, moves in stage.tolerance_moves.items():
        if len(moves) != count:
            yield f"{key}.tolerance_moves.{name}", f"must be {count} numbers"
    if stage.nuisance_covariance:
        yield from _square(key, stage.nuisance_covariance, count + len(stage.nuisances))


def _band(key: str, band: JointBand) -> Iterator[_Problem]:
    order = [(cell.fast, cell.loaded) for cell in band.cells]
    if order != [(False, False), (False, True), (True, False), (True, True)]:
        fault = "must be slow and light, slow and loaded, fast and light, both"
        yield f"{key}.cells", fault
    if any(cell.factor <= 0.0 for cell in band.cells):
        yield f"{key}.cells", "must have positive factors"
    if band.left_std < 0.0:
        yield f"{key}.left_std", f"must not be negative, is {band.left_std}"


def _imu(key: str, imu: schema.ImuCalibration) -> Iterator[_Problem]:
    if not _has_shape(imu.rotation, 3, 3):
        yield f"{key}.rotation", "must have 3 rows of 3 numbers"
        return
    for i, j in ((0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2)):
        product = sum(map(mul, imu.rotation[i], imu.rotation[j]))
        expected = 1.0 if i == j else 0.0
        if abs(product - expected) > 1e-6:
            fault = f"is no rotation: rows {i + 1} and {j + 1} give {product:.6g}"
            yield f"{key}.rotation", fault


def _effect(key: str, effect: schema.EffectOfJoint) -> Iterator[_Problem]:
    yield from _square(key, effect.covariance, len(effect.coefficients))


def _session(key: str, session: schema.EffectSession) -> Iterator[_Problem]:
    if session.starts and len(session.starts) != len(session.logs):
        yield f"{key}.starts", f"must be {len(session.logs)} times, one per log"
    if (session.origin is None) != (not session.starts):
        yield f"{key}.origin", "must be there if the starts are, and only then"


def _closed_loop(key: str, loop: schema.ClosedLoop) -> Iterator[_Problem]:
    lists = {
        "rounds": loop.rounds,
        "unconfirmed": loop.unconfirmed,
        "refused": loop.refused,
    }
    for name, tried in lists.items():
        fault = f"contradicts its place in {name}"
        for index, item in enumerate(tried):
            if item.accepted != (name != "refused"):
                yield f"{key}.{name}[{index}].accepted", fault
            if name == "unconfirmed" and item.confirmed:
                yield f"{key}.{name}[{index}].confirmed", fault


def _evidence(key: str, evidence: EvidenceEntry) -> Iterator[_Problem]:
    lengths = {
        len(evidence.x),
        len(evidence.count),
        len(evidence.before),
        len(evidence.before_spread),
    }
    # Of a push nothing can be taken off.
    if evidence.after or evidence.after_spread:
        lengths |= {len(evidence.after), len(evidence.after_spread)}
    if len(lengths) > 1:
        yield key, "x, count, before and after must be of one length"


def _square(key: str, covariance: schema.Matrix, size: int) -> Iterator[_Problem]:
    """Yield that a covariance which is there has another size."""
    if covariance and not _has_shape(covariance, size, size):
        yield f"{key}.covariance", f"must be square with {size} rows"


def _may_be_covariance(matrix: schema.Matrix, *, rounding: float = 1e-3) -> bool:
    """Return whether no covariance is larger than the largest variance."""
    largest = max(max(map(abs, row)) for row in matrix)
    variance = max(row[k] for k, row in enumerate(matrix))
    return largest <= (1.0 + rounding) * variance


def _has_shape(matrix: schema.Matrix, rows: int, columns: int) -> bool:
    return len(matrix) == rows and all(len(row) == columns for row in matrix)


_CHECKS: Mapping[type, Callable[[str, Any], Iterator[_Problem]]] = {
    schema.FrictionJoint: _friction,
    schema.RigidStage: _rigid,
    JointBand: _band,
    schema.ImuCalibration: _imu,
    schema.EffectOfJoint: _effect,
    schema.EffectSession: _session,
    schema.ClosedLoop: _closed_loop,
    EvidenceEntry: _evidence,
}
