"""Collisions of an arm with itself and with boxes around it, by Pinocchio and coal.

Meshes count by their convex hulls. Neighbouring links are not checked against each other, nor are
links that overlap in most postures: their hulls touch at the joint between them.
"""

import os
import warnings
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import coal
import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from seqid_cli.robot.types import Array, Robot
from seqid_cli.robot.urdf.model import readable
from seqid_cli.robot.urdf.text import read_urdf_text

WALL_M = 20.0  # thickness of the walls around the workspace
Box = Sequence[float]  # x, y, z of one corner, x, y, z of the other, in m in the base frame


@dataclass(frozen=True)
class Geometry:
    """An arm's links and the boxes around it, ready to be checked."""

    model: Any
    data: Any
    shapes: Any
    found: Any

    def collides(self, q: Array) -> NDArray[np.bool_]:
        """Return which of the postures q (N, n) let a pair come nearer than the clearance."""
        places = [pin.integrate(self.model, pin.neutral(self.model), posture) for posture in q]
        arm = self.model, self.data, self.shapes, self.found
        return np.array([pin.computeCollisions(*arm, place, True) for place in places], dtype=bool)


def geometry_of(
    robot: Robot, postures: Array, boxes: Sequence[Box] = (), workspace: Box | None = None,
    *, clearance_m: float = 0.02, usual_contact: float = 0.5,
) -> Geometry | None:  # fmt: skip
    """Read the collision geometry of a URDF.

    `postures` (P, n): drawn ones, by which links that always touch are found. `boxes`: where no
    link may be. `workspace`: out of which no link may reach. `clearance_m`: how near counts as a
    collision, m. `usual_contact`: share of the postures in which links that touch are not checked
    against each other. Returns None where there is no URDF, or its links have no shapes, or a mesh
    is not found.
    """
    if robot.urdf is None:
        return None
    xml = readable(read_urdf_text(robot.urdf))
    whole = pin.buildModelFromXML(xml)
    folders = [str(folder) for folder in robot.urdf.resolve().parents]
    folders += os.environ.get("ROS_PACKAGE_PATH", "").split(os.pathsep)
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            shapes = pin.buildGeomFromUrdfString(whole, xml, pin.COLLISION, folders)
    except ValueError:
        return None
    if not shapes.ngeoms:
        return None
    others = [k for k in range(1, whole.njoints) if whole.names[k] not in robot.joint_names]
    model, shapes = pin.buildReducedModel(whole, shapes, others, pin.neutral(whole))
    for shape in shapes.geometryObjects:
        if isinstance(shape.geometry, coal.BVHModelBase):
            shape.geometry.buildConvexHull(True, "Qt")
            shape.geometry = shape.geometry.convex
    count = shapes.ngeoms
    parents = [shape.parentJoint for shape in shapes.geometryObjects]
    for a in range(count):
        for b in range(a):
            if abs(parents[a] - parents[b]) > 1:
                shapes.addCollisionPair(pin.CollisionPair(b, a))
    _without_usual_contact(model, shapes, postures, clearance_m, usual_contact)
    for box in [*boxes, *([] if workspace is None else _walls(workspace))]:
        low, high = np.array(box[:3]), np.array(box[3:])
        place = pin.SE3(np.eye(3), (low + high) / 2)
        solid = coal.Box(*np.abs(high - low))
        whole_box = pin.GeometryObject(f"box_{shapes.ngeoms}", 0, place, solid)
        number = shapes.addGeometryObject(whole_box)
        for a in range(count):
            if parents[a] > 0:
                shapes.addCollisionPair(pin.CollisionPair(a, number))
    return Geometry(model, model.createData(), shapes, _with_clearance(shapes, clearance_m))


def _with_clearance(shapes: Any, clearance_m: float) -> Any:
    found = shapes.createData()
    for request in found.collisionRequests:
        request.security_margin = clearance_m
    return found


def _without_usual_contact(
    model: Any, shapes: Any, postures: Array, clearance_m: float, share: float
) -> None:
    data, found = model.createData(), _with_clearance(shapes, clearance_m)
    touching = np.zeros(len(shapes.collisionPairs))
    for posture in postures:
        q = pin.integrate(model, pin.neutral(model), posture)
        pin.computeCollisions(model, data, shapes, found, q, False)
        touching += [result.isCollision() for result in found.collisionResults]
    usual = touching > share * len(postures)
    pairs = [(pair.first, pair.second) for pair in shapes.collisionPairs]
    for pair in (pair for pair, out in zip(pairs, usual, strict=True) if out):
        shapes.removeCollisionPair(pin.CollisionPair(*pair))


def _walls(workspace: Box) -> list[Box]:
    """Six boxes around a box."""
    low, high = np.sort(np.reshape(workspace, (2, 3)), axis=0)
    walls: list[Box] = []
    for axis in range(3):
        for ends in ((low - WALL_M, low), (high, high + WALL_M)):
            corners = np.array([low - WALL_M, high + WALL_M])
            corners[:, axis] = [end[axis] for end in ends]
            walls.append(corners.ravel().tolist())
    return walls
