"""Link parameters of bodies that can exist, with the identified torque, near to CAD.

Unknown are the pseudo-inertias J_i of the links and the rotor inertias that were
identified. With L_i L_i' = the expected J_i and J_i = L_i S_i L_i', the distance to
what is expected is

    D = sum_i tr(S_i) - log det S_i,

the Bregman divergence of the log-determinant: it is zero slope at S_i = 1, grows
without bound towards bodies that cannot exist, and depends neither on units nor on
frames (Lee, Wensing, Park, "Geometric robot dynamic identification: a convex
programming approach", T-RO 2020). Then

    minimise D   subject to   E phi = pi,   S_i >= margin,   rotors >= 0,

E phi being the identified base parameters. Where no body has them, the nearest in units
of their covariance C are found first,  r* = min |C^-1/2 (pi - E phi)|,  and D is
minimised within

    |C^-1/2 (pi - E phi)|^2 <= r*^2 + 1,

among all that the data tell from the nearest by less than one standard error: the
nearest itself lies on the boundary of what can exist, where a link has lost its mass or
an axis to the noise. Both are conic problems: log det by a semidefinite block of twice
the size and four exponential cones.

The solver's variables v are, in this order,

    of each link the 10 entries of S_i, upper triangle by columns;
    of each link the 10 entries of a lower triangular factor Z_i, by columns;
    of each link 4 logarithms t_k <= log Z_kk;
    the rotor inertias over their typical sizes.

In the code n is the number of links, k that of rotors, b that of base parameters.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import clarabel
import numpy as np

from seqid_cli.errors import QualityError
from seqid_cli.model.bodies.pseudo_inertia import pseudo_inertia, standard_of
from seqid_cli.robot.types import Array

# Least eigenvalue of S: share of the expected pseudo-inertia that is always there.
MARGIN = 1e-3

# Entries of a triangle of a 4 by 4 matrix, column after column.
_UPPER = tuple((i, j) for j in range(4) for i in range(j + 1))
_LOWER = tuple((i, j) for j in range(4) for i in range(j, 4))

# Variables of each link.
_ENTRIES = 10
_FACTORS = 10
_LOGS = 4
_PER_LINK = _ENTRIES + _FACTORS + _LOGS


class Consistent(NamedTuple):
    """Parameters that can exist.

    `links` (n, 10) are standard parameters, `rotors` (k,) inertias kg m^2; `is_exact`
    says whether their torque is what was identified.
    """

    links: Array
    rotors: Array
    is_exact: bool


def consistent_links(
    J: Array, rotors: Array, E: Array, G: Array, values: Array, whitening: Array
) -> Consistent:
    """Find physically consistent parameters with the identified torque.

    Where there are none, the nearest to it are found.

    Parameters
    ----------
    J : Array
        (n, 4, 4), expected pseudo-inertias, positive definite.
    rotors : Array
        (k,), typical sizes of the rotor inertias [kg m^2], positive; they scale the
        problem.
    E, G : Array
        (b, 10 n) and (b, k), the base parameters per standard parameter of the links
        and per rotor.
    values : Array
        (b,), the identified base parameters.
    whitening : Array
        (b, b), turns a residual into independent standard errors.

    Raises
    ------
    QualityError
        The solver finds nothing, as numbers of wildly different sizes can bring about.
    """
    n = len(J)
    T = _standard_by_entries(J)
    B = np.zeros((len(values), _PER_LINK * n + len(rotors)))
    B[:, : _ENTRIES * n] = E @ T
    B[:, _PER_LINK * n :] = G * rotors

    # Equations are scaled to rows of unit length.
    size = np.linalg.norm(B, axis=1)
    size = np.where(size > 0.0, size, 1.0)
    problem = _Problem(
        n=n,
        T=T,
        rotors=rotors,
        B=B / size[:, None],
        values=values / size,
        W=whitening * size,
    )
    solution = problem.exact() or problem.nearest()
    if solution is None:
        hint = (
            "Check the robot file against the arm; compare the file with seqid predict."
        )
        message = (
            "no physically consistent link parameters were found for these base"
            " parameters"
        )
        raise QualityError(message, hint=hint)
    return solution


def _standard_by_entries(J: Array) -> Array:
    """Return T (10 n, 10 n), the links' standard parameters per entry of the S_i."""
    n = len(J)
    T = np.zeros((10 * n, 10 * n))
    for i, L in enumerate(np.linalg.cholesky(J)):
        of_link = slice(10 * i, 10 * i + 10)
        for c, (a, b) in enumerate(_UPPER):
            unit = np.zeros((4, 4))
            unit[a, b] = 1.0
            unit[b, a] = 1.0
            T[of_link, 10 * i + c] = standard_of(L @ unit @ L.T)
    return T


