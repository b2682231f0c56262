"""Which columns of a table belong to an IMU."""

from collections.abc import Collection

from seqid_cli.errors import InputError
from seqid_cli.robot.types import Imu, Robot

# Forms of names: numbered accelerometers, the axes of a triad, the axes of a gyro.
_FORMS = (
    ("{imu}.a{k}", "{imu}.a{axis}", "{imu}.g{axis}"),
    ("{imu}/a{k}", "{imu}/a{axis}", "{imu}/g{axis}"),
    ("{imu}_a{k}", "{imu}_a{axis}", "{imu}_g{axis}"),
    *(
        ("", f"{stem}linear_acceleration{end}", f"{stem}angular_velocity{end}")
        for stem, end in (("{imu}.", ".{axis}"), ("{imu}/", "/{axis}"), ("/{imu}/data/", "/{axis}"))
    ),
)


def imu_columns(
    where: str, robot: Robot, imu: Imu, known: Collection[str], warnings: list[str]
) -> tuple[list[str], list[str]] | None:
    """Find the accelerometer and gyro columns of an IMU; None where the log has none of them."""
    for numbered, axes, gyro in _FORMS:
        found = _form(where, imu, known, numbered, axes, gyro)
        if found is not None:
            return found
    return _tool_accelerometer(robot, imu, known, warnings)


def _form(
    where: str, imu: Imu, known: Collection[str], numbered: str, axes: str, gyro: str
) -> tuple[list[str], list[str]] | None:
    count = len(imu.positions)
    by_number = [_fill(numbered, imu, k=k + 1) for k in range(count)] if numbered else []
    use_triad = not by_number or (count == 3 and not set(known).intersection(by_number))
    if use_triad and count != 3:
        return None
    accelerometers = [_fill(axes, imu, axis=axis) for axis in "xyz"] if use_triad else by_number
    rates = [_fill(gyro, imu, axis=axis) for axis in "xyz"] if imu.gyro else []
    missing = [name for name in accelerometers + rates if name not in known]
    if len(missing) == len(accelerometers) + len(rates):
        return None
    if missing:
        raise InputError(
            f"IMU {imu.name!r} is only partly in the log; missing: {', '.join(missing)}",
            hint=f"The robot file gives it {count} accelerometers"
            f"{' and a gyro' if imu.gyro else ''}: log them all, or correct the robot file.",
            where=where,
        )
    return accelerometers, rates


def _fill(form: str, imu: Imu, *, k: int = 0, axis: str = "") -> str:
    filled = form.replace("{k}", str(k)).replace("{axis}", axis)
    return filled.replace("{imu}", imu.name)


def _tool_accelerometer(
    robot: Robot, imu: Imu, known: Collection[str], warnings: list[str]
) -> tuple[list[str], list[str]] | None:
    """UR's own accelerometer, for a triad of the robot file that rides on the last link."""
    names = [f"actual_tool_accelerometer_{axis}" for axis in range(3)]
    last = imu.after_joint == robot.n - 1 and len(imu.positions) == 3 and not imu.gyro
    if not last or any(name not in known for name in names):
        return None
    warnings.append(f"IMU {imu.name!r} is read from {names[0]} ... {names[-1]}")
    return names, []
