"""What a user may set about discovery; kept free of heavy imports for the command line."""

from dataclasses import dataclass, field

from seqid_cli.identify.options import InertiaOptions, LogOptions, Source


@dataclass(frozen=True, kw_only=True)
class DiagnoseOptions(LogOptions):
    """Where joint motion comes from.

    `source` "auto" takes IMUs only where encoders are too coarse: what a drive or its encoder does
    wrong is to be found, and IMUs would make up for it.
    """

    source: Source = "auto"


@dataclass(frozen=True, kw_only=True)
class RefineOptions(DiagnoseOptions):
    """At most `rounds` effects, and smooth terms `with_unexplained` where none explains."""

    rounds: int = 4
    with_unexplained: bool = False


@dataclass(frozen=True)
class DiscoverOptions:
    """How effects are looked for; refinement adds at most `max_effects` (see `RefineOptions`)."""

    motion: InertiaOptions = field(default_factory=lambda: InertiaOptions(source="needed"))
    max_effects: int = 4
    with_unexplained: bool = False
