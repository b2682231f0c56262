"""The settings of `diagnose` and `refine`; free of heavy imports."""

from dataclasses import dataclass

from seqid_cli.identify.settings import JudgingSettings
from seqid_cli.inspect.settings import EchoSettings
from seqid_cli.settings import Group, Settings, setting


@dataclass(frozen=True, kw_only=True)
class EvidenceSettings(Group):
    """When an effect is found, and when a refinement adds it."""

    min_confidence: float = setting(
        0.7,
        unit="probability",
        reason="that an effect is there, below which it is not told",
        low=0.05,
        high=0.999,
    )
    min_log_evidence: float = setting(
        6.0,
        unit="log evidence",
        reason="that the best of some hundred effects has on noise alone",
        low=0.1,
        high=100.0,
    )
    negligible_share: float = setting(
        0.04,
        unit="of a square, a gain or a torque",
        reason="that does not matter: an effect must take more off the squared error",
        low=1e-3,
        high=0.9,
    )
    min_visible: float = setting(
        0.2,
        unit="of an effect's square",
        reason="beside the model, below which these motions cannot show the effect",
        low=1e-3,
        high=1.0,
    )


LOG_S = 20.0  # of a log, up to which it may have `most` events


@dataclass(frozen=True, kw_only=True)
class EventSettings(Group):
    """Which short stretches count as pushes from outside."""

    min_sigma: float = setting(
        5.2,
        unit="robust standard deviations",
        reason="by which a stretch must stand out of all others to be an event",
        low=2.0,
        high=100.0,
    )
    longest: float = setting(
        20.0,
        unit="s",
        reason="that one event may last; what lasts longer is an effect or a load",
        low=0.1,
        high=60.0,
    )
    most: int = setting(
        3,
        unit="of a log, or of 20 s of a longer one",
        reason="that events may be, else it is a law that errs",
        low=1,
        high=100,
    )

    def most_in(self, log_s: float) -> float:
        """Return how many events a log of some seconds may have."""
        return self.most * max(log_s / LOG_S, 1.0)


@dataclass(frozen=True, kw_only=True)
class DiscoverSettings(Settings):
    """The settings of `diagnose` and `refine`."""

    judging: JudgingSettings = JudgingSettings()
    evidence: EvidenceSettings = EvidenceSettings()
    events: EventSettings = EventSettings()
    echo: EchoSettings = EchoSettings()
