"""What the study of undeclared effects runs: every case, and what the right answer to
it is.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, replace
from itertools import product
from typing import Literal

import numpy as np

from seqid_cli.params.results.diagnosis import DiagnosisFile
from tests.plants.cases import RIGS
from tests.plants.effects.arm import other
from tests.plants.effects.registry import CATALOGUE, OUTSIDE, REGISTRY, inject
from tests.plants.simulate import Plant
from tests.studies.rigs.repetition import surface_of

Group = Literal["catalogue", "clean", "pairs", "outside", "starts"]
Start = Literal["simultaneous", "sequential", "sequential_with", "before"]
Effects = tuple[tuple[str, int, float], ...]  # name, joint, size

RIG_NAMES: Mapping[str, str] = {"two": "vertical_two_joint", "six": "six_joint"}
JOINTS: Mapping[str, int] = {"two": 2, "six": 6}
SEEDS = range(5)
SIZES = (1.0, 0.4)
WEAR = "friction_change"
CHANGES = (
    "payload",
    "base_tilt",
    "torque_constant",
    "torque_bias",
    "thermal_friction",
    WEAR,
)
CHANGES += ("rotor_inertia", "time_skew", "spring.counterbalance")
QUICK = (
    "stribeck",
    "load_dependent_friction",
    "quadratic_drag",
    "presliding_hysteresis",
)
QUICK += ("torque_ripple", "joint_elasticity", "spring", "torque_bias", "time_skew")
QUICK += ("external_contact",)
PAIRS = 44
# a joint has one spring between drive and link
SPRUNG = {"joint_elasticity", "backlash"}
CLEAN_SEED = 100
SEEDS_APART = 100  # of the kinds of clean controls
CLEAN_RUNS = 8  # of each kind, per rig
PAIR_SEED = 2000


@dataclass(frozen=True)
class Sensors:
    """Instruments other than usual: factors of noise and encoder step, control periods
    per row.
    """

    noise: float = 1.0
    coloured: float = 0.0
    step: float = 1.0
    every: int = 2
    keep: Literal["all", "periodic", "others"] = "all"


SENSORS: Mapping[str, Sensors] = {
    "as usual": Sensors(),
    "half the noise": Sensors(noise=0.5),
    "twice the noise": Sensors(noise=2.0),
    "encoders 4 times as coarse": Sensors(step=4.0),
    "logs at 250 Hz": Sensors(every=4),
    "logs at 1000 Hz": Sensors(every=1),
    "periodic motions alone": Sensors(keep="periodic"),
    "no periodic motion": Sensors(keep="others"),
    "half the noise 1/f": Sensors(coloured=0.5),
}


@dataclass(frozen=True)
class Condition:
    """One run of the study: its seed decides motions and noise, `start` the file it
    starts from.

    simultaneous: classical least squares on the training logs, which have the effects.
    sequential: friction, gravity and inertia from experiments without the effects.
    sequential_with: the same with them.
    before: classical least squares on other logs, recorded before the effects came.

    The sequential ways are for a plant whose friction has Stribeck humps and waves over
    position.
    """

    group: Group
    rig: str
    seed: int
    effects: Effects = ()
    start: Start = "simultaneous"
    sensors: str = "as usual"
    seconds: float = 20.0  # of a log, but for at least three periods

    @property
    def simple_friction(self) -> bool:
        return not self.start.startswith("sequential")

    @property
    def joints(self) -> int:
        return len({joint for _, joint, _ in self.effects})

    @property
    def size(self) -> float:
        return self.effects[0][2]

    @property
    def key(self) -> str:
        effects = "+".join(
            f"{name}@{joint}x{size:g}" for name, joint, size in self.effects
        )
        parts = (self.group, self.rig, effects or "none", f"seed {self.seed}")
        return "/".join((*parts, self.start, self.sensors))

    def without(self, number: int) -> Condition:
        return replace(self, effects=self.effects[:number] + self.effects[number + 1 :])


@dataclass(frozen=True)
class Record:
    condition: Condition
    diagnosis: DiagnosisFile | None
    excess: tuple[tuple[float, ...], ...]
    seconds: float  # of the diagnosis
    error: str = ""


@dataclass(frozen=True)
class Truth:
    """One undeclared effect: its name in the catalogue, if any, and which joints are
    right.
    """

    name: str
    kind: str | None
    joints: tuple[str | None, ...]
    depends_on: tuple[str, ...]


# What a residual may depend on where an effect is not known by name, any one of each.
QUANTITIES: Mapping[str, tuple[str, ...]] = {
    "stribeck": ("velocity", "direction"),
    "thermal_friction": ("temperature", "time", "velocity"),
    "nonlinear_viscous": ("velocity",),
    "position_dependent_friction": ("position", "direction"),
    "torque_ripple": ("position",),
    "joint_elasticity": ("acceleration", "load"),
    "transmission_coupling": ("other_joint",),
    "spring": ("position",),
    "time_skew": ("acceleration", "load"),
    "actuator_lag": ("acceleration", "load"),
    "periodic_disturbance": ("time_frequency",),
}


def declared(condition: Condition) -> Plant:
    """The plant that the robot file describes, with the condition's instruments."""
    plant = RIGS[RIG_NAMES[condition.rig]](simple_friction=condition.simple_friction)
    sensors = SENSORS[condition.sensors]
    return replace(
        plant,
        current_noise=sensors.noise * plant.current_noise,
        coloured=max(sensors.coloured, plant.coloured),
        encoder_step=sensors.step * plant.encoder_step,
    )