def nearest_body(
    phi: Array, whitening: Array, *, margin: float = 1e-7, reach: float = np.inf
) -> tuple[Array, float]:
    """Find the body whose parameters are nearest to an estimate.

    Parameters
    ----------
    phi : Array
        (10,), estimated standard parameters.
    whitening : Array
        (10, 10), turns a difference into independent standard errors.
    margin : float
        Least eigenvalue of the pseudo-inertia, scaled.
    reach : float
        How far from the frame's origin the centre of mass may be [m].

    Returns
    -------
    tuple of Array and float
        Standard parameters (10,) of the body, and the length of their difference from
        the estimate in standard errors: a convex function of the pseudo-inertia.

    Raises
    ------
    QualityError
        The solver finds nothing.
    """
    # Unknown are the difference y in standard errors and its length: phi + W^-1 y is a
    # body.
    inverse = np.asarray(np.linalg.inv(whitening).T, dtype=np.float64)
    steps = pseudo_inertia(inverse)
    J = pseudo_inertia(phi)

    # Scaled by what the entries may become, the diagonal is of the order of one.
    largest = np.abs(J) + np.sqrt(np.sum(steps**2, axis=0))
    scale = np.sqrt(np.outer(largest.diagonal(), largest.diagonal()))
    by_difference = np.array([_upper(step / scale) for step in steps])

    length_first = np.eye(11)[[10, *range(10)]]
    body = np.column_stack([-by_difference.T, np.zeros(10)])
    cones: list[_Cone] = [
        (clarabel.SecondOrderConeT(11), -length_first, np.zeros(11)),
        (clarabel.PSDTriangleConeT(4), body, _upper(J / scale - margin * np.eye(4))),
    ]
    if np.isfinite(reach):
        # The first moment is no longer than the mass times the reach.
        weight = np.array([reach, 1.0, 1.0, 1.0]) / max(reach * scale[3, 3], 1e-300)
        of_moment = np.column_stack([-(inverse[:, :4] * weight).T, np.zeros(4)])
        cones.append((clarabel.SecondOrderConeT(4), of_moment, phi[:4] * weight))
    solution = _solved(np.eye(11)[10], cones)
    if solution is None:
        hint = "Record more moves with the payload, of more joints."
        raise QualityError(
            "no body was found near the estimate of the payload", hint=hint
        )
    difference = np.linalg.solve(whitening, solution[:10])
    return phi + difference, float(solution[10])


def _upper(matrix: Array) -> Array:
    """Return the triangle of a symmetric matrix as clarabel has it.

    Entries beside the diagonal are times the square root of two.
    """
    entries = []
    for a, b in _UPPER:
        weight = 1.0 if a == b else np.sqrt(2.0)
        entries.append(matrix[a, b] * weight)
    return np.array(entries)


_Cone = tuple[object, Array, Array]  # rows A v + s = b, s in a cone of a kind


