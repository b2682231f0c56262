"""Settings of `payload`; free of heavy imports."""

from dataclasses import dataclass

from seqid_cli.settings import Group, Settings, setting


@dataclass(frozen=True, kw_only=True)
class PayloadFitSettings(Group):
    """Limits beyond which a payload is not good."""

    max_left: float = setting(
        0.3,
        unit="of a joint's torque",
        reason="left with the body in the model, from which the joint is poor",
        low=1e-3,
        high=10.0,
    )
    negative_sigma: float = setting(
        3.0,
        unit="standard errors",
        reason="below zero, from which a mass is a load that was taken off",
        low=0.5,
        high=50.0,
    )
    max_distance: float = setting(
        3.0,
        unit="standard errors",
        reason="from the nearest body that can exist, from which the estimate is poor",
        low=0.1,
        high=1e3,
    )


@dataclass(frozen=True, kw_only=True)
class PayloadSettings(Settings):
    """Settings of `payload`."""

    fit: PayloadFitSettings = PayloadFitSettings()
