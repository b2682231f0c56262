"""Dependence of parameters on the low-pass cut-off, and what it adds to their errors.

Parallel filtering makes the equation exact at every cut-off. Noise in the regressor
(encoders differentiated twice), elasticity and friction that lags make it differ from
one to the next. The estimates theta_1, theta_2 of the same logs at neighbouring
cut-offs share most of their noise, so the covariance of their difference is that of the
difference of their jackknife moves, block by block, and of their sensitivities to
friction (J. A. Hausman, "Specification tests in econometrics", Econometrica 46(6),
1978, in the form that needs neither estimate to be efficient):

    V = cov(m_1 - m_2) + sum_j (T_1j - T_2j) cov(c_j) (T_1j - T_2j)',
    W = d' V^+ d,   d = theta_1 - theta_2.

What of d is beyond its own noise, a share 1 - p / W of its square, counts as an error
of theta.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from msgspec.structs import replace

from seqid_cli.identify.regression.least_squares import Solution, spread_of
from seqid_cli.identify.rigid.posterior import Posterior, Surfaces, friction_covariance
from seqid_cli.identify.settings import CutoffCheckSettings
from seqid_cli.params.schema import RigidStage, Verdict
from seqid_cli.robot.base_parameters import Basis
from seqid_cli.typing import Array

Result = tuple[Solution, Posterior]
# Directions in which the covariance of a difference is below this share of its largest
# are rounding.
FLAT = 1e-9


@dataclass(frozen=True, kw_only=True)
class Difference:
    """A parameter that is another at another cut-off.

    `place` is the parameter's, `multiple` that of the cut-off, `n_errors` the
    difference in stated standard errors.
    """

    place: int
    multiple: float
    n_errors: float


@dataclass(frozen=True, kw_only=True)
class CutoffDependence:
    """Change beyond noise by other cut-offs: directions (p, d), and its notes."""

    directions: Array
    differences: list[Difference]


def cutoff_check(
    used: Result,
    neighbours: Mapping[float, Result],
    surfaces: Surfaces,
    settings: CutoffCheckSettings = CutoffCheckSettings(),
) -> CutoffDependence:
    """Compare an estimate with those at other cut-offs.

    Parameters
    ----------
    used : Result
        Solution and posterior at the cut-off in use.
    neighbours : mapping of float to Result
        The same by multiple of the cut-off.
    surfaces : sequence of FrictionSurface or None
        Of the joints.
    settings : CutoffCheckSettings
        From how many of its own errors a difference is noted.

    Returns
    -------
    CutoffDependence
        Directions of one standard deviation each.
    """
    solution, posterior = used
    size = len(solution.theta)
    stated = np.sqrt(np.maximum(np.diag(posterior.covariance), 0.0))
    excess: list[Array] = []
    differences: list[Difference] = []
    for multiple, (neighbour, neighbour_posterior) in neighbours.items():
        if solution.moves.shape != neighbour.moves.shape:  # their blocks are not alike
            continue
        change = neighbour.theta - solution.theta
        by_friction = {
            j: neighbour_posterior.friction[j] - moves
            for j, moves in posterior.friction.items()
            if j in neighbour_posterior.friction
        }
        V = spread_of(neighbour.moves - solution.moves)
        V = V + friction_covariance(by_friction, surfaces, size)

        determined = solution.determined & neighbour.determined
        share = _excess(change[determined], V[np.ix_(determined, determined)])
        excess.append(np.where(determined, change, 0.0) * share)
        std_error = np.sqrt(np.maximum(np.diag(V), 0.0))
        noted = determined & (np.abs(change) > settings.noted_sigma * std_error)
        differences += [
            Difference(
                place=int(k),
                multiple=multiple,
                n_errors=float(change[k] / max(stated[k], 1e-300)),
            )
            for k in np.flatnonzero(noted)
        ]
    directions = np.zeros((size, 0))
    if excess:
        directions = np.array(excess).T / np.sqrt(len(excess))
    return CutoffDependence(directions=directions, differences=differences)


def _excess(change: Array, V: Array) -> float:
    """Return the root of the share of a difference (k,) that V leaves unexplained.

    V is the covariance of the difference.
    """
    scale = np.sqrt(np.maximum(np.diag(V), 1e-300))
    value, vector = np.linalg.eigh(V / np.outer(scale, scale))
    is_seen = value > FLAT * max(float(value.max(initial=0.0)), 1e-300)
    along = vector[:, is_seen].T @ (change / scale)
    W = float(np.sum(along**2 / value[is_seen]))
    if W <= 0:
        return 0.0
    return float(np.sqrt(max(0.0, 1.0 - float(is_seen.sum()) / W)))


def with_cutoff_check(
    stage: RigidStage,
    differences: Sequence[Difference],
    basis: Basis,
    settings: CutoffCheckSettings = CutoffCheckSettings(),
) -> RigidStage:
    """Note the parameters that depend on the cut-off.

    The verdict is usable where a parameter does by `usable_sigma`.

    Their standard errors have the difference in them: the torque is predicted, but
    something that the model lacks shows.
    """
    stated = {p.name for p in stage.parameters}
    noted = [
        difference
        for difference in differences
        # the rest are nuisances, or of another stage
        if difference.place < basis.size and basis.names[difference.place] in stated
    ]
    if not noted:
        return stage

    text = ", ".join(
        f"{basis.names[x.place]} by {x.n_errors:+.1f} at {x.multiple:g} times"
        for x in noted
    )
    note = f"parameters that depend on the cut-off, in stated standard errors: {text}"
    verdicts = list(stage.verdicts)
    if any(abs(x.n_errors) >= settings.usable_sigma for x in noted):
        reason = (
            f"{note}. Noise of the encoders' acceleration or something that the model"
            " lacks; use accelerometers, a finer encoder or slower moves, or look for"
            " effects (seqid diagnose)"
        )
        verdicts.append(Verdict(good=False, level="usable", reason=reason))
    return replace(stage, notes=[*stage.notes, note], verdicts=verdicts)
