"""The catalogue: every effect, by name. Adding one is a file and its class here.

A robot file adds effects of its own (`own`) without touching the source.
"""

from collections.abc import Mapping

from seqid_cli.effects.actuator_lag import ActuatorLag
from seqid_cli.effects.asymmetric_friction import AsymmetricFriction
from seqid_cli.effects.backlash import Backlash
from seqid_cli.effects.base_tilt import BaseTilt
from seqid_cli.effects.drift import Drift
from seqid_cli.effects.effect import Effect
from seqid_cli.effects.encoder_eccentricity import EncoderEccentricity
from seqid_cli.effects.external_contact import ExternalContact
from seqid_cli.effects.friction_change import FrictionChange
from seqid_cli.effects.gear_efficiency import GearEfficiency
from seqid_cli.effects.hysteresis import Hysteresis
from seqid_cli.effects.joint_elasticity import JointElasticity
from seqid_cli.effects.joint_zero import JointZero
from seqid_cli.effects.load_dependent_friction import LoadDependentFriction
from seqid_cli.effects.nonlinear_viscous import NonlinearViscous
from seqid_cli.effects.own import own_effect
from seqid_cli.effects.payload import Payload
from seqid_cli.effects.periodic_disturbance import PeriodicDisturbance
from seqid_cli.effects.position_dependent_friction import (
    PositionDependentFriction,
)
from seqid_cli.effects.presliding_hysteresis import PreslidingHysteresis
from seqid_cli.effects.quadratic_drag import QuadraticDrag
from seqid_cli.effects.rotor_inertia import RotorInertia
from seqid_cli.effects.spring import Spring
from seqid_cli.effects.stribeck import Stribeck
from seqid_cli.effects.thermal_friction import ThermalFriction
from seqid_cli.effects.time_skew import TimeSkew
from seqid_cli.effects.torque_bias import TorqueBias
from seqid_cli.effects.torque_constant import TorqueConstant
from seqid_cli.effects.torque_filter import TorqueFilter
from seqid_cli.effects.torque_ripple import TorqueRipple
from seqid_cli.effects.torque_saturation import TorqueSaturation
from seqid_cli.effects.transmission_coupling import TransmissionCoupling
from seqid_cli.errors import ConfigError
from seqid_cli.robot.types import Robot

# Effects are searched and listed in this order.
EFFECTS: tuple[type[Effect], ...] = (
    # friction
    Stribeck,
    LoadDependentFriction,
    GearEfficiency,
    AsymmetricFriction,
    ThermalFriction,
    QuadraticDrag,
    NonlinearViscous,
    PreslidingHysteresis,
    FrictionChange,
    PositionDependentFriction,
    # the measurement
    TorqueConstant,
    TorqueSaturation,
    TorqueBias,
    Drift,
    TimeSkew,
    ActuatorLag,
    TorqueFilter,
    JointZero,
    PeriodicDisturbance,
    ExternalContact,
    # bodies, and a spring beside them
    Spring,
    Hysteresis,
    Payload,
    BaseTilt,
    RotorInertia,
    # the transmission
    TransmissionCoupling,
    EncoderEccentricity,
    TorqueRipple,
    JointElasticity,
    Backlash,
)

CATALOGUE: Mapping[str, Effect] = {effect.name: effect() for effect in EFFECTS}


def catalogue_of(robot: Robot) -> Mapping[str, Effect]:
    """Return the catalogue with the effects that the robot file adds.

    Raises
    ------
    ConfigError
        An added effect has a name of the catalogue, or cannot be loaded.
    """
    for declared in robot.effects:
        if declared.name in CATALOGUE:
            hint = "Give it another name; those of the catalogue are looked for anyway."
            message = f"effect {declared.name!r} is one of the catalogue"
            raise ConfigError(message, where=str(robot.source), hint=hint)

    added = {declared.name: own_effect(declared, robot) for declared in robot.effects}
    return {**CATALOGUE, **added}


def setting_units(effect: str) -> dict[str, str]:
    """Return the units of an effect's settings, in which its torque is not linear."""
    settings = CATALOGUE[effect].settings if effect in CATALOGUE else ()
    return {setting.name: setting.unit for setting in settings}
