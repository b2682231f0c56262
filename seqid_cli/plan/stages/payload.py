"""Plan the logs that `seqid payload` needs: the body at the flange, told from changed friction.

The unknowns are the body's ten standard parameters phi (the columns H E_n of the last
link) and the two changes of each joint's friction that the payload stage frees. What
the model's own parameters are uncertain by is passed on: phi is what their torque
leaves.
"""

from dataclasses import dataclass, replace

import numpy as np

from seqid_cli.params.results.plan import PredictedParameter
from seqid_cli.params.schema import Stages
from seqid_cli.payload.fit import FRICTION_TERMS
from seqid_cli.payload.options import PayloadOptions
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


@dataclass(frozen=True)
class LoadedBelief(Belief):
    """A belief whose unknowns are the body at the flange and how friction has changed."""

    def wide(self, moves: Moves, H: Array) -> Array:
        """Columns (M, N, n, 10 + 2 n) of the unknowns."""
        M, N, n = moves.q.shape
        found = np.zeros((M, N, n, PER_LINK + FRICTION_TERMS * n))
        found[..., :PER_LINK] = H @ self.basis.last_link
        for j, surface in enumerate(self.surfaces):
            if surface is None:
                continue
            own, states = (
                PER_LINK + FRICTION_TERMS * j,
                (moves.q[..., j], moves.dq[..., j]),
            )
            torque = surface.torque(*(x.ravel() for x in states)).reshape(M, N)
            found[:, :, j, own] = torque
            found[:, :, j, own + 1] = (
                torque * np.abs(moves.dq[..., j]) / self.limits.speed[j]
            )
        return found

    def information(self, moves: Moves, H: Array) -> Array:
        """Information (M, 10 + 2 n, 10 + 2 n) on the unknowns."""
        return super().information(moves, self.wide(moves, H))


def loaded(belief: Belief, mass: float, *, lever: float = 0.1) -> LoadedBelief:
    """Put a body of `mass` kg at the flange, its centre within some `lever` m of the last joint."""
    # of the body, of changes of friction
    known = 0.0, 1.0 / PayloadOptions.friction_change**2
    prior = np.repeat(known, [PER_LINK, FRICTION_TERMS * belief.robot.n])
    found = LoadedBelief(**{**vars(belief), "prior": np.diag(prior)})
    if belief.theta is None or mass == 0.0:
        return found
    E = belief.basis.last_link
    theta = belief.theta + mass * E[:, 0]
    spread = mass * lever * E[:, 1:4]
    return replace(found, theta=theta, root=np.hstack([belief.root, spread]))


def plan_payload(belief: Belief, stages: Stages, options: PlanOptions) -> Planned:
    """Choose the moves that tell mass, centre and inertia of the body best."""
    whole = loaded(belief, options.load_kg)
    goal = Goal.of(whole, options.seed)
    W = goal.W.copy()
    W[PER_LINK:] = W[:, PER_LINK:] = 0.0
    goal = replace(goal, W=W)
    nothing = np.zeros_like(W)
    moves, dense, each = optimised(whole, goal, options, nothing, "payload")
    H, empty = belief.regressor(dense), loaded(belief, 0.0)
    rows = StageRows(
        moves=dense,
        H=whole.wide(dense, H),
        weights=belief.weights(dense),
        terms=move_terms,
        rates=whole.torque_rates(dense),
    )
    total = each.sum(axis=0)
    C = goal.covariance(total - goal.scaled(rows.lost(belief)))
    # By the model's own parameters, given the noise's alone.
    parts = (empty.wide(dense, H), empty.weights(dense), H)
    moved = C @ np.einsum("mnjk,mnj,mnjb->kb", *parts, optimize=True) @ empty.root
    errors = np.sqrt(np.diag(C) + np.sum(moved**2, axis=1))
    parameters = [
        PredictedParameter(
            name=f"payload_{kind}",
            joint=belief.robot.joint_names[-1],
            unit=parameter_unit(f"{kind}_1"),
            std_error=float(error),
            value=None,
            expression=f"payload_{kind}",
        )
        for kind, error in zip(STANDARD, errors, strict=False)  # friction's come behind
    ]
    body = np.arange(len(W)) < PER_LINK
    stage = predicted_stage(goal, nothing, each, parameters, body, options.length_s)
    stage.structural_rank, _ = rank_and_condition(W[np.ix_(body, body)])
    return Planned(moves, with_criterion(stage, goal, total))
