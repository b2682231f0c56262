"""What a user may set about discovery; kept free of heavy imports for the command line."""

from __future__ import annotations

from dataclasses import dataclass, field

from seqid_cli.identify.options import InertiaOptions


@dataclass(frozen=True)
class DiscoverOptions:
    """How effects are looked for.

    Refinement adds at most `max_effects`; `with_unexplained` lets it add a smooth term where no
    effect of the catalogue explains a residual.
    """

    motion: InertiaOptions = field(default_factory=lambda: InertiaOptions(source="needed"))
    max_effects: int = 4
    with_unexplained: bool = False
