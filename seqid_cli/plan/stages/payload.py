"""Plan the logs of `seqid payload`: the body at the flange, told from changed friction.

The unknowns are the body's ten standard parameters phi (the columns H E_n of the last
link) and the two changes of each joint's friction that the payload stage frees.

The model's own parameters are uncertain by root root'. What they do to the torque is
taken for the body: with the columns X of the unknowns, D their information per (N m)^2
and C their covariance by noise, the unknowns move by C (X' D H) root.
"""

from dataclasses import dataclass, fields, replace

import numpy as np

from seqid_cli.params.results.plan import PredictedParameter
from seqid_cli.params.schema import Stages
from seqid_cli.payload.options import PayloadOptions
from seqid_cli.payload.rows import FRICTION_TERMS
from seqid_cli.plan.belief import Belief
from seqid_cli.plan.moves.fourier import Moves
from seqid_cli.plan.nuisance import move_terms
from seqid_cli.plan.options import PlanOptions
from seqid_cli.plan.stages.goal import (
    Goal,
    Planned,
    predicted_stage,
    rank_and_condition,
    with_criterion,
)
from seqid_cli.plan.stages.inertia import StageRows
from seqid_cli.plan.stages.search import optimised
from seqid_cli.robot.base_parameters import STANDARD, parameter_unit
from seqid_cli.robot.regressor import PER_LINK
from seqid_cli.robot.types import Array


@dataclass(frozen=True, kw_only=True)
class LoadedBelief(Belief):
    """Belief whose unknowns are the body at the flange and the changes of friction."""

    def columns(self, moves: Moves, H: Array) -> Array:
        """Return the columns of the unknowns.

        Parameters
        ----------
        moves : Moves
            Samples of M moves.
        H : (M, N, n, b) float
            Their rows of the base parameters.

        Returns
        -------
        (M, N, n, 10 + 2 n) array
            The body's parameters, then of each joint the change of its friction and
            that which grows with the speed.
        """
        M, N, n = moves.q.shape
        X = np.zeros((M, N, n, PER_LINK + FRICTION_TERMS * n))
        X[..., :PER_LINK] = H @ self.basis.last_link
        for j, surface in enumerate(self.surfaces):
            if surface is None:
                continue
            q = moves.q[..., j].ravel()
            dq = moves.dq[..., j].ravel()
            torque = surface.torque(q, dq).reshape(M, N)
            first = PER_LINK + FRICTION_TERMS * j
            X[:, :, j, first] = torque
            X[:, :, j, first + 1] = (
                torque * np.abs(moves.dq[..., j]) / self.limits.speed[j]
            )
        return X

    def information(self, moves: Moves, H: Array) -> Array:
        """Return the information (M, 10 + 2 n, 10 + 2 n) on the unknowns."""
        return super().information(moves, self.columns(moves, H))


def loaded(belief: Belief, mass: float, *, lever: float = 0.1) -> LoadedBelief:
    """Put a body at the flange.

    Parameters
    ----------
    belief : Belief
        Of the robot without it.
    mass : float
        Its mass [kg].
    lever : float
        Distance of its centre from the last joint, within which it is uncertain [m].

    Returns
    -------
    LoadedBelief
    """
    # Nothing is known of the body; of changes of friction the payload stage's prior.
    of_body = np.zeros(PER_LINK)
    n_changes = FRICTION_TERMS * belief.robot.n
    of_friction = np.full(n_changes, 1.0 / PayloadOptions.friction_change**2)
    prior = np.diag(np.append(of_body, of_friction))

    # The same knowledge, but on other unknowns.
    content = {field.name: getattr(belief, field.name) for field in fields(belief)}
    without_mass = LoadedBelief(**{**content, "prior": prior})
    if belief.theta is None or mass == 0.0:
        return without_mass

    E = belief.basis.last_link
    theta = belief.theta + mass * E[:, 0]
    first_moments = mass * lever * E[:, 1:4]
    root = np.hstack([belief.covariance_root, first_moments])
    return replace(without_mass, theta=theta, covariance_root=root)


def plan_payload(belief: Belief, stages: Stages, options: PlanOptions) -> Planned:
    """Choose the moves that tell mass, centre and inertia of the body best.

    Parameters
    ----------
    belief : Belief
        Of the robot without the body.
    stages : Stages
        What is identified already.
    options : PlanOptions

    Returns
    -------
    Planned
    """
    with_load = loaded(belief, options.load_kg)
    goal = _goal_of_body(with_load, options)
    nothing = np.zeros_like(goal.W)
    search = optimised(with_load, goal, options, nothing, "payload")

    samples = search.samples
    H = belief.regressor(samples)
    rows = StageRows(
        moves=samples,
        H=with_load.columns(samples, H),
        weights=belief.weights(samples),
        terms=move_terms,
        rates=with_load.torque_rates(samples),
    )
    total = search.information.sum(axis=0)
    C = goal.covariance(total - goal.scaled(rows.lost(belief)))

    # The noise's part of the errors, and that of the model's own parameters.
    X_D_H = np.einsum("mnjk,mnj,mnjb->kb", rows.H, rows.weights, H, optimize=True)
    moved = C @ X_D_H @ belief.covariance_root
    std_errors = np.sqrt(np.diag(C) + np.sum(moved**2, axis=1))

    # Changes of friction come behind the body's parameters; they are not listed.
    parameters = [
        PredictedParameter(
            name=f"payload_{kind}",
            joint=belief.robot.joint_names[-1],
            unit=parameter_unit(f"{kind}_1"),
            std_error=float(std_error),
            value=None,
            expression=f"payload_{kind}",
        )
        for kind, std_error in zip(STANDARD, std_errors, strict=False)
    ]
    is_body = np.arange(len(goal.W)) < PER_LINK
    stage = predicted_stage(
        goal,
        have=nothing,
        each=search.information,
        parameters=parameters,
        wanted=is_body,
        seconds=options.length_s,
    )
    stage.structural_rank, _ = rank_and_condition(goal.W[np.ix_(is_body, is_body)])
    return Planned(search.moves, with_criterion(stage, goal, total))


def _goal_of_body(with_load: LoadedBelief, options: PlanOptions) -> Goal:
    """Return the goal of a small torque error by the body alone, not by friction."""
    goal = Goal.of(with_load, options.seed)
    W = goal.W.copy()
    W[PER_LINK:] = 0.0
    W[:, PER_LINK:] = 0.0
    return replace(goal, W=W)
