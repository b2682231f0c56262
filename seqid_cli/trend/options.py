"""Options of `trend`; free of heavy imports."""

from dataclasses import dataclass

from seqid_cli.params.files import By


@dataclass(frozen=True, kw_only=True)
class TrendOptions:
    """Limits from which a quantity has changed.

    `alpha` [1] is the probability that any quantity of healthy robots is said to
    change, `rtol` [1] the least change as a share of the quantity's size. `by` says how
    robots are told apart: by the name in their files, or by the folder that the files
    lie in.
    """

    alpha: float = 0.01
    rtol: float = 0.01
    by: By = "name"
