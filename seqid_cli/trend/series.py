"""The files of each robot in the order of their dates, and every quantity over them.

Robots can be compared by parameters, and by friction at speeds that all of them share.
"""

from collections.abc import Iterator, Mapping, Sequence
from datetime import UTC, datetime

import numpy as np

from seqid_cli.errors import ConfigError, UsageError
from seqid_cli.model.friction import SLIDES, FrictionSurface
from seqid_cli.params.files import By, by_robot
from seqid_cli.params.results.trend import SeriesEntry
from seqid_cli.params.schema import FrictionJoint, ParameterFile, Stages
from seqid_cli.robot.types import Array
from seqid_cli.units import unit_of

Named = tuple[str, ParameterFile]  # with its path
Quantity = tuple[str, str, str, str]  # stage, joint, name, unit
# value, standard error, temperature [degC] (NaN: none)
Found = tuple[float, float, float]


def robots_of(files: Sequence[Named], by: By) -> dict[str, list[ParameterFile]]:
    """Return the files of each robot in the order of their dates; two of one robot at least."""
    robots = by_robot(
        [(path, file.robot.name, (path, file)) for path, file in files], by
    )
    for name, own in robots.items():
        own.sort(key=lambda item: _time(item[1].created, item[0]))
        (first, other), *more = own
        for path, file in more:
            if file.robot.joints != other.robot.joints:
                message = (
                    f"has other joints than {first}, but both are of robot {name!r}"
                )
                hint = "Tell the robots apart by --by folder, or give files of one arm."
                raise UsageError(message, where=path, hint=hint)
    if all(len(own) < 2 for own in robots.values()):
        hint = (
            "Give results of several dates; --by folder tells robots of one name apart."
        )
        raise UsageError("no robot has two parameter files", hint=hint)
    return {name: [file for _, file in own] for name, own in robots.items()}


def days_of(dates: Sequence[str]) -> Array:
    """Return the time (T,) in days since the first date."""
    times = np.array([_time(date) for date in dates])
    return np.asarray((times - times[0]) / 86400.0)


def _time(date: str, path: str = "") -> float:
    """Return a date as a time [s]; of Greenwich where it names no zone."""
    try:
        when = datetime.fromisoformat(date)
    except ValueError as error:
        message, hint = (
            f"$.created: {date!r} is no date",
            "Write it as 2026-01-31T12:00:00Z.",
        )
        raise ConfigError(message, where=path, hint=hint) from error
    return (when if when.tzinfo else when.replace(tzinfo=UTC)).timestamp()


def series_of(robot: str, files: Sequence[ParameterFile]) -> Iterator[SeriesEntry]:
    """Yield every quantity of a robot that two of its files hold at least."""
    speeds = _shared_speeds(files)
    tables = [dict(_quantities(file.stages, speeds)) for file in files]
    dated = [(file.created, table) for file, table in zip(files, tables, strict=True)]
    for quantity in dict.fromkeys(q for table in tables for q in table):
        held = [(date, *table[quantity]) for date, table in dated if quantity in table]
        if len(held) < 2:
            continue
        dates, values, errors, warmth = map(list, zip(*held, strict=True))
        yield SeriesEntry(
            robot=robot,
            **dict(zip(("stage", "joint", "name", "unit"), quantity, strict=True)),
            dates=dates,
            values=values,
            std_errors=errors,
            temperatures=warmth if np.isfinite(warmth).all() else [],
        )


def _quantities(
    stages: Stages, speeds: Mapping[str, Array]
) -> Iterator[tuple[Quantity, Found]]:
    """Yield what a robot can be compared by."""
    for joint, surface in (stages.friction.joints if stages.friction else {}).items():
        warmth = np.nan if surface.temperature is None else surface.temperature
        pace = unit_of("rad/s", surface.unit == "N")
        for speed in speeds.get(joint, ()):
            what = ("friction", joint, f"at {speed:.3g} {pace}", surface.unit)
            yield what, (*_mean_friction(surface, float(speed)), warmth)
    for name, stage in (("gravity", stages.gravity), ("inertia", stages.inertia)):
        for p in stage.parameters if stage else ():
            yield (name, p.joint, p.name, p.unit), (p.value, p.std_error, np.nan)


def _shared_speeds(
    files: Sequence[ParameterFile], *, speeds: int = 3
) -> dict[str, Array]:
    """Speeds of each joint that the friction of all files is known at, by joint."""
    found: dict[str, list[tuple[float, float]]] = {}
    for file in files:
        for joint, surface in (
            file.stages.friction.joints if file.stages.friction else {}
        ).items():
            low, high = surface.speed_range
            found.setdefault(joint, []).append(
                (max(low, SLIDES * surface.sign_width), high)
            )
    ends = {
        j: (max(r[0] for r in own), min(r[1] for r in own)) for j, own in found.items()
    }
    return {
        j: np.linspace(low, high, speeds)
        for j, (low, high) in ends.items()
        if low < high
    }


def _mean_friction(
    joint: FrictionJoint, speed: float, *, positions: int = 25
) -> tuple[float, float]:
    """Mean friction over positions and both directions at a speed, and its standard error."""
    surface = FrictionSurface.from_stage(joint)
    low, high = joint.position_range
    q = np.tile(np.linspace(low, high, positions), 2)
    v = np.repeat([speed, -speed], positions)
    mean = float(np.mean(np.sign(v) * surface.torque(q, v)))
    row = np.mean(np.sign(v)[:, None] * surface.columns(q, v), axis=0)
    known = surface.covariance.shape == (len(row), len(row))
    return mean, (
        float(np.sqrt(max(row @ surface.covariance @ row, 0.0))) if known else 0.0
    )
