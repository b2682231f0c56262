"""A fleet of two-joint arms: recorded, identified, and those that drift told from the others.

    python -m tests.studies.fleet FOLDER --robots 50 --drifting 3 --jobs 2

The arms are simulated with small differences in friction and inertia. Each night's logs of a robot
lie in `robot=.../date=.../`. Each robot is identified by itself, several at a time; then
`judge_fleet` compares them. What was made drift is printed beside what was found.
"""

from __future__ import annotations

import argparse
import json
import sys
import time
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from seqid_cli import identify
from seqid_cli.commands.screen.layout import format_table
from seqid_cli.params.io import read_parameters
from seqid_cli.params.schema import ParameterFile
from seqid_cli.scale.executors import cores, processes
from tests.plants.arms.rigs import two_joint
from tests.plants.friction.surface import SurfaceFriction
from tests.plants.motions.experiments import Trial, friction_trials, inertia_trials
from tests.plants.robotfile import robot_toml
from tests.plants.simulate import Plant, simulate
from tests.studies.fleet.comparison import Fleet, judge_fleet
from tests.unit.logs.writers import write_parquet

SEED = 20260301
DATE = "2026-03-01"
FRICTION_SPREAD, INERTIA_SPREAD = 0.04, 0.01  # between healthy robots
# What wears: friction of both kinds at a joint, or something was screwed to the last link.
DRIFTS = {"friction of joint_1": (1.35, 1.0, 1.0), "friction of joint_2": (1.0, 1.35, 1.0)}
DRIFTS["inertia of link 2"] = (1.0, 1.0, 1.2)
DRIFTS["bearing of joint_1"] = (2.5, 1.0, 1.0)  # about to seize: for fleets of few robots
FEW = 12  # robots say little of how much robots differ
REACH, TOP = 2.0, np.array([2.5, 3.0])  # rad to either side, rad/s: a short program
EVERY = 4  # control periods per row: 250 Hz
ORDERS = identify.FrictionOptions(position_order=5, velocity_order=1)
ENCODER = identify.RigidOptions(source="encoder")
WIDTH = 2


@dataclass(frozen=True)
class Member:
    """One robot of the fleet, and what is wrong with it."""

    number: int
    fault: str = ""

    @property
    def name(self) -> str:
        """As folders and tables have it."""
        return f"r{self.number:0{WIDTH}d}"

    def __str__(self) -> str:
        return self.name


def fleet(robots: int, drifting: int) -> list[Member]:
    """Robots of which every so many-th drifts, each in another way than the last."""
    rng = np.random.default_rng([SEED, robots])
    chosen = rng.choice(robots, drifting, replace=False).tolist()
    kinds = list(DRIFTS)[:-1] if robots > FEW else list(DRIFTS)[-1:]
    faults = {number: kinds[k % len(kinds)] for k, number in enumerate(chosen)}
    return [Member(number, faults.get(number, "")) for number in range(robots)]


def plant_of(member: Member) -> Plant:
    """The robot as it was built, and as it is now."""
    plant = two_joint()
    rng = np.random.default_rng([SEED, member.number])
    assert isinstance(plant.friction, SurfaceFriction)
    first, second, inertia = DRIFTS.get(member.fault, (1.0, 1.0, 1.0))
    worn = np.array([first, second])
    dry, wet = (1.0 + FRICTION_SPREAD * rng.normal(size=2) for _ in "dw")
    friction = replace(
        plant.friction,
        coulomb=plant.friction.coulomb * dry * worn,
        viscous=plant.friction.viscous * wet * worn,
    )
    bodies = 1.0 + INERTIA_SPREAD * rng.normal(size=2)
    phi = plant.arm.phi * (bodies * np.array([1.0, inertia]))[:, None]
    reach = np.array([[-REACH, REACH]] * plant.arm.n)
    arm = replace(plant.arm, phi=phi)
    return replace(
        plant,
        friction=friction,
        arm=arm,
        imus=(),
        position_limits=reach,
        velocity_limits=TOP.copy(),
    )


def trials_of(plant: Plant) -> list[Trial]:
    """A short night: three speeds per joint, then two moves of both."""
    rng = np.random.default_rng(SEED)  # all robots run the same program
    postures = [np.array([0.0, angle]) for angle in (0.8, -1.4)]
    return [
        *friction_trials(plant, [np.zeros(2)], speeds=3, lowest=0.35),
        *inertia_trials(plant, postures, rng, pairs=[(0, 1), (0, 1)], seconds=5.0),
    ]


