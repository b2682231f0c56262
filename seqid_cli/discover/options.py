"""What a user may set about discovery; kept free of heavy imports for the command line."""

from __future__ import annotations

from dataclasses import dataclass, field

from seqid_cli.identify.options import InertiaOptions


@dataclass(frozen=True)
class DiscoverOptions:
    """How effects are looked for.

    `seed` fixes all random numbers; `clean_runs` is the number of clean data sets of this kind that
    gains are compared with; at most `max_effects` effects are found or added; `with_unexplained`
    lets refinement add a smooth term where no effect of the catalogue explains a residual;
    `by_evidence` takes the selection of `discover.select` in place of the search's rules.
    """

    motion: InertiaOptions = field(default_factory=lambda: InertiaOptions(source="needed"))
    seed: int = 0
    clean_runs: int = 4
    max_effects: int = 4
    with_unexplained: bool = False
    by_evidence: bool = False
