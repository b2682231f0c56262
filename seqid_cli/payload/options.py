"""Options of `payload`; free of heavy imports."""

from dataclasses import dataclass

from seqid_cli.identify.options import LogOptions, Source


@dataclass(frozen=True, kw_only=True)
class PayloadOptions(LogOptions):
    """Options of the identification of a payload.

    `source` is where joint motion comes from. `friction_change` [1] is the standard
    deviation by which each joint's friction may differ from the model's, as a share of
    it: between two recordings it changes with temperature and load. `good_error` [1] is
    the largest standard error of the mass, as a share of it, with which the result is
    good.
    """

    source: Source = "auto"
    friction_change: float = 0.2
    good_error: float = 0.1
