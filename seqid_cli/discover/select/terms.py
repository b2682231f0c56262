"""What a model may lack as terms of one list: effects with settings, and smooth functions."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from seqid_cli.discover.base import LIKELY
from seqid_cli.discover.candidates import Candidate, CandidateColumns
from seqid_cli.discover.select.rows import Channels, ColumnGroup
from seqid_cli.discover.select.smooth import SmoothFunction
from seqid_cli.typing import Array

# of a term's largest column, in its own unit: no row shows a smaller one
UNSHOWN = 1e-6


@dataclass(frozen=True, eq=False)
class Term:
    """An effect at a joint (None: the whole arm) or a smooth function, and its columns.

    `came_since` says that friction trials of the file would have shown it, and did not.
    """

    what: Candidate | SmoothFunction
    part: ColumnGroup
    came_since: bool = False

    @property
    def joint(self) -> int | None:
        """Whose it is."""
        return self.what.joint

    @property
    def smooth(self) -> bool:
        """Whether it is no effect of the catalogue."""
        return isinstance(self.what, SmoothFunction)

    @cached_property
    def name(self) -> str:
        """Effect, or what the function depends on."""
        return (
            self.what.label
            if isinstance(self.what, SmoothFunction)
            else self.what.effect.name
        )

    @property
    def freedom(self) -> int:
        """Number of parameters: coefficients and settings that are searched.

        When an effect came is one as well: no channel tells it. Else a law of friction
        that came since would go before a change of friction, which counts when it
        happened.
        """
        if isinstance(self.what, SmoothFunction):
            return self.part.size
        searched = self.what.effect.searched(self.what.settings)
        return self.part.size + searched + self.came_since

    @property
    def change(self) -> bool:
        """Whether it says that the file's values do not hold: the form of the model has it."""
        return isinstance(self.what, Candidate) and self.what.effect.change

    @property
    def key(self) -> tuple[str, int | None]:
        """What it is, whatever the settings."""
        return self.name, self.joint

    @property
    def channels(self) -> frozenset[int]:
        """Channels that it touches."""
        return frozenset(self.part.columns)


def effects(
    stage: CandidateColumns, candidates: Sequence[Candidate], size: Array
) -> list[Term]:
    """Make terms of candidates; none is likely to be much more than `size` (channels,) N m."""
    known, found, n = stage.known, list[Term](), stage.rows.n
    for candidate, columns in zip(candidates, stage.columns(candidates), strict=True):
        if (
            columns
            and next(iter(columns.values())).shape[1]
            and any(map(len, columns.values()))
        ):
            first = {
                c: candidate.size for c in columns if candidate.apart and c // n == 1
            }
            if candidate.address not in known:
                in_file, beside = stage.in_file(candidate, columns)
                known[candidate.address] = (
                    np.diag(_precision(beside, size, first)),
                    in_file,
                )
            precision, in_file = known[candidate.address]
            part = ColumnGroup(
                columns, precision, first_column=first, absorbed_by_file=in_file
            )
            found.append(Term(candidate, part, came_since=stage.came_since(candidate)))
    return found


def smooth_term(stage: CandidateColumns, one: SmoothFunction, size: Array) -> Term:
    """Make a term of a function; of a drive it is another one, with coefficients of its own.

    A measured load holds all that acts on the link: of that it explains the drive
    alone.
    """
    j = one.joint
    columns = stage.with_drive({j: one.columns(stage.rows)})
    if len(columns) > 1 and "load" in one.quantities:
        del columns[j]
    first = {c: one.size for c in columns if c != j and j in columns}
    # among the smoothest: how much each column bends
    place = np.arange(1.0, one.size + 1.0)
    bending = np.tile(np.sqrt(place) if len(one.axes) > 1 else place, len(columns))
    precision = _precision(columns, size, first) * bending**2
    return Term(one, ColumnGroup(columns, np.diag(precision), first_column=first))


def _precision(columns: Channels, size: Array, first: Mapping[int, int] = {}) -> Array:
    """Inverse variance (k,) of coefficients whose torque is about `LIKELY` times `size`."""
    result = np.full(
        max(first.get(c, 0) + X.shape[1] for c, X in columns.items()), 1e-300
    )
    for c, X in columns.items():
        if len(X):
            own = result[first.get(c, 0) :][: X.shape[1]]
            np.maximum(own, np.mean(X**2, axis=0) / (LIKELY * size[c]) ** 2, out=own)
    return np.asarray(np.maximum(result, UNSHOWN**2 * result.max()))
