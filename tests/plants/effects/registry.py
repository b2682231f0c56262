"""The registry of undeclared effects: what a study puts into a plant, and the right
answer.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Literal

from tests.plants.effects import arm, drive, friction
from tests.plants.simulate import Plant


@dataclass(frozen=True)
class Entry:
    kind: str | None  # the catalogue's name, None outside of it
    make: Callable[[Plant, int, float], Plant]
    place: Literal["joint", "arm"] = "joint"  # whose it is
    depends_on: tuple[str, ...] = ()  # of those outside; `other_joint` without the name
    first: int = 0  # joint that can have it


@dataclass(frozen=True)
class Injection:
    """A plant with one undeclared effect more than `declared`,
    as its robot file says.
    """

    kind: str | None
    joint: int | None  # None: of the whole arm or its measurement
    depends_on: tuple[str, ...]
    declared: Plant
    plant: Plant


REGISTRY: Mapping[str, Entry] = {
    # the catalogue, each by its own name
    "stribeck": Entry("stribeck", friction.stribeck),
    "asymmetric_friction": Entry("asymmetric_friction", friction.asymmetric),
    "load_dependent_friction": Entry(
        "load_dependent_friction", friction.load_dependent
    ),
    "gear_efficiency": Entry("gear_efficiency", friction.gear_efficiency),
    "thermal_friction": Entry("thermal_friction", friction.thermal),
    "quadratic_drag": Entry("quadratic_drag", friction.quadratic_drag),
    "nonlinear_viscous": Entry("nonlinear_viscous", friction.cubic_viscous),
    "presliding_hysteresis": Entry("presliding_hysteresis", friction.presliding),
    "torque_ripple": Entry("torque_ripple", drive.ripple),
    "joint_elasticity": Entry("joint_elasticity", drive.elastic),
    "backlash": Entry("backlash", drive.backlash),
    "transmission_coupling": Entry("transmission_coupling", drive.coupling, first=1),
    "encoder_eccentricity": Entry("encoder_eccentricity", drive.encoder),
    "spring": Entry("spring", friction.spring),
    "payload": Entry("payload", arm.payload, "arm"),
    "base_tilt": Entry("base_tilt", arm.base_tilt, "arm"),
    "rotor_inertia": Entry("rotor_inertia", arm.rotor_inertia),
    "torque_constant": Entry("torque_constant", drive.gain),
    "torque_saturation": Entry("torque_saturation", drive.saturation),
    "torque_bias": Entry("torque_bias", drive.bias),
    "time_skew": Entry("time_skew", drive.skew_all, "arm"),
    "actuator_lag": Entry("actuator_lag", drive.lag),
    "periodic_disturbance": Entry("periodic_disturbance", drive.mains),
    "drift": Entry("drift", drive.drift),
    "external_contact": Entry("external_contact", arm.contact, "arm"),
    "position_dependent_friction": Entry(
        "position_dependent_friction", friction.level_wave
    ),
    "hysteresis": Entry("hysteresis", friction.rope),
    "joint_zero": Entry("joint_zero", arm.joint_zero, first=1),
    "torque_filter": Entry("torque_filter", drive.averaged, "arm"),
    # the same effects by another law
    "nonlinear_viscous.root": Entry("nonlinear_viscous", friction.root_viscous),
    "spring.counterbalance": Entry("spring", friction.counterbalance),
    # outside the catalogue
    "outside.bump": Entry(None, arm.bump, depends_on=("position",)),
    "outside.other_speed": Entry(None, arm.other_speed, depends_on=("other_joint",)),
    "outside.acceleration_cube": Entry(
        None, arm.acceleration_cube, depends_on=("acceleration",)
    ),
    "outside.two_positions": Entry(
        None, arm.two_positions, depends_on=("position", "other_joint")
    ),
}
CATALOGUE = tuple(name for name, entry in REGISTRY.items() if entry.kind == name)
OUTSIDE = tuple(name for name, entry in REGISTRY.items() if entry.kind is None)


def inject(name: str, plant: Plant, joint: int, size: float = 1.0) -> Injection:
    """Put one effect of `REGISTRY` into a plant, which may have undeclared effects
    already.
    """
    entry = REGISTRY[name]
    if not entry.first <= joint < plant.arm.n:
        raise ValueError(f"{name} cannot be on joint {joint} of {plant.arm.n}")
    partner = plant.arm.names[arm.other(joint)] if plant.arm.n > 1 else ""
    depends = tuple(
        f"{x}:{partner}" if x == "other_joint" else x for x in entry.depends_on
    )
    at = joint if entry.place == "joint" else None
    return Injection(entry.kind, at, depends, plant, entry.make(plant, joint, size))
