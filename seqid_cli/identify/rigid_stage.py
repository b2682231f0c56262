"""From a least-squares solution to a stage of the parameter file; shared by gravity and inertia."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from seqid_cli.identify.least_squares import Solution
from seqid_cli.params.schema import Parameter, RigidStage
from seqid_cli.robot.base import Basis, standard_names
from seqid_cli.robot.types import Robot

Array = NDArray[np.float64]
Indices = NDArray[np.intp]


def parameters_of(
    robot: Robot, basis: Basis, chosen: Indices, theta: Array, covariance: Array
) -> list[Parameter]:
    """Parameters `chosen` (indices) with standard errors, units and expressions."""
    return [
        Parameter(
            name=basis.names[k],
            value=float(theta[k]),
            std_error=float(np.sqrt(max(covariance[k, k], 0.0))),
            unit=basis.unit(k),
            joint=robot.joint_names[basis.joint_index(k)],
            expression=basis.expression_text(k),
            terms=basis.terms(k),
        )
        for k in (int(k) for k in chosen)
    ]


def representative_of(basis: Basis, theta: Array, rotors: Array) -> dict[str, float]:
    """Standard parameters, zeros left out, that give the model's torque; known rotors included."""
    phi = basis.representative @ theta
    phi[len(phi) - len(rotors) :] += rotors
    names = standard_names(len(rotors))
    return {name: float(x) for name, x in zip(names, phi, strict=True) if x != 0.0}


def not_excited(basis: Basis, solution: Solution, candidates: Indices) -> list[str]:
    """Names of parameters among `candidates` that these data do not determine, with expressions."""
    return [basis.expression_text(int(k)) for k in candidates if not solution.determined[int(k)]]


def empty_stage(note: str, method: str = "sequential") -> RigidStage:
    """A stage with nothing to identify on this robot, which says so."""
    return RigidStage(parameters=[], condition=0.0, rank=0, method=method, notes=[note])
