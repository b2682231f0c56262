"""The settings of `inspect`; free of heavy imports."""

from dataclasses import dataclass

from seqid_cli.settings import Group, Settings, setting


@dataclass(frozen=True, kw_only=True)
class ChannelSettings(Group):
    """When a channel of a joint is said to be wrong."""

    min_spike_ratio: float = setting(
        10.0,
        unit="times what usual samples differ",
        reason="by which a sample of the torque must stand out to be a spike",
        low=2.0,
        high=1e4,
    )
    min_spike_share: float = setting(
        1.0,
        unit="of the channel's span",
        reason="by which it must stand out as well; short pushes reach less",
        low=0.0,
        high=100.0,
    )
    max_missing: float = setting(
        0.01,
        unit="of the values",
        reason="missing at uneven distances, from which it is said",
        low=0.0,
        high=1.0,
    )
    max_speed: float = setting(
        2.0,
        unit="times velocity_limit",
        reason="from which a speed is no overshoot: unit, gear ratio or limit is wrong",
        low=1.0,
        high=100.0,
    )


@dataclass(frozen=True, kw_only=True)
class DynamicsSettings(Group):
    """When torque is compared with other robots than that of the robot file."""

    max_left: float = setting(
        0.1,
        unit="of the torque's RMS",
        reason="left by the equations, from which a cause is looked for",
        low=1e-3,
        high=1.0,
    )
    max_unexplained: float = setting(
        0.6,
        unit="of the torque's RMS",
        reason="left without a cause, from which log and robot file do not match",
        low=0.01,
        high=10.0,
    )


@dataclass(frozen=True, kw_only=True)
class EchoSettings(Group):
    """When a torque that position explains is said to be no measurement."""

    max_friction: float = setting(
        0.025,
        unit="of the torque's RMS",
        reason="friction, with its error, below which a torque is an echo of the"
        " command; 0: none is",
        low=0.0,
        high=1.0,
    )


@dataclass(frozen=True, kw_only=True)
class ImuSettings(Group):
    """When the readings of an IMU are said to be wrong."""

    max_gravity_error: float = setting(
        0.05,
        unit="of gravity",
        reason="by which readings at rest may differ from it",
        low=1e-3,
        high=1.0,
    )
    max_bias: float = setting(
        0.1,
        unit="rad/s",
        reason="that a gyro may read at rest",
        low=1e-4,
        high=10.0,
    )


@dataclass(frozen=True, kw_only=True)
class InspectSettings(Settings):
    """The settings of `inspect`."""

    channels: ChannelSettings = ChannelSettings()
    dynamics: DynamicsSettings = DynamicsSettings()
    echo: EchoSettings = EchoSettings()
    imus: ImuSettings = ImuSettings()
