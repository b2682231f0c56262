"""The files of each robot in the order of their dates, and every quantity over them.

Robots can be compared by parameters, and by friction at speeds that all of them share.
"""

from collections.abc import Iterator, Mapping, Sequence
from datetime import UTC, datetime
from typing import NamedTuple

import numpy as np

from seqid_cli.errors import ConfigError, UsageError
from seqid_cli.model.friction import SLIDES, FrictionSurface
from seqid_cli.params.dates import recorded_date
from seqid_cli.params.files import By, by_robot
from seqid_cli.params.results.trend import SeriesEntry
from seqid_cli.params.schema import FrictionJoint, ParameterFile, Stages
from seqid_cli.robot.types import Array
from seqid_cli.units import unit_of

Named = tuple[str, ParameterFile]  # with its path


class Quantity(NamedTuple):
    """A number that a robot can be compared by."""

    stage: str
    joint: str
    name: str
    unit: str


class Estimate(NamedTuple):
    """A quantity at one date; its temperature [degC] is NaN where none was logged."""

    value: float
    std_error: float
    temperature: float


def robots_of(files: Sequence[Named], by: By) -> dict[str, list[ParameterFile]]:
    """Return the files of each robot in the order of their dates.

    Parameters
    ----------
    files : sequence of (path, ParameterFile)
        Files of one or more robots in any order.
    by : {"name", "folder"}
        What tells robots apart.

    Raises
    ------
    UsageError
        Files of one robot have different joints, or no robot has two files.
    ConfigError
        The date of a file is none.
    """
    robots = by_robot(
        [(path, file.robot.name, (path, file)) for path, file in files], by
    )
    for name, dated in robots.items():
        dated.sort(key=lambda item: _time(recorded_date(item[1]), item[0]))
        _check_joints(name, dated)
    if all(len(dated) < 2 for dated in robots.values()):
        hint = (
            "Give results of several dates; --by folder tells robots of one name apart."
        )
        raise UsageError("no robot has two parameter files", hint=hint)
    return {name: [file for _, file in dated] for name, dated in robots.items()}


def _check_joints(name: str, files: Sequence[Named]) -> None:
    """Raise UsageError where files of a robot have other joints than the first."""
    first_path, first = files[0]
    for path, file in files[1:]:
        if file.robot.joints != first.robot.joints:
            message = (
                f"has other joints than {first_path}, but both are of robot {name!r}"
            )
            hint = "Tell the robots apart by --by folder, or give files of one arm."
            raise UsageError(message, where=path, hint=hint)


def days_of(dates: Sequence[str]) -> Array:
    """Return the time (T,) in days since the first date."""
    times_s = np.array([_time(date) for date in dates])
    return np.asarray((times_s - times_s[0]) / 86400.0)


def _time(date: str, path: str = "") -> float:
    """Return a date as a Unix time [s]; in UTC where it names no zone."""
    try:
        when = datetime.fromisoformat(date)
    except ValueError as error:
        message = f"$.created: {date!r} is no date"
        hint = "Write it as 2026-01-31T12:00:00Z."
        raise ConfigError(message, where=path, hint=hint) from error
    if when.tzinfo is None:
        when = when.replace(tzinfo=UTC)
    return when.timestamp()


def series_of(robot: str, files: Sequence[ParameterFile]) -> Iterator[SeriesEntry]:
    """Yield every quantity of a robot that at least two of its files hold."""
    speeds = _shared_speeds(files)
    tables = [dict(_estimates(file.stages, speeds)) for file in files]
    quantities = dict.fromkeys(quantity for table in tables for quantity in table)

    for quantity in quantities:
        dates = []
        estimates = []
        for file, table in zip(files, tables, strict=True):
            if quantity in table:
                dates.append(recorded_date(file))
                estimates.append(table[quantity])
        if len(dates) < 2:
            continue

        # Without the temperature of every date friction cannot be corrected by it.
        temperatures = [estimate.temperature for estimate in estimates]
        if not np.isfinite(temperatures).all():
            temperatures = []
        yield SeriesEntry(
            robot=robot,
            stage=quantity.stage,
            joint=quantity.joint,
            name=quantity.name,
            unit=quantity.unit,
            dates=dates,
            values=[estimate.value for estimate in estimates],
            std_errors=[estimate.std_error for estimate in estimates],
            temperatures=temperatures,
        )


def _estimates(
    stages: Stages, speeds: Mapping[str, Array]
) -> Iterator[tuple[Quantity, Estimate]]:
    """Yield the estimates of one file, of friction at the `speeds` [rad/s; m/s]."""
    for joint, surface in _surfaces(stages).items():
        temperature = np.nan if surface.temperature is None else surface.temperature
        speed_unit = unit_of("rad/s", surface.unit == "N")
        for speed in speeds.get(joint, ()):
            name = f"at {speed:.3g} {speed_unit}"
            value, std_error = _mean_friction(surface, float(speed))
            quantity = Quantity("friction", joint, name, surface.unit)
            yield quantity, Estimate(value, std_error, temperature)

    for stage_name, stage in (("gravity", stages.gravity), ("inertia", stages.inertia)):
        if stage is None:
            continue
        for p in stage.parameters:
            if p.std_error is None:
                continue  # it says nothing of the robot
            quantity = Quantity(stage_name, p.joint, p.name, p.unit)
            yield quantity, Estimate(p.value, p.std_error, np.nan)


def _surfaces(stages: Stages) -> Mapping[str, FrictionJoint]:
    """Return the friction surfaces of a file by joint."""
    return stages.friction.joints if stages.friction else {}


def _shared_speeds(
    files: Sequence[ParameterFile], *, speeds: int = 3
) -> dict[str, Array]:
    """Return speeds (S,) by joint [rad/s; m/s] at which all files know its friction."""
    slowest: dict[str, float] = {}
    fastest: dict[str, float] = {}
    for file in files:
        for joint, surface in _surfaces(file.stages).items():
            low, high = surface.speed_range
            # Slower than this the joint does not certainly slide.
            low = max(low, SLIDES * surface.sign_width)
            slowest[joint] = max(slowest.get(joint, low), low)
            fastest[joint] = min(fastest.get(joint, high), high)
    return {
        joint: np.linspace(slowest[joint], fastest[joint], speeds)
        for joint in slowest
        if slowest[joint] < fastest[joint]
    }


def _mean_friction(
    joint: FrictionJoint, speed: float, *, positions: int = 25
) -> tuple[float, float]:
    """Return the mean friction over positions and both directions, and its error."""
    surface = FrictionSurface.from_stage(joint)
    low, high = joint.position_range
    q = np.tile(np.linspace(low, high, positions), 2)
    dq = np.repeat([speed, -speed], positions)
    direction = np.sign(dq)
    mean = float(np.mean(direction * surface.torque(q, dq)))

    # The mean is linear in the coefficients of the surface.
    row = np.mean(direction[:, None] * surface.columns(q, dq), axis=0)
    variance = max(row @ surface.covariance @ row, 0.0)
    return mean, float(np.sqrt(variance))
