"""The columns of an IMU in a table, by the forms of names that loggers give them."""

from collections.abc import Collection
from dataclasses import dataclass

from seqid_cli.logs.raw import partly_logged
from seqid_cli.robot.types import Imu, Robot


@dataclass(frozen=True)
class ImuColumns:
    """Columns of one IMU."""

    accelerometers: list[str]  # in the order of the robot file
    gyro: list[str]  # x, y, z; empty where the robot file gives it none


@dataclass(frozen=True)
class _Form:
    """Forms of names; `{of}` is an accelerometer's number, or an axis of a triad."""

    accelerometer: str
    gyro: str


_FORMS = (
    _Form("{imu}.a{of}", "{imu}.g{of}"),
    _Form("{imu}/a{of}", "{imu}/g{of}"),
    _Form("{imu}_a{of}", "{imu}_g{of}"),
    # Messages of type sensor_msgs/Imu, as PlotJuggler and others write them.
    _Form("{imu}.linear_acceleration.{of}", "{imu}.angular_velocity.{of}"),
    _Form("{imu}/linear_acceleration/{of}", "{imu}/angular_velocity/{of}"),
    _Form("/{imu}/data/linear_acceleration/{of}", "/{imu}/data/angular_velocity/{of}"),
)


def imu_columns(
    where: str,
    robot: Robot,
    imu: Imu,
    log_columns: Collection[str],
    warnings: list[str],
) -> ImuColumns | None:
    """Find the accelerometer and gyro columns of an IMU.

    Parameters
    ----------
    where : str
        The log, for messages.
    log_columns : collection of str
        Its columns.
    warnings : list of str
        A note on another source of the readings is added to it.

    Returns
    -------
    ImuColumns or None
        None where the log has none of them.

    Raises
    ------
    InputError
        The log has some of them only.
    """
    for form in _FORMS:
        columns = _filled(form, imu, log_columns)
        names = columns.accelerometers + columns.gyro
        missing = [name for name in names if name not in log_columns]
        if not missing:
            return columns
        if len(missing) < len(names):
            raise partly_logged(imu, missing, where)

    # UR's own accelerometer, for a triad of the robot file that rides on the last link.
    names = [f"actual_tool_accelerometer_{axis}" for axis in range(3)]
    is_on_last_link = imu.after_joint == robot.n - 1
    is_triad = len(imu.positions) == 3 and not imu.gyro
    if not (is_on_last_link and is_triad and set(names) <= set(log_columns)):
        return None
    warnings.append(f"IMU {imu.name!r} is read from {names[0]} ... {names[-1]}")
    return ImuColumns(names, [])


def _filled(form: _Form, imu: Imu, log_columns: Collection[str]) -> ImuColumns:
    """Fill a form for an IMU; three accelerometers without numbers are axes."""
    count = len(imu.positions)
    accelerometers = [
        form.accelerometer.format(imu=imu.name, of=k + 1) for k in range(count)
    ]
    if count == 3 and not set(log_columns).intersection(accelerometers):
        accelerometers = [
            form.accelerometer.format(imu=imu.name, of=axis) for axis in "xyz"
        ]
    gyro = []
    if imu.gyro:
        gyro = [form.gyro.format(imu=imu.name, of=axis) for axis in "xyz"]
    return ImuColumns(accelerometers, gyro)
