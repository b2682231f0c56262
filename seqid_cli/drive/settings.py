"""Settings of `drive`; free of heavy imports."""

from dataclasses import dataclass

from seqid_cli.settings import Group, Settings, setting


@dataclass(frozen=True, kw_only=True)
class TermSettings(Group):
    """When a part of a controller is said to be there."""

    min_sigma: float = setting(
        4.0,
        unit="standard errors",
        reason="from zero, from which a part is there",
        low=1.0,
        high=50.0,
    )


@dataclass(frozen=True, kw_only=True)
class WindowSettings(Group):
    """Windows of the logs in which the closed loop of each joint is simulated."""

    most: float = setting(
        240.0,
        unit="windows",
        reason="of each joint, taken evenly; 0 leaves the fit by rows alone",
        low=0.0,
        high=1e5,
    )


@dataclass(frozen=True, kw_only=True)
class DriveVerdictSettings(Group):
    """When the controller of a joint is good, and when it is poor."""

    good_left: float = setting(
        0.05,
        unit="of the torque's RMS",
        reason="left by the controller, up to which it is good",
        low=1e-3,
        high=1.0,
    )
    max_left: float = setting(
        0.3,
        unit="of the torque's RMS",
        reason="left by the controller, from which it is another controller",
        low=0.01,
        high=1.0,
    )
    good_windows: float = setting(
        0.5,
        unit="of the guess's error",
        reason="in windows, beside start and change of the command, to be good",
        low=0.01,
        high=1.0,
    )


@dataclass(frozen=True, kw_only=True)
class DriveSettings(Settings):
    """Settings of `drive`."""

    terms: TermSettings = TermSettings()
    windows: WindowSettings = WindowSettings()
    verdict: DriveVerdictSettings = DriveVerdictSettings()
