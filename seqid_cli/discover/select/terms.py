"""What a model may lack, as terms: effects with settings, and smooth functions."""

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

    Attributes
    ----------
    what : Candidate or SmoothFunction
        What the model may lack.
    part : ColumnGroup
        Its columns on the rows, and its prior.
    came_since : bool
        Friction trials of the file would have shown it, and did not.
    """

    what: Candidate | SmoothFunction
    part: ColumnGroup
    came_since: bool = False

    @property
    def joint(self) -> int | None:
        """The joint that it is of; None for the whole arm."""
        return self.what.joint

    @property
    def smooth(self) -> bool:
        """Whether it is no effect of the catalogue."""
        return isinstance(self.what, SmoothFunction)

    @cached_property
    def name(self) -> str:
        """Effect, or what the function depends on."""
        if isinstance(self.what, SmoothFunction):
            return self.what.label
        return self.what.effect.name

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
        """Whether it says that the file's values do not hold."""
        return isinstance(self.what, Candidate) and self.what.effect.change

    @property
    def key(self) -> tuple[str, int | None]:
        """Name and joint, whatever the settings."""
        return self.name, self.joint

    @property
    def channels(self) -> frozenset[int]:
        """Channels that it touches."""
        return frozenset(self.part.columns)


def effects(
    stage: CandidateColumns, candidates: Sequence[Candidate], size: Array
) -> list[Term]:
    """Make terms of candidates that have columns on any row.

    Parameters
    ----------
    stage : CandidateColumns
        The data sets; it keeps what has been worked out.
    candidates : sequence of Candidate
        Effects at joints with their settings.
    size : (channels,) array
        What the file leaves [N m; N where prismatic]. No term is likely to be much
        more.
    """
    known = stage.known
    terms: list[Term] = []
    for candidate, columns in zip(candidates, stage.columns(candidates), strict=True):
        if not _has_columns(columns):
            continue

        # An effect apart has coefficients of its own above the cut-off.
        first_column = {}
        if candidate.apart:
            first_column = {
                channel: candidate.size
                for channel in columns
                if channel // stage.rows.n == 1
            }
        if candidate.address not in known:
            in_file, beside_file = stage.in_file(candidate, columns)
            precision = np.diag(_precision(beside_file, size, first_column))
            known[candidate.address] = precision, in_file
        precision, in_file = known[candidate.address]
        part = ColumnGroup(
            columns=columns,
            precision=precision,
            first_column=first_column,
            absorbed_by_file=in_file,
        )
        terms.append(Term(candidate, part, came_since=stage.came_since(candidate)))
    return terms


def _has_columns(columns: Channels) -> bool:
    """Return whether there is a column, with a row at any channel."""
    if not columns:
        return False
    has_column = next(iter(columns.values())).shape[1] > 0
    return has_column and any(len(of_channel) for of_channel in columns.values())


def smooth_term(stage: CandidateColumns, function: SmoothFunction, size: Array) -> Term:
    """Make a term of a smooth function.

    Of a drive it is another one, with coefficients of its own. A measured load holds
    all that acts on the link: of that it explains the drive alone.

    Parameters
    ----------
    stage : CandidateColumns
        The data sets.
    function : SmoothFunction
        What the residual might be.
    size : (channels,) array
        What the file leaves [N m; N where prismatic].
    """
    joint = function.joint
    columns = stage.with_drive({joint: function.columns(stage.rows)})
    if len(columns) > 1 and "load" in function.quantities:
        del columns[joint]
    in_file: dict[int, Array] = {}
    beside_file = columns
    if function.absorbed and stage.file is not None:
        in_file = stage.file.absorbed(joint, function.steady_columns)
        beside_file = stage.beside_file(columns, in_file)
    first_column = {
        channel: function.size
        for channel in columns
        if channel != joint and joint in columns
    }

    # Columns that bend more are likely to be smaller: of two quantities the square root
    # counts, as each alone bends less.
    place = np.arange(1.0, function.size + 1.0)
    of_columns = np.sqrt(place) if len(function.axes) > 1 else place
    bending = np.tile(of_columns, len(columns))
    precision = _precision(beside_file, size, first_column) * bending**2
    part = ColumnGroup(
        columns=columns,
        precision=np.diag(precision),
        first_column=first_column,
        absorbed_by_file=in_file,
    )
    return Term(function, part)


def _precision(
    columns: Channels, size: Array, first_column: Mapping[int, int]
) -> Array:
    """Return the inverse variance (k,) of coefficients beforehand.

    Their torque is about `LIKELY` times `size` (channels,) N m; of channels that share
    a coefficient the one that allows least counts.
    """
    n_coefficients = max(
        first_column.get(channel, 0) + X.shape[1] for channel, X in columns.items()
    )
    precision = np.full(n_coefficients, 1e-300)
    for channel, X in columns.items():
        if len(X):
            first = first_column.get(channel, 0)
            of_channel = precision[first : first + X.shape[1]]
            likely = np.mean(X**2, axis=0) / (LIKELY * size[channel]) ** 2
            np.maximum(of_channel, likely, out=of_channel)
    return np.asarray(np.maximum(precision, UNSHOWN**2 * precision.max()))
