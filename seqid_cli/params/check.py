"""Checks of documents beyond their types: shapes, ranges, names that refer to each other."""

from collections.abc import Callable, Iterator, Mapping
from operator import mul
from typing import Any

import msgspec

from seqid_cli.errors import ConfigError
from seqid_cli.params import schema
from seqid_cli.params.bands_schema import JointBand
from seqid_cli.params.evidence_schema import EvidenceEntry

SMALLEST = 1e-12  # what is divided by: smaller numbers overflow
_Problem = tuple[str, str]  # key, fault
# Fields that name joints, themselves or by their keys; a verdict may be about an IMU.
_OF_JOINTS = {
    "joint",
    "joints",
    "of",
    "before",
    "after",
    "torque_constant_moves",
    "noise_floor",
}
_OF_JOINTS |= {"noise_floor_interval", "gain_interval"}
# or empty
_INTERVALS = ("interval", "training_interval", "gain_interval", "noise_floor_interval")


def check_consistency(document: schema.OfRobot, where: str) -> None:
    """Raise ConfigError where two parts of a document about a robot contradict each other."""
    for key, what in _problems(document):
        hint = "The file was edited or damaged: run the command again that wrote it."
        raise ConfigError(f"{key}: {what}", where=where, hint=hint)


def _problems(document: schema.OfRobot) -> Iterator[_Problem]:
    joints = document.robot.joints
    if isinstance(document, schema.ParameterFile) and not 0 < len(joints) == len(
        set(joints)
    ):
        yield "$.robot.joints", "must name each joint of the robot once"
    for key, struct in _structs("$", document):
        for name in struct.__struct_fields__:
            value = getattr(struct, name)
            if name in _OF_JOINTS and not isinstance(struct, schema.Verdict):
                for joint in value if isinstance(value, Mapping | list) else [value]:
                    if isinstance(joint, str) and joint and joint not in joints:
                        what = (
                            f"joint {joint!r} is none of the robot's:"
                            f" {', '.join(joints)}"
                        )
                        yield f"{key}.{name}", what
            entries = value if isinstance(value, Mapping) else {"": value}
            for own, entry in entries.items():
                yield from _numbers(
                    f"{key}.{name}.{own}".removesuffix("."), name, entry
                )
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


def _numbers(key: str, name: str, value: Any) -> Iterator[_Problem]:
    pair = name in ("position_range", "speed_range") or (name in _INTERVALS and value)
    if pair and not (len(value) == 2 and value[0] <= value[1]):
        yield key, "must be two numbers, the smaller one first"
    if name in ("std_error", "rmse") and isinstance(value, float) and value < 0.0:
        yield key, f"must not be negative, is {value}"


def _friction(key: str, joint: schema.FrictionJoint) -> Iterator[_Problem]:
    bases = {
        "chebyshev": joint.position_order + 1,
        "fourier": 2 * joint.position_order + 1,
    }
    if joint.position_basis not in bases:
        yield (
            f"{key}.position_basis",
            f"is {joint.position_basis!r}, none of {', '.join(bases)}",
        )
        return
    rows, columns = bases[joint.position_basis], joint.velocity_order + 1
    for name, surface in (("positive", joint.positive), ("negative", joint.negative)):
        if not _has_shape(surface, rows, columns):
            yield f"{key}.{name}", f"must have {rows} rows of {columns} coefficients"
    if not joint.sign_width >= SMALLEST:
        yield f"{key}.sign_width", f"must be positive, is {joint.sign_width}"
    if 0.0 < abs(joint.speed_range[0]) < SMALLEST:
        yield f"{key}.speed_range", f"begins at {joint.speed_range[0]} rad/s"
    yield from _square(key, joint.covariance, rows * columns, 2 * rows * columns)
    if not 0.0 <= joint.torque_constant_error < 1.0:
        yield f"{key}.torque_constant_error", "must be at least 0 and below 1"


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
        yield (
            f"{key}.cells",
            "must be slow and light, slow and loaded, fast and light, both",
        )
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
        if abs(product - (i == j)) > 1e-6:
            yield (
                f"{key}.rotation",
                f"is no rotation: rows {i + 1} and {j + 1} give {product:.6g}",
            )


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
        for index, each in enumerate(tried):
            if each.accepted != (name != "refused"):
                yield (
                    f"{key}.{name}[{index}].accepted",
                    f"contradicts its place in {name}",
                )
            if name == "unconfirmed" and each.confirmed:
                yield (
                    f"{key}.{name}[{index}].confirmed",
                    f"contradicts its place in {name}",
                )


def _evidence(key: str, shown: EvidenceEntry) -> Iterator[_Problem]:
    lengths = {
        len(shown.x),
        len(shown.count),
        len(shown.before),
        len(shown.before_spread),
    }
    if shown.after or shown.after_spread:
        lengths |= {len(shown.after), len(shown.after_spread)}
    if len(lengths) > 1:
        yield key, "x, count, before and after must be of one length"


def _square(key: str, covariance: schema.Matrix, *sizes: int) -> Iterator[_Problem]:
    if covariance and not any(_has_shape(covariance, size, size) for size in sizes):
        yield (
            f"{key}.covariance",
            f"must be square with {' or '.join(map(str, sizes))} rows",
        )


def _has_shape(matrix: schema.Matrix, rows: int, columns: int) -> bool:
    return len(matrix) == rows and all(len(row) == columns for row in matrix)


_CHECKS: Mapping[type, Callable[[str, Any], Iterator[_Problem]]] = {
    schema.FrictionJoint: _friction,
    schema.RigidStage: _rigid,
    JointBand: _band,
    schema.ImuCalibration: _imu,
    schema.EffectOfJoint: lambda key, own: _square(
        key, own.covariance, len(own.coefficients)
    ),
    schema.EffectSession: _session,
    schema.ClosedLoop: _closed_loop,
    EvidenceEntry: _evidence,
}
