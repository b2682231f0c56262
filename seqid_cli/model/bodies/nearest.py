"""The bodies nearest to an identified model, in units of its errors."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from seqid_cli.model.bodies.consistent import consistent_links
from seqid_cli.model.bodies.demand import Identified
from seqid_cli.model.bodies.prior import Expected, expected_links
from seqid_cli.robot.base_parameters import gear_ratios
from seqid_cli.robot.types import Array, Robot


@dataclass(frozen=True)
class NearestBodies:
    """Links (n, 10) and rotors (n,) that can exist, whether they meet the identified model.

    `expected` is what stood in where the torque says nothing.
    """

    links: Array
    rotor: Array
    exact: bool
    expected: Expected


def nearest_bodies(robot: Robot, found: Identified, kept: Array | None = None) -> NearestBodies:
    """Find bodies with the identified torque, or the nearest to it.

    `kept` (n, 10): parts of the links that stay as they are; the rest must be able to exist by
    itself. Returns: its links are without `kept`. Raises QualityError if no physically consistent
    parameters are found.
    """
    demand = found.demand
    kept = np.zeros((robot.n, 10)) if kept is None else kept
    own = replace(demand, values=demand.values - demand.E @ kept.ravel())
    expected = expected_links(robot, kept, own.E, own.values)
    ratio = gear_ratios(robot)
    sizes = np.array([_turning(expected.J[j]) / ratio[j] ** 2 for j in found.free])
    bodies = consistent_links(expected.J, sizes, own)
    rotor = found.known.copy()
    rotor[list(found.free)] = bodies.rotors
    return NearestBodies(bodies.phi, rotor, bodies.exact, expected)


def _turning(J: Array) -> float:
    """Size of a link's inertia, kg m^2."""
    return float(np.trace(J[:3, :3]))
