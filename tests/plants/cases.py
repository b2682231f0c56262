"""One run of a study: a rig, what is undeclared in it, and its logs."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass

from tests.plants.arms.rigs import six_joint
from tests.plants.arms.vertical import vertical_two_joint
from tests.plants.effects.registry import Injection, inject
from tests.plants.motions.trials import Drill, drills
from tests.plants.simulate import Plant

RIGS: Mapping[str, Callable[..., Plant]] = {
    rig.__name__: rig for rig in (vertical_two_joint, six_joint)
}


@dataclass(frozen=True)
class Case:
    """Everything that decides a run's logs; the seed decides motions, noise and
    contacts.
    """

    rig: str
    seed: int
    # name, joint, size; put in one by one
    effects: tuple[tuple[str, int, float], ...] = ()
    simple_friction: bool = True
    seconds: float = 20.0


def declared_plant(case: Case) -> Plant:
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
    return drills(declared_plant(case), case.seed, seconds=case.seconds)
