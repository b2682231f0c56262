"""The settings of `diagnose` and `refine`; free of heavy imports."""

from dataclasses import dataclass

from seqid_cli.identify.settings import JudgingSettings
from seqid_cli.settings import Settings


@dataclass(frozen=True, kw_only=True)
class DiscoverSettings(Settings):
    """The settings of `diagnose` and `refine`."""

    judging: JudgingSettings = JudgingSettings()
