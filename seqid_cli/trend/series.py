"""The files of each robot in the order of their dates, and every quantity over them.

Robots can be compared by parameters, and by friction at speeds that all of them share.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime

import numpy as np

from seqid_cli.errors import ConfigError, UsageError
from seqid_cli.model.friction import SLIDES, FrictionSurface
from seqid_cli.params.files import By, by_robot
from seqid_cli.params.schema import FrictionJoint, ParameterFile, Stages
from seqid_cli.robot.types import Array
from seqid_cli.units import unit_of

DAY = 86400.0


@dataclass(frozen=True)
class Quantity:
    """One number that every robot has: a parameter, or the friction of a joint at a speed."""

    stage: str
    joint: str
    name: str
    unit: str


def quantities(
    stages: Stages, speeds: Mapping[str, Array]
) -> Iterator[tuple[Quantity, tuple[float, float]]]:
    """Yield what a robot can be compared by, with value and standard error."""
    for joint, surface in (stages.friction.joints if stages.friction else {}).items():
        pace = unit_of("rad/s", surface.unit == "N")
        for speed in speeds.get(joint, ()):
            quantity = Quantity("friction", joint, f"at {speed:.3g} {pace}", surface.unit)
            yield quantity, _mean_friction(surface, float(speed))
    for name, stage in (("gravity", stages.gravity), ("inertia", stages.inertia)):
        for p in stage.parameters if stage else ():
            yield Quantity(name, p.joint, p.name, p.unit), (p.value, p.std_error)


def speeds_of(files: Iterable[ParameterFile], *, speeds: int = 3) -> dict[str, Array]:
    """Speeds of each joint that the friction of all files is known at, by joint."""
    found: dict[str, list[tuple[float, float]]] = {}
    for file in files:
        for joint, surface in (file.stages.friction.joints if file.stages.friction else {}).items():
            low, high = surface.speed_range
            found.setdefault(joint, []).append((max(low, SLIDES * surface.sign_width), high))
    ends = {j: (max(r[0] for r in own), min(r[1] for r in own)) for j, own in found.items()}
    return {j: np.linspace(low, high, speeds) for j, (low, high) in ends.items() if low < high}


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
    if surface.covariance.shape != (len(row), len(row)):
        return mean, 0.0
    return mean, float(np.sqrt(max(row @ surface.covariance @ row, 0.0)))


@dataclass(frozen=True)
class Dated:
    """A parameter file with its path, the time of it [s] and its date as text."""

    path: str
    file: ParameterFile
    time: float

    @property
    def date(self) -> str:
        """As the file says it."""
        return self.file.created

    @classmethod
    def of(cls, path: str, file: ParameterFile) -> Dated:
        """Read the date; raises ConfigError where it is none."""
        try:
            when = datetime.fromisoformat(file.created)
        except ValueError as error:
            hint = "Write it as 2026-01-31T12:00:00Z."
            message = f"$.created: {file.created!r} is no date"
            raise ConfigError(message, where=path, hint=hint) from error
        aware = when if when.tzinfo else when.replace(tzinfo=UTC)
        return cls(path, file, aware.timestamp())


@dataclass(frozen=True)
class Series:
    """One quantity of one robot: days (T,), values, standard errors, temperatures (NaN: none)."""

    robot: str
    quantity: Quantity
    files: tuple[Dated, ...]
    values: Array
    errors: Array
    temperatures: Array

    @property
    def days(self) -> Array:
        """Time (T,) in days since the first file."""
        times = np.array([dated.time for dated in self.files], dtype=np.float64)
        days: Array = (times - times[0]) / DAY
        return days


def robots_of(files: Sequence[Dated], by: By) -> dict[str, list[Dated]]:
    """Files by robot, in the order of their dates."""
    found = by_robot([(dated.path, dated.file.robot.name, dated) for dated in files], by)
    for name, own in found.items():
        own.sort(key=lambda dated: dated.time)
        for dated in own:
            if dated.file.robot.joints != own[0].file.robot.joints:
                raise UsageError(
                    f"has other joints than {own[0].path}, but both are of robot {name!r}",
                    where=dated.path,
                    hint="Tell the robots apart by --by folder, or give files of one arm.",
                )
    if all(len(own) < 2 for own in found.values()):
        raise UsageError(
            "no robot has two parameter files",
            hint="Give results of several dates; --by folder tells robots of one name apart.",
        )
    return found


def series_of(robot: str, files: Sequence[Dated]) -> Iterator[Series]:
    """Every quantity of a robot that two of its files hold at least."""
    speeds = speeds_of(dated.file for dated in files)
    tables = [dict(quantities(dated.file.stages, speeds)) for dated in files]
    for quantity in dict.fromkeys(q for table in tables for q in table):
        there = [k for k, table in enumerate(tables) if quantity in table]
        if len(there) < 2:
            continue
        values, errors = np.array([tables[k][quantity] for k in there]).T
        own = tuple(files[k] for k in there)
        warmth = np.full(len(own), np.nan)
        for k, stage in enumerate(dated.file.stages.friction for dated in own):
            if quantity.stage == "friction" and stage and quantity.joint in stage.joints:
                warmth[k] = stage.joints[quantity.joint].temperature  # NaN where it is None
        yield Series(robot, quantity, own, values, errors, warmth)
