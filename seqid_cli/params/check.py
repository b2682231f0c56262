"""Checks of a parameter file beyond its types: shapes, ranges, names that refer to each other."""

from collections.abc import Iterable, Mapping, Sequence

from seqid_cli.errors import ConfigError
from seqid_cli.params import schema
from seqid_cli.params.evidence_schema import EvidenceEntry

SMALLEST = 1e-12  # what is divided by: smaller numbers overflow
_Problem = tuple[str, str]  # key, fault


def check_consistency(file: schema.ParameterFile, where: str) -> None:
    """Check a decoded parameter file.

    Raises
    ------
    ConfigError
        Two parts of the file contradict each other; the message names the key.
    """
    for key, what in _problems(file):
        hint = "The file was edited or damaged: run the stage again that wrote it."
        raise ConfigError(f"{key}: {what}", where=where, hint=hint)


def _problems(file: schema.ParameterFile) -> Iterable[_Problem]:
    joints, stages = file.robot.joints, file.stages
    if not joints or len(set(joints)) != len(joints):
        yield "$.robot.joints", "must name each joint of the robot once"
    if stages.friction is not None:
        for name, joint in stages.friction.joints.items():
            key = f"$.stages.friction.joints.{name}"
            yield from _known(key, name, joints)
            yield from _friction(key, joint)
    for stage, key in ((stages.gravity, "gravity"), (stages.inertia, "inertia")):
        if stage is not None:
            yield from _rigid(f"$.stages.{key}", stage, joints)
    if stages.imu is not None:
        for name, imu in stages.imu.imus.items():
            yield from _imu(f"$.stages.imu.imus.{name}", imu)
    for index, effect in enumerate(stages.effects or []):
        yield from _effect(f"$.stages.effects[{index}]", effect, joints)
    if file.closed_loop is not None:
        yield from _closed_loop("$.closed_loop", file.closed_loop, joints)


def _friction(key: str, joint: schema.FrictionJoint) -> Iterable[_Problem]:
    bases = {"chebyshev": joint.position_order + 1, "fourier": 2 * joint.position_order + 1}
    if joint.position_basis not in bases:
        yield f"{key}.position_basis", f"is {joint.position_basis!r}, none of {', '.join(bases)}"
        return
    rows, columns = bases[joint.position_basis], joint.velocity_order + 1
    for name, surface in (("positive", joint.positive), ("negative", joint.negative)):
        if not _has_shape(surface, rows, columns):
            yield f"{key}.{name}", f"must have {rows} rows of {columns} coefficients"
    ranges = (("position_range", joint.position_range), ("speed_range", joint.speed_range))
    for name, limits in ranges:
        if len(limits) != 2 or limits[0] > limits[1]:
            yield f"{key}.{name}", "must be two numbers, the smaller one first"
    if not joint.sign_width >= SMALLEST:
        yield f"{key}.sign_width", f"must be positive, is {joint.sign_width}"
    if 0.0 < abs(joint.speed_range[0]) < SMALLEST:
        yield f"{key}.speed_range", f"begins at {joint.speed_range[0]} rad/s"
    sizes = (rows * columns, 2 * rows * columns)
    if joint.covariance and not any(_has_shape(joint.covariance, n, n) for n in sizes):
        yield f"{key}.covariance", f"must be square with {sizes[0]} or {sizes[1]} rows"
    if not 0.0 <= joint.torque_constant_error < 1.0:
        yield f"{key}.torque_constant_error", "must be at least 0 and below 1"


def _rigid(key: str, stage: schema.RigidStage, joints: Sequence[str]) -> Iterable[_Problem]:
    count = len(stage.parameters)
    yield from _parameters(key, stage.parameters)
    for parameter in stage.parameters:
        yield from _known(f"{key}.parameters", parameter.joint, joints)
    if stage.covariance and not _has_shape(stage.covariance, count, count):
        yield f"{key}.covariance", f"must be square with {count} rows, one per parameter"
    yield from _errors(f"{key}.rmse", stage.rmse)
    for joint, moves in stage.torque_constant_moves.items():
        yield from _known(f"{key}.torque_constant_moves", joint, joints)
        if len(moves) != count:
            yield f"{key}.torque_constant_moves.{joint}", f"must be {count} numbers"


