"""The catalogue: every effect, by name. Adding one is a file and its name here.

A robot file adds its own (`own`) without touching the source.
"""

from collections.abc import Mapping
from importlib import import_module

from seqid_cli.errors import ConfigError
from seqid_cli.model.effects.effect import Effect
from seqid_cli.model.effects.own import own_effect
from seqid_cli.robot.types import Robot

# Each is a file, and in it a class by the same name.
_NAMES = """
    stribeck load_dependent_friction gear_efficiency asymmetric_friction thermal_friction
    quadratic_drag nonlinear_viscous presliding_hysteresis friction_change
    position_dependent_friction
    torque_constant torque_saturation torque_bias drift time_skew actuator_lag periodic_disturbance
    external_contact
    spring payload base_tilt rotor_inertia
    transmission_coupling encoder_eccentricity torque_ripple joint_elasticity backlash
"""


CATALOGUE: Mapping[str, Effect] = {
    name: getattr(
        import_module(f"{__package__}.{name}"), name.title().replace("_", "")
    )()
    for name in _NAMES.split()
}


def catalogue_of(robot: Robot) -> Mapping[str, Effect]:
    """The catalogue with what the robot file adds.

    Raises ConfigError if an added effect has a name of the catalogue, or cannot be
    loaded.
    """
    for asked in robot.effects:
        if asked.name in CATALOGUE:
            hint = "Give it another name; those of the catalogue are looked for anyway."
            message = f"effect {asked.name!r} is one of the catalogue"
            raise ConfigError(message, where=str(robot.source), hint=hint)
    return {
        **CATALOGUE,
        **{asked.name: own_effect(asked, robot) for asked in robot.effects},
    }


def setting_units(effect: str) -> dict[str, str]:
    """Return the units of an effect's settings, in which its torque is not linear."""
    settings = CATALOGUE[effect].settings if effect in CATALOGUE else ()
    return {setting.name: setting.unit for setting in settings}