@dataclass(frozen=True)
class Night:
    """Records and identifies one robot; the parameters are in its folder afterwards."""

    folder: Path

    def __call__(self, member: Member) -> float:
        """Return the CPU seconds that identification took."""
        place = self.folder / f"robot={member.name}" / f"date={DATE}"
        plant = plant_of(member)
        robot = self.folder / "robot.toml"
        for number, trial in enumerate(trials_of(plant)):
            path = place / trial.stage / f"{trial.name}.parquet"
            path.parent.mkdir(parents=True, exist_ok=True)
            seed = SEED + 100 * member.number + number
            log = simulate(plant, trial.reference, seed, every=EVERY, imus=False)
            write_parquet(path, log.t, plant.arm.names, log.q, current=log.current)
        start = time.process_time()
        steps = [place / f"{name}.json" for name in ("friction", "gravity", "inertia")]
        identify.friction(place / "friction", robot, ORDERS, output=steps[0])
        identify.gravity(place / "friction", robot, steps[0], output=steps[1])
        identify.inertia(place / "inertia", robot, steps[1], ENCODER, output=steps[2])
        return time.process_time() - start


def identified(folder: Path, members: Sequence[Member], jobs: int) -> dict[str, float]:
    """Record and identify every robot; returns the CPU seconds of each identification."""
    folder.mkdir(parents=True, exist_ok=True)
    text = robot_toml("two_joint", replace(two_joint(), imus=()))
    (folder / "robot.toml").write_text(text, encoding="ascii")
    with processes(jobs) as executor:
        seconds = executor.map(Night(folder), members)
        return {member.name: found for member, found in zip(members, seconds, strict=True)}


def results(folder: Path) -> dict[str, ParameterFile]:
    """Read the last night's parameters of every robot."""
    found = {}
    for place in sorted(folder.glob("robot=*")):
        *_, night = sorted(place.glob("date=*"))
        found[place.name.partition("=")[2]] = read_parameters(night / "inertia.json")
    return found


def table(found: Fleet, faults: dict[str, str], most: int) -> str:
    """The most unlike robots, one line each."""
    columns = (
        "robot",
        "most unlike in",
        "value",
        "fleet",
        "spread",
        "unit",
        "z",
        "verdict",
        "made",
    )
    rows = []
    for one in found.deviations[:most]:
        quantity = one.quantity
        rows.append(
            (
                one.robot,
                f"{quantity.stage} {quantity.joint} {quantity.name}",
                f"{one.value:.5g}",
                f"{one.fleet:.5g}",
                f"{one.spread:.2g}",
                quantity.unit,
                f"{one.z:+.1f}",
                "drifts" if one.drifts else "-",
                faults.get(one.robot, ""),
            )
        )
    return format_table(columns, rows)


def main(arguments: Sequence[str]) -> int:
    """Run a night of the fleet; returns 1 where the wrong robots were found."""
    parser = argparse.ArgumentParser(prog="python -m tests.studies.fleet")
    parser.add_argument("folder", type=Path)
    parser.add_argument("--robots", type=int, default=50)
    parser.add_argument("--drifting", type=int, default=3)
    parser.add_argument("--jobs", type=int, default=cores())
    given = parser.parse_args(arguments)
    members = fleet(given.robots, given.drifting)
    seconds = identified(given.folder, members, given.jobs)
    found = judge_fleet(results(given.folder))
    faults = {member.name: member.fault for member in members if member.fault}
    sys.stdout.write(table(found, faults, most=10))
    for note in found.notes:
        sys.stdout.write(f"note: {note}\n")
    sys.stdout.write(
        f"{len(found.drifting)} of {len(members)} robots drift (|z| above {found.limit:.1f} in one "
        f"of {len(found.quantities)} quantities); identification took "
        f"{np.median(list(seconds.values())):.2f} s of CPU per robot\n"
    )
    document = {"drifting": found.drifting, "planted": faults, "limit": found.limit}
    (given.folder / "fleet.json").write_text(json.dumps(document, indent=2) + "\n")
    return 0 if set(found.drifting) == set(faults) else 1
