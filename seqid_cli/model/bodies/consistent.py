"""Link parameters that a body can have, with the identified torque, as near as possible to CAD.

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
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import clarabel
import numpy as np
from scipy import sparse

from seqid_cli.errors import QualityError
from seqid_cli.model.bodies.pseudo_inertia import pseudo_inertia, standard_of
from seqid_cli.robot.types import Array

# least eigenvalue of S: share of the expected pseudo-inertia that is always there
MARGIN = 1e-3

_UPPER = tuple((i, j) for j in range(4) for i in range(j + 1))
_LOWER = tuple((i, j) for j in range(4) for i in range(j, 4))
_ENTRIES, _FACTORS, _LOGS = 10, 10, 4
_PER_LINK = _ENTRIES + _FACTORS + _LOGS


# Links (n, 10) and rotors (k,) kg m^2 that can exist; whether their torque is what was
# identified.
Consistent = tuple[Array, Array, bool]


def consistent_links(
    J: Array, rotors: Array, E: Array, G: Array, values: Array, whitening: Array
) -> Consistent:
    """Find physically consistent parameters with the identified torque, or the nearest to it.

    `J` (n, 4, 4): expected pseudo-inertias, positive definite. `rotors` (k,): typical
    sizes of the rotor inertias [kg m^2], positive; they scale the problem. `E` (b, 10
    n) and `G` (b, k) give the base parameters from the links' standard parameters and
    the rotors, `values` (b,) is what was identified, `whitening` (b, b) turns a
    residual into independent standard errors. Raises QualityError if the solver finds
    nothing, as numbers of wildly different sizes can bring about.
    """
    n = len(J)
    T = np.zeros((10 * n, 10 * n))
    for i, L in enumerate(np.linalg.cholesky(J)):
        for c, (a, b) in enumerate(_UPPER):
            unit = np.zeros((4, 4))
            unit[a, b] = unit[b, a] = 1.0
            T[10 * i : 10 * i + 10, 10 * i + c] = standard_of(L @ unit @ L.T)
    B = np.zeros((len(values), _PER_LINK * n + len(rotors)))
    B[:, : _ENTRIES * n] = E @ T
    B[:, _PER_LINK * n :] = G * rotors
    size = np.linalg.norm(B, axis=1)
    size = np.where(size > 0.0, size, 1.0)
    problem = _Problem(n, T, rotors, B / size[:, None], values / size, whitening * size)
    found = problem.exact() or problem.nearest()
    if found is None:
        hint = (
            "Check the robot file against the arm; compare the file with seqid predict."
        )
        message = (
            "no physically consistent link parameters were found for these base"
            " parameters"
        )
        raise QualityError(message, hint=hint)
    return found


def nearest_body(
    phi: Array, whitening: Array, *, margin: float = 1e-7
) -> tuple[Array, float]:
    """The standard parameters (10,) of a body that are nearest to an estimate `phi` (10,).

    `whitening` (10, 10) turns a difference into independent standard errors. Its
    length, which comes second, is a convex function of the pseudo-inertia. `margin`:
    least eigenvalue of that, scaled. Raises QualityError if the solver finds nothing.
    """
    # Unknown are the difference y in standard errors and its length: phi + W^-1 y is a
    # body.
    steps = pseudo_inertia(np.asarray(np.linalg.inv(whitening).T, dtype=np.float64))
    J = pseudo_inertia(phi)
    reach = np.abs(J) + np.sqrt(np.sum(steps**2, axis=0))
    scale = np.sqrt(np.outer(reach.diagonal(), reach.diagonal()))
    rows = np.array([_upper(step / scale) for step in steps])
    length = np.eye(11)[[10, *range(10)]]
    body = np.column_stack([-rows.T, np.zeros(10)])
    cones: list[_Cone] = [
        (clarabel.SecondOrderConeT(11), -length, np.zeros(11)),
        (clarabel.PSDTriangleConeT(4), body, _upper(J / scale - margin * np.eye(4))),
    ]
    found = _solved(np.eye(11)[10], cones)
    if found is None:
        hint = "Record more moves with the payload, of more joints."
        raise QualityError(
            "no body was found near the estimate of the payload", hint=hint
        )
    return phi + np.linalg.solve(whitening, found[:10]), float(found[10])


def _upper(matrix: Array) -> Array:
    """The triangle of a symmetric matrix as clarabel has it."""
    return np.array(
        [matrix[a, b] * (1.0 if a == b else np.sqrt(2.0)) for a, b in _UPPER]
    )


_Cone = tuple[object, Array, Array]  # rows A v + s = b, s in a cone of a kind


def _triangle(place: Mapping[tuple[int, int], int], size: int, width: int) -> Array:
    """Rows of a symmetric matrix, as clarabel has it; entries (a, b), a <= b, are variables."""
    A = np.zeros((size * (size + 1) // 2, width))
    for (a, b), column in place.items():
        A[b * (b + 1) // 2 + a, column] = -1.0 if a == b else -np.sqrt(2.0)
    return A


@dataclass(frozen=True)
class _Problem:
    """In the variables v: entries of all S, then of the factors of log det, the logs, the rotors.

    `T` (10 n, 10 n) gives the links' standard parameters from the entries, `B` the base
    parameters from v; rows of `B` and `values` are scaled to a norm of 1, `W` whitens
    them.
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
        equations: _Cone = clarabel.ZeroConeT(len(self.B)), self.B, self.values
        v = _solved(self._costs(), [equations, *self._domain(), *self._logarithms()])
        return None if v is None else self._met(v)

    def nearest(self, *, alike: float = 1.0) -> Consistent | None:
        """Come as near as possible, then minimise D among what the data cannot tell from that."""
        within = [self._ball(None), *self._domain(extra=1)]
        least = _solved(np.append(np.zeros(self.variables), 1.0), within)
        if least is None:
            return None
        radius = float(np.sqrt(least[-1] ** 2 + alike))
        near = _solved(
            self._costs(), [self._ball(radius), *self._domain(), *self._logarithms()]
        )
        return self._found(least[:-1] if near is None else near)

    def _costs(self, *, rotor_cost: float = 1e-3) -> Array:
        """Cost (v,) of each variable, so that their sum is D."""
        cost = np.zeros(self.variables)
        cost[: _ENTRIES * self.n] = np.tile([a == b for a, b in _UPPER], self.n)
        cost[2 * _ENTRIES * self.n : _PER_LINK * self.n] = -1.0
        cost[_PER_LINK * self.n :] = rotor_cost
        return cost

    def _ball(self, radius: float | None) -> _Cone:
        """|W (values - B v)| <= radius; without one, the variable after the last is the radius."""
        rows = np.zeros((len(self.B) + 1, self.variables + (radius is None)))
        rows[1:, : self.variables] = self.W @ self.B
        b = np.concatenate([[radius or 0.0], self.W @ self.values])
        if radius is None:
            rows[0, -1] = -1.0
        return clarabel.SecondOrderConeT(len(b)), rows, b

    def _domain(self, extra: int = 0) -> list[_Cone]:
        """S_i - margin positive definite, rotors not negative."""
        width, count = self.variables + extra, len(self.rotors)
        margin = np.array([-MARGIN if a == b else 0.0 for a, b in _UPPER])
        cones: list[_Cone] = []
        for i in range(self.n):
            place = {entry: _ENTRIES * i + c for c, entry in enumerate(_UPPER)}
            cones.append(
                (clarabel.PSDTriangleConeT(4), _triangle(place, 4, width), margin)
            )
        if count:
            rotors = -np.eye(count, width, _PER_LINK * self.n)
            cones.append((clarabel.NonnegativeConeT(count), rotors, np.zeros(count)))
        return cones

    def _logarithms(self) -> list[_Cone]:
        """The logs sum to no more than log det S_i (Ben-Tal and Nemirovski, 2001, sec. 4.2).

        [S Z; Z' diag(Z)] is positive definite with Z lower triangular, t_k <= log Z_kk.
        """
        cones: list[_Cone] = []
        for i in range(self.n):
            S, Z = _ENTRIES * i, _ENTRIES * self.n + _FACTORS * i
            t = 2 * _ENTRIES * self.n + _LOGS * i
            place = {entry: S + c for c, entry in enumerate(_UPPER)}
            place |= {(a, 4 + b): Z + c for c, (a, b) in enumerate(_LOWER)}
            place |= {
                (4 + a, 4 + a): Z + c for c, (a, b) in enumerate(_LOWER) if a == b
            }
            both = _triangle(place, 8, self.variables)
            cones.append((clarabel.PSDTriangleConeT(8), both, np.zeros(36)))
            for k in range(_LOGS):
                A = np.zeros((3, self.variables))
                A[0, t + k] = A[2, place[4 + k, 4 + k]] = -1.0
                cones.append(
                    (clarabel.ExponentialConeT(), A, np.array([0.0, 1.0, 0.0]))
                )
        return cones

    def _met(self, v: Array, *, max_residual: float = 1e-7) -> Consistent | None:
        """Take the solver's last digits out of the equations; None where that breaks a body."""
        free = np.r_[: _ENTRIES * self.n, _PER_LINK * self.n : self.variables]
        polished = v.copy()
        for _ in range(2):
            residual = self.values - self.B @ polished
            polished[free] += np.linalg.lstsq(self.B[:, free], residual, rcond=None)[0]
        left = np.abs(self.values - self.B @ polished).max(initial=0.0)
        moved = np.abs(polished - v)[free].max(initial=0.0)
        scale = 1.0 + np.abs(self.values).max(initial=0.0)
        S = np.zeros((self.n, 4, 4))
        for c, (a, b) in enumerate(_UPPER):
            S[:, a, b] = S[:, b, a] = polished[c : _ENTRIES * self.n : _ENTRIES]
        bodies = (np.linalg.eigvalsh(S)[:, 0] > 0.5 * MARGIN).all()
        possible = bodies and (polished[_PER_LINK * self.n :] > -1e-9).all()
        if left > max_residual * scale or moved > 1e-4 * scale or not possible:
            return None
        return self._found(polished, exact=True)

    def _found(self, v: Array, *, exact: bool = False) -> Consistent:
        phi = (self.T @ v[: _ENTRIES * self.n]).reshape(self.n, 10)
        rotors = np.maximum(v[_PER_LINK * self.n : self.variables], 0.0) * self.rotors
        return phi, rotors, exact


def _solved(cost: Array, cones: Sequence[_Cone]) -> Array | None:
    """Minimise a linear cost over cones; None without a solution."""
    settings = clarabel.DefaultSettings()
    settings.verbose = False
    settings.max_threads = 1
    settings.chordal_decomposition_enable = False
    kinds, rows, right = zip(*cones, strict=True)
    A, b = sparse.csc_matrix(np.vstack(rows)), np.concatenate(right)
    P = sparse.csc_matrix((len(cost), len(cost)))
    solution = clarabel.DefaultSolver(P, cost, A, b, list(kinds), settings).solve()
    if solution.status not in (
        clarabel.SolverStatus.Solved,
        clarabel.SolverStatus.AlmostSolved,
    ):
        return None
    v = np.array(solution.x)
    return v if np.isfinite(v).all() else None
