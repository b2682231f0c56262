"""Whether parameters depend on the cut-off of the low-pass, and what that adds to their errors.

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

from collections.abc import Mapping

import numpy as np
from msgspec.structs import replace

from seqid_cli.identify.regression.least_squares import Solution, spread_of
from seqid_cli.identify.rigid.posterior import Posterior, Surfaces, friction_covariance
from seqid_cli.identify.settings import CutoffCheckSettings
from seqid_cli.params.schema import RigidStage, Verdict
from seqid_cli.robot.base_parameters import Basis
from seqid_cli.typing import Array

Result = tuple[Solution, Posterior]
# Parameters by their place, the multiple of the cut-off, the difference in stated
# standard errors.
Differences = list[tuple[int, float, float]]


def cutoff_check(
    own: Result,
    near: Mapping[float, Result],
    surfaces: Surfaces,
    settings: CutoffCheckSettings = CutoffCheckSettings(),
) -> tuple[Array, Differences]:
    """Compare an estimate with others, `near` by multiple of the cut-off.

    Returns directions (p, d) of one standard deviation each, and differences that
    exceed `noted_sigma` of their own errors.
    """
    size = len(own[0].theta)
    stated = np.sqrt(np.maximum(np.diag(own[1].covariance), 0.0))
    excess, differences = [], Differences()
    for factor, other in near.items():
        if own[0].moves.shape != other[0].moves.shape:  # their blocks are not alike
            continue
        d, (first, second) = (
            other[0].theta - own[0].theta,
            (own[1].friction, other[1].friction),
        )
        both = {j: second[j] - first[j] for j in first if j in second}
        V = spread_of(other[0].moves - own[0].moves) + friction_covariance(
            both, surfaces, size
        )
        known = own[0].determined & other[0].determined
        excess.append(
            np.where(known, d, 0.0) * _excess(d[known], V[np.ix_(known, known)])
        )
        error = np.sqrt(np.maximum(np.diag(V), 0.0))
        for k in np.flatnonzero(known & (np.abs(d) > settings.noted_sigma * error)):
            differences.append((int(k), factor, float(d[k] / max(stated[k], 1e-300))))
    errors = (
        np.array(excess).T / np.sqrt(len(excess)) if excess else np.zeros((size, 0))
    )
    return errors, differences


def _excess(d: Array, V: Array, *, flat: float = 1e-09) -> float:
    """Square root of the share of a difference that its own noise does not explain."""
    scale = np.sqrt(np.maximum(np.diag(V), 1e-300))
    value, vector = np.linalg.eigh(V / np.outer(scale, scale))
    kept = value > flat * max(float(value.max(initial=0.0)), 1e-300)
    W = float(np.sum((vector[:, kept].T @ (d / scale)) ** 2 / value[kept]))
    return float(np.sqrt(max(0.0, 1.0 - float(kept.sum()) / W))) if W > 0 else 0.0


def with_cutoff_check(
    stage: RigidStage,
    differences: Differences,
    basis: Basis,
    settings: CutoffCheckSettings = CutoffCheckSettings(),
) -> RigidStage:
    """Note the parameters that depend on the cut-off; usable where one does by `usable_sigma`.

    Their standard errors have the difference in them: the torque is predicted, but
    something that the model lacks shows.
    """
    stated = {p.name for p in stage.parameters}
    # the rest: nuisances
    of_parameters = [one for one in differences if one[0] < basis.size]
    named = [
        (basis.names[k], at, by)
        for k, at, by in of_parameters
        if basis.names[k] in stated
    ]
    text = ", ".join(
        f"{name} by {by:+.1f} at {factor:g} times" for name, factor, by in named
    )
    note = f"parameters that depend on the cut-off, in stated standard errors: {text}"
    reason = (
        f"{note}. Noise of the encoders' acceleration or something that the model"
        " lacks; use accelerometers, a finer encoder or slower moves, or look for"
        " effects (seqid diagnose)"
    )
    notes = list(stage.notes)
    verdicts = list(stage.verdicts)
    if named:
        notes.append(note)
    if any(abs(by) >= settings.usable_sigma for *_, by in named):
        verdicts.append(Verdict(good=False, level="usable", reason=reason))
    return replace(stage, notes=notes, verdicts=verdicts)