def _triangle(place: Mapping[tuple[int, int], int], size: int, width: int) -> Array:
    """Return the rows of a symmetric matrix of variables, as clarabel has it.

    `place` says which variable the entry (a, b), a <= b, is; others are zero.
    """
    A = np.zeros((size * (size + 1) // 2, width))
    for (a, b), column in place.items():
        row = b * (b + 1) // 2 + a
        A[row, column] = -1.0 if a == b else -np.sqrt(2.0)
    return A


@dataclass(frozen=True, kw_only=True)
class _Problem:
    """The conic problem in the variables v of the module's text.

    Attributes
    ----------
    n : int
        Number of links.
    T : Array
        (10 n, 10 n), the links' standard parameters per entry of the S_i.
    rotors : Array
        (k,) kg m^2, typical sizes.
    B : Array
        (b, v), the base parameters per variable; rows are scaled to a length of 1.
    values : Array
        (b,), the identified base parameters, scaled alike.
    W : Array
        (b, b), whitens them.
    """

    n: int
    T: Array
    rotors: Array
    B: Array
    values: Array
    W: Array

    @property
    def variables(self) -> int:
        """Length of v."""
        return int(self.B.shape[1])

    def exact(self) -> Consistent | None:
        """Minimise D with every base parameter met; None where no body has them."""
        equations: _Cone = (clarabel.ZeroConeT(len(self.B)), self.B, self.values)
        cones = [equations, *self._domain(), *self._logarithms()]
        v = _solved(self._costs(), cones)
        return None if v is None else self._met(v)

    def nearest(self, *, alike: float = 1.0) -> Consistent | None:
        """Come as near as possible, then minimise D among what the data cannot tell.

        `alike` is added to the least squared distance, in squared standard errors.
        """
        within = [self._ball(None), *self._domain(extra=1)]
        radius_alone = np.append(np.zeros(self.variables), 1.0)
        closest = _solved(radius_alone, within)
        if closest is None:
            return None

        radius = float(np.sqrt(closest[-1] ** 2 + alike))
        cones = [self._ball(radius), *self._domain(), *self._logarithms()]
        near = _solved(self._costs(), cones)
        return self._consistent(closest[:-1] if near is None else near)

    def _costs(self, *, rotor_cost: float = 1e-3) -> Array:
        """Return the cost (v,) of each variable, so that their sum is D."""
        is_diagonal = [a == b for a, b in _UPPER]
        cost = np.zeros(self.variables)
        cost[: _ENTRIES * self.n] = np.tile(is_diagonal, self.n)
        cost[2 * _ENTRIES * self.n : _PER_LINK * self.n] = -1.0
        cost[_PER_LINK * self.n :] = rotor_cost
        return cost

    def _ball(self, radius: float | None) -> _Cone:
        """Return the cone of |W (values - B v)| <= radius.

        Without a radius, the variable after the last one is the radius.
        """
        is_free = radius is None
        rows = np.zeros((len(self.B) + 1, self.variables + is_free))
        rows[1:, : self.variables] = self.W @ self.B
        b = np.concatenate([[radius or 0.0], self.W @ self.values])
        if is_free:
            rows[0, -1] = -1.0
        return clarabel.SecondOrderConeT(len(b)), rows, b

    def _domain(self, extra: int = 0) -> list[_Cone]:
        """Return cones for S_i - margin positive definite, and rotors not negative."""
        width = self.variables + extra
        margin = np.array([-MARGIN if a == b else 0.0 for a, b in _UPPER])
        cones: list[_Cone] = []
        for i in range(self.n):
            place = {entry: _ENTRIES * i + c for c, entry in enumerate(_UPPER)}
            rows = _triangle(place, 4, width)
            cones.append((clarabel.PSDTriangleConeT(4), rows, margin))

        n_rotors = len(self.rotors)
        if n_rotors:
            rows = -np.eye(n_rotors, width, _PER_LINK * self.n)
            cones.append(
                (clarabel.NonnegativeConeT(n_rotors), rows, np.zeros(n_rotors))
            )
        return cones

    def _logarithms(self) -> list[_Cone]:
        """Return cones by which the logs sum to no more than log det S_i.

        [S Z; Z' diag(Z)] is positive definite with Z lower triangular, t_k <= log Z_kk
        (Ben-Tal and Nemirovski, 2001, sec. 4.2).
        """
        cones: list[_Cone] = []
        for i in range(self.n):
            first_entry = _ENTRIES * i
            first_factor = _ENTRIES * self.n + _FACTORS * i
            first_log = 2 * _ENTRIES * self.n + _LOGS * i

            place = {entry: first_entry + c for c, entry in enumerate(_UPPER)}
            for c, (a, b) in enumerate(_LOWER):
                place[a, 4 + b] = first_factor + c
                if a == b:
                    place[4 + a, 4 + a] = first_factor + c
            block = _triangle(place, 8, self.variables)
            cones.append((clarabel.PSDTriangleConeT(8), block, np.zeros(36)))

            for k in range(_LOGS):
                rows = np.zeros((3, self.variables))
                rows[0, first_log + k] = -1.0
                rows[2, place[4 + k, 4 + k]] = -1.0
                cones.append(
                    (clarabel.ExponentialConeT(), rows, np.array([0.0, 1.0, 0.0]))
                )
        return cones

    def _met(self, v: Array, *, max_residual: float = 1e-7) -> Consistent | None:
        """Take the solver's last digits out of the equations.

        None where that breaks a body, or moves it by more than digits.
        """
        free = np.r_[: _ENTRIES * self.n, _PER_LINK * self.n : self.variables]
        polished = v.copy()
        for _ in range(2):
            residual = self.values - self.B @ polished
            polished[free] += np.linalg.lstsq(self.B[:, free], residual, rcond=None)[0]

        residual = np.abs(self.values - self.B @ polished).max(initial=0.0)
        moved = np.abs(polished - v)[free].max(initial=0.0)
        scale = 1.0 + np.abs(self.values).max(initial=0.0)

        S = np.zeros((self.n, 4, 4))
        for c, (a, b) in enumerate(_UPPER):
            entries = polished[c : _ENTRIES * self.n : _ENTRIES]
            S[:, a, b] = entries
            S[:, b, a] = entries
        are_bodies = (np.linalg.eigvalsh(S)[:, 0] > 0.5 * MARGIN).all()
        are_rotors = (polished[_PER_LINK * self.n :] > -1e-9).all()
        is_met = residual <= max_residual * scale and moved <= 1e-4 * scale
        if not (is_met and are_bodies and are_rotors):
            return None
        return self._consistent(polished, is_exact=True)

    def _consistent(self, v: Array, *, is_exact: bool = False) -> Consistent:
        """Return the parameters of a solution v."""
        links = (self.T @ v[: _ENTRIES * self.n]).reshape(self.n, 10)
        scaled_rotors = np.maximum(v[_PER_LINK * self.n : self.variables], 0.0)
        return Consistent(links, scaled_rotors * self.rotors, is_exact)


def _solved(cost: Array, cones: Sequence[_Cone]) -> Array | None:
    """Minimise a linear cost over cones; None without a solution."""
    from scipy import sparse

    settings = clarabel.DefaultSettings()
    settings.verbose = False
    settings.max_threads = 1
    settings.chordal_decomposition_enable = False

    kinds = [kind for kind, _, _ in cones]
    A = sparse.csc_matrix(np.vstack([rows for _, rows, _ in cones]))
    b = np.concatenate([right for _, _, right in cones])
    no_quadratic = sparse.csc_matrix((len(cost), len(cost)))
    solver = clarabel.DefaultSolver(no_quadratic, cost, A, b, kinds, settings)

    solution = solver.solve()
    is_solved = solution.status in (
        clarabel.SolverStatus.Solved,
        clarabel.SolverStatus.AlmostSolved,
    )
    if not is_solved:
        return None
    v = np.array(solution.x)
    return v if np.isfinite(v).all() else None
