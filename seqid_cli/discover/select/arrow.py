"""Precisions of parameters of which most meet none but their own group's.

Friction of a joint is seen in that joint's channels alone. So the parameters of two
joints' friction meet only in what all share: the rigid body, nuisances, terms. With the
shared ones last, the precision of all is

    M = [A_1          C_1]
        [     ...     ...]
        [         A_g C_g]
        [C_1' ... C_g'  S],

and with A_j = L_j L_j' its root follows from small ones:

    W_j = L_j^-1 C_j,   S - sum W_j' W_j = L L'.

That takes a fraction of the time and memory that the root of M as a whole would take,
and there is one for every block of time that is left out. In shapes, p is the number of
all parameters, k that of a group with own channels, s that of the shared ones.
"""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.linalg import solve_triangular

from seqid_cli.discover.select.algebra import RIDGE
from seqid_cli.typing import Array, Index

# parameters of a group, below which a root of its own costs more than it saves
FEWEST = 24


@dataclass(frozen=True, eq=False)
class Layout:
    """Which parameters are seen in channels of their own.

    Attributes
    ----------
    own : tuple of slice
        The parameters of each group that has channels of its own.
    shared : (s,) index array
        All others.
    """

    own: tuple[slice, ...]
    shared: Index

    @classmethod
    def of(
        cls,
        where: Sequence[slice],
        channels: Sequence[Collection[int]],
        may_be_own: Sequence[bool],
    ) -> Layout:
        """Give channels to groups of parameters, to the largest first.

        Parameters
        ----------
        where : sequence of slice
            The parameters of each group; those of all groups are 0 to p - 1.
        channels : sequence of collection of int
            By group, in which it is seen.
        may_be_own : sequence of bool
            By group, whether its prior ties it to no other one.
        """
        size = where[-1].stop if where else 0
        is_shared = np.ones(size, dtype=bool)
        own: list[slice] = []
        taken: set[int] = set()
        largest_first = sorted(
            range(len(where)), key=lambda g: where[g].start - where[g].stop
        )
        for group in largest_first:
            at = where[group]
            is_large = at.stop - at.start >= FEWEST
            if is_large and may_be_own[group] and not taken & set(channels[group]):
                own.append(at)
                taken |= set(channels[group])
                is_shared[at] = False
        return cls(own=tuple(own), shared=np.flatnonzero(is_shared))

    @cached_property
    def shared_place(self) -> Index:
        """Place (p,) of each parameter among the shared ones; -1 of all others."""
        size = len(self.shared) + sum(at.stop - at.start for at in self.own)
        place = np.full(size, -1, dtype=np.intp)
        place[self.shared] = np.arange(len(self.shared))
        return place

    def arrow(self, matrix: Array) -> Arrow:
        """Take the parts of a symmetric matrix (p, p) of this form."""
        return Arrow(
            layout=self,
            own=[matrix[at, at].copy() for at in self.own],
            cross=[matrix[at][:, self.shared] for at in self.own],
            shared=matrix[np.ix_(self.shared, self.shared)],
        )

    def place(self, index: Index) -> Place:
        """Return where the parameters (p_c,) of one channel stand in the parts."""
        number = None
        is_own = np.zeros(len(index), dtype=bool)
        first = 0
        for group, at in enumerate(self.own):
            in_group = (index >= at.start) & (index < at.stop)
            if in_group.any():
                number, is_own, first = group, in_group, at.start
        return Place(
            number=number,
            of_own=np.flatnonzero(is_own),
            own=index[is_own] - first,
            of_shared=np.flatnonzero(~is_own),
            shared=self.shared_place[index[~is_own]],
        )


@dataclass(frozen=True, eq=False, kw_only=True)
class Place:
    """Where the parameters of one channel stand in the parts of an arrow.

    Attributes
    ----------
    number : int, optional
        Of the group whose own channel it is; None where it has no such group.
    of_own, of_shared : (., ) index arrays
        Which of the channel's parameters belong to the group, and which are shared.
    own, shared : (., ) index arrays
        Their places there.
    """

    number: int | None
    of_own: Index
    own: Index
    of_shared: Index
    shared: Index


