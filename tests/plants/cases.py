"""One run of a study: a rig, what is undeclared in it, and its logs."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path

from tests.plants.rigs import six_joint
from tests.plants.simulate import Plant
from tests.plants.trials import Drill, Recorded, drills, record
from tests.plants.undeclared import Injection, inject
from tests.plants.vertical import vertical_two_joint

RIGS: Mapping[str, Callable[..., Plant]] = {
    "vertical_two_joint": vertical_two_joint,
    "six_joint": six_joint,
}


@dataclass(frozen=True)
class Case:
    """Everything that decides a run's logs.

    `effects` are (name in the registry, joint, size), put in one after the other; none is the clean
    plant. The seed decides motions, noise and contacts.
    """

    rig: str
    seed: int
    effects: tuple[tuple[str, int, float], ...] = ()
    simple_friction: bool = True
    seconds: float = 20.0
    repeat: bool = False


@dataclass(frozen=True)
class Study:
    """A case's logs; `declared` is the plant that the robot file describes."""

    case: Case
    declared: Plant
    plant: Plant
    injections: tuple[Injection, ...]
    training: tuple[Recorded, ...]
    held_out: tuple[Recorded, ...]


def declared_plant(case: Case) -> Plant:
    """The rig as its robot file says."""
    return RIGS[case.rig](simple_friction=case.simple_friction)


def injections(case: Case) -> tuple[Injection, ...]:
    """The case's effects in order; the last one's plant has all of them."""
    plant, out = declared_plant(case), []
    for name, joint, size in case.effects:
        out.append(inject(name, plant, joint, size))
        plant = out[-1].plant
    return tuple(out)


def motions(case: Case) -> tuple[Drill, ...]:
    """The motions and start times, which the effects do not change."""
    return drills(declared_plant(case), case.seed, seconds=case.seconds, repeat=case.repeat)


def recorded(case: Case, *, imus: bool = False, cache: Path | None = None) -> Study:
    """Run a case, or read it from the `cache` folder; the same arguments give the same logs."""
    done = injections(case)
    declared = declared_plant(case)
    plant = done[-1].plant if done else declared
    logs = record(plant, motions(case), case.seed, imus=imus, cache=cache, label=repr(case))
    return Study(
        case=case,
        declared=declared,
        plant=plant,
        injections=done,
        training=tuple(x for x in logs if not x.drill.held_out),
        held_out=tuple(x for x in logs if x.drill.held_out),
    )
