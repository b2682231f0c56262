"""What a user may set about discovery; free of heavy imports for the command line."""

from dataclasses import dataclass, field

from seqid_cli.discover.settings import DiscoverSettings
from seqid_cli.identify.options import InertiaOptions, LogOptions, Source


@dataclass(frozen=True, kw_only=True)
class DiagnoseOptions(LogOptions):
    """Where joint motion comes from.

    `source` "auto" takes IMUs only where encoders are too coarse: what a drive or its
    encoder does wrong is to be found, and IMUs would make up for it.
    """

    source: Source = "auto"


@dataclass(frozen=True, kw_only=True)
class RefineOptions(DiagnoseOptions):
    """What a refinement adds.

    At most `rounds` times an effect, at one joint or at several, or without a limit;
    smooth terms `with_unexplained` where none explains. What the held-out logs do not
    confirm is taken out, unless `keep_unconfirmed` asks for it.
    """

    rounds: int | None = None
    with_unexplained: bool = False
    keep_unconfirmed: bool = False


@dataclass(frozen=True)
class DiscoverOptions:
    """How effects are looked for.

    Attributes
    ----------
    motion : InertiaOptions
        Where joint motion comes from, and how it is low-passed.
    max_effects : int or None
        Rounds in which refinement adds effects; None for no limit.
    with_unexplained : bool
        Whether refinement adds smooth terms where no effect explains.
    settings : DiscoverSettings
        Numbers that decide.
    """

    motion: InertiaOptions = field(
        default_factory=lambda: InertiaOptions(source="needed")
    )
    max_effects: int | None = None
    with_unexplained: bool = False
    settings: DiscoverSettings = field(default_factory=DiscoverSettings)
