"""Physical consistency as a constraint of identification.

Least squares does not know that masses are positive. Of all models that bodies with positive
density and rotors of positive inertia can have, the constrained one is the nearest to the
unconstrained in units of its covariance, which is the maximum of the posterior under the
constraint (see `model.bodies.consistent`).
"""

import numpy as np
from msgspec.structs import replace

from seqid_cli.model.bodies.nearest import identified, nearest_bodies
from seqid_cli.params.schema import RigidStage, Stages
from seqid_cli.robot.base_parameters import standard_names
from seqid_cli.robot.types import Robot


def made_consistent(
    stage: RigidStage, stages: Stages, robot: Robot, *, min_move: float = 0.5
) -> RigidStage:
    """Put the parameters of an inertia stage among those that bodies can have.

    Returns: with other values, of which bodies (`representative`) exist; standard errors are those
    of the unconstrained estimate. A note names what moved by `min_move` standard errors or more.
    Raises QualityError if no physically consistent parameters are found.
    """
    found = identified(Stages(gravity=stages.gravity, inertia=stage), robot)
    nearest = nearest_bodies(robot, found)
    moved = {d.name: d for d in found.deviations(nearest.links, nearest.rotor)}
    parameters = [
        replace(p, value=moved[p.name].exported) if p.name in moved else p for p in stage.parameters
    ]
    phi = np.concatenate([nearest.links.ravel(), nearest.rotor])
    names = standard_names(robot.n)
    note = "physically consistent as identified: bodies with these parameters exist"
    if not nearest.exact:
        by = {name: d.std_errors or 0.0 for name, d in moved.items()}
        named = [f"{name} by {x:+.1f}" for name, x in by.items() if abs(x) >= min_move]
        text = ", ".join(named) or f"none by more than {min_move:g}"
        note = f"made physically consistent; moved, in standard errors: {text}"
    return replace(
        stage,
        parameters=parameters,
        representative={name: float(x) for name, x in zip(names, phi, strict=True) if x != 0.0},
        notes=[*stage.notes, note],
    )
