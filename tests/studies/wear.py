"""Robots that wear: are those that change named, and no other?

    python -m tests.studies.wear FOLDER --robots 10 --dates 20 --worn 3

Each robot is an arm of the coverage study (one joint), recorded anew at every date with other
noise. On the worn ones friction rises: in proportion to time, or at once from some date on. Each
date is identified from its logs by itself, and `seqid trend` gets all files.
"""

from __future__ import annotations

import argparse
import sys
import warnings
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
from msgspec.structs import replace as replaced

from seqid_cli import identify
from seqid_cli.errors import SeqidWarning
from seqid_cli.params.io import write_json_atomic
from seqid_cli.trend import trend
from tests.plants.simulate import Plant
from tests.studies.coverage.cases import Case, Drawn, case_of, draw, record

RISE = 0.12  # of friction at the last date
NOISES = 1000  # seeds between two dates


@dataclass(frozen=True)
class Robot:
    """One robot: its seed, and how it wears ("drift", "step" or "")."""

    seed: int
    wear: str

    def worn(self, plant: Plant, age: float) -> Plant:
        """The plant at an age between 0 and 1."""
        grown = {"": 0.0, "drift": RISE * age, "step": RISE * (age > 0.5)}[self.wear]
        friction = plant.friction
        coulomb, viscous = ((1.0 + grown) * x for x in (friction.coulomb, friction.viscous))
        return replace(plant, friction=replace(friction, coulomb=coulomb, viscous=viscous))


def identified(robot: Robot, number: int, dates: int, path: Path) -> None:
    """Record one date and identify it."""
    case = case_of("one", robot.seed)
    drawn = draw(case)
    trials = [trial for trial in drawn.trials if trial.stage in ("friction", "gravity", "inertia")]
    plant = replace(robot.worn(drawn.plant, number / max(dates - 1, 1)), imus=())
    with TemporaryDirectory(prefix="seqid-wear-") as name, warnings.catch_warnings():
        warnings.simplefilter("ignore", SeqidWarning)
        folder = Path(name)
        other = Case(case.rig, robot.seed + NOISES * (number + 1), case.noise, case.encoder)
        record(other, Drawn(plant, trials, drawn.traits, drawn.every), folder)
        toml, slow = folder / "robot.toml", [str(folder / x) for x in ("gravity", "friction")]
        file = identify.friction(str(folder / "friction"), toml)
        file = identify.gravity(slow, toml, file)
        file = identify.inertia(str(folder / "inertia"), toml, file)
    day = np.datetime64("2026-01-01") + 7 * number
    path.parent.mkdir(parents=True, exist_ok=True)
    write_json_atomic(path, replaced(file, created=f"{day}T08:00:00Z"))


def robots(count: int, worn: int, first: int) -> list[Robot]:
    """Robots, those that wear first."""
    kinds = ("drift", "step")
    return [Robot(first + k, kinds[k % 2] if k < worn else "") for k in range(count)]


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the study; returns 1 where the wrong robots are named."""
    parser = argparse.ArgumentParser(prog="python -m tests.studies.wear")
    parser.add_argument("folder", type=Path)
    parser.add_argument("--robots", type=int, default=10)
    parser.add_argument("--dates", type=int, default=20)
    parser.add_argument("--worn", type=int, default=3)
    parser.add_argument("--seed", type=int, default=900, help="of the first robot")
    given = parser.parse_args(arguments)
    fleet = robots(given.robots, given.worn, given.seed)
    paths = []
    for robot in fleet:
        for number in range(given.dates):
            path = given.folder / f"robot_{robot.seed}" / f"{number:02}.json"
            if not path.exists():
                identified(robot, number, given.dates, path)
            paths.append(path)
    from seqid_cli.trend import TrendOptions

    found = trend(paths, TrendOptions(by="folder"), output=given.folder / "trend.json")
    named = {Path(change.robot).name for change in found.changes}
    worn = {f"robot_{robot.seed}" for robot in fleet if robot.wear}
    lines = [f"worn {sorted(worn)}, named {sorted(named)}"]
    lines += [
        f"{Path(change.robot).name} {change.stage} {change.name}: {change.kind} since "
        f"{change.since[:10]}, {change.relative or 0:+.1%}, {change.sigmas or 0:.1f} sigma"
        for change in found.changes
    ]
    lines.append(f"inflation {found.inflation}, limit {found.limit:.2f}")
    sys.stdout.write("\n".join(lines) + "\n")
    return int(named != worn)


if __name__ == "__main__":
    raise SystemExit(main())