@dataclass(frozen=True, eq=False, kw_only=True)
class Arrow:
    """A symmetric matrix, by its parts.

    Attributes
    ----------
    layout : Layout
        Which parameters are where.
    own : list of (k, k) arrays
        Of each group by itself.
    cross : list of (k, s) arrays
        Of each group with the shared parameters.
    shared : (s, s) array
        Of the shared parameters.
    """

    layout: Layout
    own: list[Array]
    cross: list[Array]
    shared: Array

    def copy(self) -> Arrow:
        """Return the same with parts of its own."""
        return Arrow(
            layout=self.layout,
            own=[part.copy() for part in self.own],
            cross=[part.copy() for part in self.cross],
            shared=self.shared.copy(),
        )

    def add(self, place: Place, change: Array) -> None:
        """Add a symmetric matrix (p_c, p_c) of one channel's parameters, in place."""
        among_shared = change[np.ix_(place.of_shared, place.of_shared)]
        self.shared[np.ix_(place.shared, place.shared)] += among_shared
        if place.number is None:
            return
        among_own = change[np.ix_(place.of_own, place.of_own)]
        self.own[place.number][np.ix_(place.own, place.own)] += among_own
        between = change[np.ix_(place.of_own, place.of_shared)]
        self.cross[place.number][np.ix_(place.own, place.shared)] += between

    def factored(self) -> ArrowFactor:
        """Factor the matrix, whose rows and columns are scaled."""
        roots = [_root(part) for part in self.own]
        cross = [
            _solved(root, part) for root, part in zip(roots, self.cross, strict=True)
        ]
        remaining = self.shared.copy()
        for part in cross:
            remaining -= part.T @ part
        return ArrowFactor(
            layout=self.layout, roots=roots, cross=cross, shared_root=_root(remaining)
        )


@dataclass(frozen=True, eq=False, kw_only=True)
class ArrowFactor:
    """The root R of a matrix R R', by its parts.

    Attributes
    ----------
    layout : Layout
        Which parameters are where.
    roots : list of (k, k) arrays
        L_j, lower triangular.
    cross : list of (k, s) arrays
        W_j.
    shared_root : (s, s) array
        L, lower triangular.
    """

    layout: Layout
    roots: list[Array]
    cross: list[Array]
    shared_root: Array

    @property
    def half_log_det(self) -> float:
        """Half the logarithm of the determinant."""
        roots = [*self.roots, self.shared_root]
        return sum(float(np.sum(np.log(np.diag(root)))) for root in roots)

    def halved(self, right: Array) -> Array:
        """Return R^-1 right of columns (p, m): its square is right' M^-1 right.

        Rows stand as the parameters do.
        """
        result = np.zeros_like(right)
        remaining = right[self.layout.shared]
        for at, root, cross in zip(
            self.layout.own, self.roots, self.cross, strict=True
        ):
            # Most columns are of one joint: a group has none of the others'.
            shown = np.flatnonzero(right[at].any(axis=0))
            if not len(shown):
                continue
            of_group = _solved(root, right[at][:, shown])
            result[at, shown] = of_group
            remaining[:, shown] -= cross.T @ of_group
        result[self.layout.shared] = _solved(self.shared_root, remaining)
        return result

    def solved(self, right: Array) -> Array:
        """Return M^-1 right of columns (p, m)."""
        result = self.halved(right)
        of_shared = _solved(
            self.shared_root, result[self.layout.shared], transposed=True
        )
        result[self.layout.shared] = of_shared
        for at, root, cross in zip(
            self.layout.own, self.roots, self.cross, strict=True
        ):
            result[at] = _solved(root, result[at] - cross @ of_shared, transposed=True)
        return result


def _root(matrix: Array) -> Array:
    """Return the lower triangular root (k, k) of a scaled matrix (k, k)."""
    ridged = matrix.copy()
    ridged[np.diag_indices(len(ridged))] += RIDGE
    return np.asarray(np.linalg.cholesky(ridged), dtype=np.float64)


def _solved(root: Array, right: Array, *, transposed: bool = False) -> Array:
    """Return L^-1 right, or L'^-1 right, of a lower triangular L (k, k)."""
    return np.asarray(
        solve_triangular(
            root,
            right,
            lower=True,
            trans="T" if transposed else "N",
            check_finite=False,
        )
    )