def _imu(key: str, imu: schema.ImuCalibration) -> Iterable[_Problem]:
    if not _has_shape(imu.rotation, 3, 3):
        yield f"{key}.rotation", "must have 3 rows of 3 numbers"
        return
    rows = imu.rotation
    for i, j in ((0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2)):
        product = sum(a * b for a, b in zip(rows[i], rows[j], strict=True))
        if abs(product - (i == j)) > 1e-6:
            yield f"{key}.rotation", f"is no rotation: rows {i + 1} and {j + 1} give {product:.6g}"


def _effect(key: str, effect: schema.EffectOfJoint, joints: Sequence[str]) -> Iterable[_Problem]:
    yield from _known(f"{key}.joint", effect.joint or "", joints)
    yield from _parameters(key, effect.parameters)
    count = len(effect.coefficients)
    if effect.covariance and not _has_shape(effect.covariance, count, count):
        yield f"{key}.covariance", f"must be square with {count} rows, one per coefficient"
    session = effect.session
    if session is not None and session.starts and len(session.starts) != len(session.logs):
        yield f"{key}.session.starts", f"must be {len(session.logs)} times, one per log"
    if session is not None and (session.origin is None) != (not session.starts):
        yield f"{key}.session.origin", "must be there if the starts are, and only then"


def _closed_loop(key: str, loop: schema.ClosedLoop, joints: Sequence[str]) -> Iterable[_Problem]:
    for name, rounds in (("rounds", loop.rounds), ("refused", loop.refused)):
        for index, tried in enumerate(rounds):
            yield from _known(f"{key}.{name}[{index}].joint", tried.joint or "", joints)
            yield from _interval(f"{key}.{name}[{index}].interval", tried.interval)
            where = f"{key}.{name}[{index}].training_interval"
            yield from _interval(where, tried.training_interval)
            if tried.evidence is not None:
                yield from _evidence(f"{key}.{name}[{index}].evidence", tried.evidence, joints)
            if tried.accepted != (name == "rounds"):
                yield f"{key}.{name}[{index}].accepted", f"contradicts its place in {name}"
    for name in ("before", "after", "noise_floor", "noise_floor_interval", "gain_interval"):
        for joint in getattr(loop, name):
            yield from _known(f"{key}.{name}", joint, joints)
    for name, shown in (("before", loop.before), ("after", loop.after)):
        yield from _errors(f"{key}.{name}", {joint: each.rmse for joint, each in shown.items()})
    for name in ("gain_interval", "noise_floor_interval"):
        for joint, interval in getattr(loop, name).items():
            yield from _interval(f"{key}.{name}.{joint}", interval)


def _evidence(key: str, shown: EvidenceEntry, joints: Sequence[str]) -> Iterable[_Problem]:
    for name in (shown.joint, shown.of):
        yield from _known(key, name, joints)
    if not shown.whole:
        yield key, "x, count, before and after must be of one length"


def _interval(key: str, interval: Sequence[float]) -> Iterable[_Problem]:
    if interval and (len(interval) != 2 or interval[0] > interval[1]):
        yield key, "must be two numbers, the smaller one first"


def _errors(key: str, errors: Mapping[str, float | None]) -> Iterable[_Problem]:
    for joint, error in errors.items():
        if error is not None and error < 0.0:
            yield f"{key}.{joint}", f"an RMS error must not be negative, is {error}"


def _parameters(key: str, parameters: Sequence[schema.Parameter]) -> Iterable[_Problem]:
    for index, parameter in enumerate(parameters):
        if parameter.std_error < 0.0:
            yield f"{key}.parameters[{index}].std_error", "must not be negative"


def _known(key: str, name: str, joints: Sequence[str]) -> Iterable[_Problem]:
    if name and name not in joints:
        yield key, f"joint {name!r} is none of the robot's: {', '.join(joints)}"


def _has_shape(matrix: schema.Matrix, rows: int, columns: int) -> bool:
    return len(matrix) == rows and all(len(row) == columns for row in matrix)