def built(condition: Condition) -> tuple[Plant, tuple[Truth, ...]]:
    plant, truths = declared(condition), []
    names = plant.arm.names
    for name, joint, size in condition.effects:
        if name == WEAR:
            plant = worn(plant, joint, size)
            truths.append(Truth(WEAR, WEAR, (names[joint],), ("direction", "velocity")))
            continue
        found = inject(name, plant, joint, size)
        places: tuple[str | None, ...] = (
            None if found.joint is None else names[found.joint],
        )
        if found.kind == "transmission_coupling":
            places = (names[joint], names[joint - 1])
        depends = found.depends_on or QUANTITIES.get(found.kind or "", ())
        if depends == ("other_joint",):
            depends = tuple(f"other_joint:{names[k]}" for k in (joint, other(joint)))
        plant = found.plant
        truths.append(Truth(name, found.kind, places, depends))
    return plant, tuple(truths)


def worn(plant: Plant, joint: int, size: float) -> Plant:
    """Coulomb friction of one joint higher by 30 % times size."""
    friction = surface_of(plant)
    more = np.where(np.arange(plant.arm.n) == joint, 1.0 + 0.3 * size, 1.0)
    return replace(plant, friction=replace(friction, coulomb=more * friction.coulomb))


def _single(
    group: Group, rig: str, name: str, seed: int, size: float, *start: Start
) -> Condition:
    """A case of one effect, at a joint that varies with the seed among those that can
    have it.
    """
    first = 0 if name == WEAR else REGISTRY[name].first
    joint = first + (seed + sum(map(ord, name))) % (JOINTS[rig] - first)
    return Condition(group, rig, seed, ((name, joint, size),), *start)


def _alone(group: Group, names: Iterable[str]) -> list[Condition]:
    """Every kind alone, on both rigs, with every seed, in every size."""
    every = product(SEEDS, SIZES, RIG_NAMES, names)
    return [_single(group, rig, name, seed, size) for seed, size, rig, name in every]


def outside() -> list[Condition]:
    return _alone("outside", OUTSIDE)


def clean() -> Iterator[Condition]:
    for number, sensors in enumerate(SENSORS):
        first = CLEAN_SEED + SEEDS_APART * number
        for seed, rig in product(range(first, first + CLEAN_RUNS), RIG_NAMES):
            yield Condition("clean", rig, seed, sensors=sensors)
    starts: tuple[Start, ...] = ("sequential", "before")
    for start, seed, rig in product(starts, range(50, 54), RIG_NAMES):
        yield Condition("clean", rig, seed, start=start)


def pairs() -> Iterator[Condition]:
    rng = np.random.default_rng(44)
    for number in range(PAIRS):
        rig = ("two", "six")[number % 2]
        while True:
            one, two = (str(x) for x in rng.choice(CATALOGUE, 2, replace=False))
            here, there = (int(x) for x in rng.choice(JOINTS[rig], 2, replace=False))
            joints = (here, here if number % 4 < 2 else there)
            sprung = {one, two} == SPRUNG and joints[0] == joints[1]
            fits = all(
                j >= REGISTRY[x].first for x, j in zip((one, two), joints, strict=True)
            )
            if fits and not sprung:
                break
        effects = ((one, joints[0], 1.0), (two, joints[1], 1.0))
        yield Condition("pairs", rig, PAIR_SEED + number, effects)


def starts() -> Iterator[Condition]:
    for seed, rig, name, size in product(SEEDS, RIG_NAMES, CHANGES, SIZES):
        yield _single("starts", rig, name, seed, size, "before")
    for seed, rig, name in product(range(2), RIG_NAMES, CATALOGUE):
        yield _single("starts", rig, name, seed, 1.0, "sequential")
    for name in CATALOGUE:
        yield _single("starts", "two", name, 0, 1.0, "sequential_with")


def matrix() -> tuple[Condition, ...]:
    return (*clean(), *_alone("catalogue", CATALOGUE), *pairs(), *outside(), *starts())


def in_the_model(condition: Condition, name: str) -> bool:
    """Whether the file of a case has the effect already: a body of logs with it is a
    link's.
    """
    return name == "payload" and condition.start in ("simultaneous", "sequential_with")


def quick() -> tuple[Condition, ...]:
    every = (_single("catalogue", "two", name, 0, 1.0) for name in QUICK)
    return (Condition("clean", "two", CLEAN_SEED), *every)
