"""The settings of `plan`; free of heavy imports."""

from dataclasses import dataclass

from seqid_cli.settings import Group, Settings, setting


@dataclass(frozen=True, kw_only=True)
class MarginSettings(Group):
    """How far planned moves stay from what must not happen."""

    torque_sigma: float = setting(
        3.0,
        unit="standard errors",
        reason="of the torque that a move needs, for which its limit has room",
        low=0.0,
        high=20.0,
    )
    floor_clearance: float = setting(
        0.02,
        unit="m",
        reason="between the arm and the base plane: controllers overshoot",
        low=0.0,
        high=1.0,
    )


@dataclass(frozen=True, kw_only=True)
class DiscriminationSettings(Group):
    """When a plan tells two effects apart."""

    min_power: float = setting(
        0.9,
        unit="probability",
        reason="of naming the right one, below which more is to be recorded",
        low=0.5,
        high=0.999,
    )


@dataclass(frozen=True, kw_only=True)
class PlanSettings(Settings):
    """The settings of `plan`."""

    margins: MarginSettings = MarginSettings()
    discrimination: DiscriminationSettings = DiscriminationSettings()
