"""URDF to chain, nominal inertials and collision shapes. Arms as Pinocchio has them.

Pinocchio refuses revolute and prismatic joints without a complete <limit>, which plays
no part in the dynamics and which hand-made files lack, and links with the name of a
joint, which URDF allows; both are repaired before it reads.

Collisions are those of an arm with itself and with boxes around it, by coal. Meshes
count by their convex hulls. Neighbouring links are not checked against each other, nor
are links that overlap in most postures: their hulls touch at the joint between them.
"""

import contextlib
import copy
import os
import warnings
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import coal
import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from seqid_cli.errors import ConfigError
from seqid_cli.robot.kinematics import tidy_axis, tidy_position, tidy_rotation
from seqid_cli.robot.types import Array, Chain, Robot
from seqid_cli.robot.urdf import UrdfText, read_urdf_text

WIDE = "1e9"


def chain_from_urdf(
    urdf: UrdfText,
    names: tuple[str, ...],
    source: Path,
    positions: Mapping[str, float] | None = None,
) -> tuple[Chain, Array | None]:
    """Build the chain of the joints `names`, all other joints locked and merged.

    They are locked at zero, or at `positions` [rad, m] by their names. Quarter turns
    and zeros that it rounds are exact (see `tidy_rotation`). Raises ConfigError: the
    URDF is inconsistent, or in the robot file `source` `names` is no serial chain in
    this order.
    """
    whole = whole_model(urdf)
    others = [k for k in range(1, whole.njoints) if whole.names[k] not in names]
    # A continuous joint is (cos, sin) in the configuration, so its zero is not 0.0:
    # neutral knows.
    posture = pin.neutral(whole)
    for name, position in (positions or {}).items():
        k = whole.getJointId(name)
        step = np.zeros(whole.nv)
        step[whole.joints[k].idx_v] = position
        posture = pin.integrate(whole, posture, step)
    model = pin.buildReducedModel(whole, others, posture)
    _check_chain(model, names, urdf, source)
    nominal = np.array(
        [inertia.toDynamicParameters() for inertia in model.inertias[1:]]
    )
    joints = [urdf.joints[name] for name in names]
    chain = Chain(
        rotation=np.array(
            [tidy_rotation(M.rotation) for M in model.jointPlacements[1:]]
        ),
        position=np.array(
            [tidy_position(M.translation) for M in model.jointPlacements[1:]]
        ),
        axis=np.array([tidy_axis(np.array(joint.axis)) for joint in joints]),
        prismatic=np.array([joint.kind == "prismatic" for joint in joints]),
    )
    return chain, nominal if urdf.root.find("link/inertial") is not None else None


def whole_model(urdf: UrdfText) -> pin.Model:
    """Read all links and joints of a URDF; raises ConfigError where it is inconsistent."""
    try:
        with _unheard():
            return pin.buildModelFromXML(readable(urdf))
    except (ValueError, RuntimeError) as problem:
        reason = (
            str(problem).strip().splitlines()[0]
            if str(problem).strip()
            else "no reason given"
        )
        hint = "Check it with `check_urdf` (liburdfdom-tools)."
        message = f"not a usable URDF: {reason}"
        raise ConfigError(message, where=str(urdf.path), hint=hint) from None


def readable(urdf: UrdfText) -> str:
    """Give joints that lack part of their <limit> a wide one; rename links named like a joint."""
    root = copy.deepcopy(urdf.root)
    for joint in root.findall("joint"):
        if joint.get("type") in ("revolute", "prismatic"):
            limit, wide = joint.find("limit"), {"effort": WIDE, "velocity": WIDE}
            if limit is None:
                limit = ElementTree.SubElement(joint, "limit")
                wide |= {"lower": f"-{WIDE}", "upper": WIDE}
            limit.attrib.update({**wide, **limit.attrib})
    for tag, key in (
        ("link", "name"),
        ("joint/parent", "link"),
        ("joint/child", "link"),
    ):
        for element in root.findall(tag):
            if element.get(key) in urdf.joints:
                element.set(key, f"{element.get(key)}/link")
    return ElementTree.tostring(root, encoding="unicode")


@contextlib.contextmanager
def _unheard() -> Iterator[None]:
    """Drop what the library itself writes to the screen: names in it may steer a terminal."""
    try:
        screen = os.dup(2)
    except OSError:  # it is closed
        yield
        return
    with Path(os.devnull).open("w") as nowhere:
        os.dup2(nowhere.fileno(), 2)
    try:
        yield
    finally:
        os.dup2(screen, 2)
        os.close(screen)


def _check_chain(
    model: pin.Model, names: tuple[str, ...], urdf: UrdfText, source: Path
) -> None:
    """Raise unless joint k of `names` is the child of joint k - 1."""
    parent = {
        model.names[k]: model.names[model.parents[k]] for k in range(1, model.njoints)
    }
    order: list[str] = []
    before = str(model.names[0])
    while children := [name for name, of in parent.items() if of == before]:
        if len(children) > 1:
            apart = " and ".join(map(repr, children))
            message = f"joints {apart} are on different branches of {urdf.path.name}"
            hint = (
                "Name the joints of one serial chain only; the others are locked at"
                " zero."
            )
            raise ConfigError(message, where=str(source), hint=hint)
        before = children[0]
        order.append(before)
    if tuple(order) != names:
        message = f"the [[joint]] tables are not in chain order: {', '.join(names)}"
        hint = f"The order in {urdf.path.name} is: {', '.join(order)}."
        raise ConfigError(message, where=str(source), hint=hint)


WALL_M = 20.0  # thickness of the walls around the workspace
# x, y, z of one corner, x, y, z of the other, in m in the base frame
Box = Sequence[float]


@dataclass(frozen=True)
class Geometry:
    """An arm's links and the boxes around it, ready to be checked."""

    model: Any
    data: Any
    shapes: Any
    found: Any

    def collides(self, q: Array) -> NDArray[np.bool_]:
        """Return which of the postures q (N, n) let a pair come nearer than the clearance."""
        places = [
            pin.integrate(self.model, pin.neutral(self.model), posture) for posture in q
        ]
        arm = self.model, self.data, self.shapes, self.found
        return np.array(
            [pin.computeCollisions(*arm, place, True) for place in places], dtype=bool
        )


def geometry_of(
    robot: Robot, postures: Array, boxes: Sequence[Box] = (), workspace: Box | None = None,
    *, clearance_m: float = 0.02, usual_contact: float = 0.5,
) -> Geometry | None:  # fmt: skip
    """Read the collision geometry of a URDF.

    `postures` (P, n): drawn ones, by which links that always touch are found. `boxes`:
    where no link may be. `workspace`: out of which no link may reach. `clearance_m`:
    how near counts as a collision, m. `usual_contact`: share of the postures in which
    links that touch are not checked against each other. Returns None without a URDF,
    without shapes, or where a mesh is not found.
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
    others = [
        k for k in range(1, whole.njoints) if whole.names[k] not in robot.joint_names
    ]
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
    return Geometry(
        model, model.createData(), shapes, _with_clearance(shapes, clearance_m)
    )


@dataclass(frozen=True, kw_only=True)
class LinkPoints:
    """Points that move with the links of an arm, each with a ball around it.

    Parameters
    ----------
    link : (K,) int
        The link of each point, by the number of the joint that moves it, from 0.
    position : (K, 3) float
        Where it sits in the link's own frame [m].
    radius : (K,) float
        Radius of the ball [m]; 0 for a mere point.
    """

    link: NDArray[np.intp]
    position: Array
    radius: Array


def shape_points(geometry: Geometry) -> LinkPoints:
    """Return balls whose convex hulls hold the collision shapes of an arm's links."""
    links, positions, radii = [], [], []
    for shape in geometry.shapes.geometryObjects:
        if shape.parentJoint == 0:  # the base, or a box around the arm
            continue
        corners, radius = _corners_of(shape.geometry)
        place = shape.placement
        positions.append(corners @ place.rotation.T + place.translation)
        links.append(np.full(len(corners), shape.parentJoint - 1))
        radii.append(np.full(len(corners), radius))
    if not links:
        return LinkPoints(
            link=np.zeros(0, np.intp), position=np.zeros((0, 3)), radius=np.zeros(0)
        )
    return LinkPoints(
        link=np.concatenate(links),
        position=np.concatenate(positions),
        radius=np.concatenate(radii),
    )


def frame_points(robot: Robot) -> LinkPoints:
    """Return the origins of all frames behind a joint: links, flange, tool.

    None without a URDF.
    """
    if robot.urdf is None:
        return LinkPoints(
            link=np.zeros(0, np.intp), position=np.zeros((0, 3)), radius=np.zeros(0)
        )
    whole = pin.buildModelFromXML(readable(read_urdf_text(robot.urdf)))
    others = [
        k for k in range(1, whole.njoints) if whole.names[k] not in robot.joint_names
    ]
    model = pin.buildReducedModel(whole, others, pin.neutral(whole))
    frames = [frame for frame in model.frames if frame.parentJoint > 0]
    return LinkPoints(
        link=np.array([frame.parentJoint - 1 for frame in frames], dtype=np.intp),
        position=np.array([frame.placement.translation for frame in frames]).reshape(
            -1, 3
        ),
        radius=np.zeros(len(frames)),
    )


def _corners_of(shape: Any, *, sides: int = 16) -> tuple[Array, float]:
    """Return corners (K, 3) and a radius: balls about them have a hull that holds the shape."""
    if isinstance(shape, coal.Sphere):
        return np.zeros((1, 3)), float(shape.radius)
    if isinstance(shape, coal.Capsule):
        return np.array(
            [[0.0, 0.0, z] for z in (-shape.halfLength, shape.halfLength)]
        ), float(shape.radius)
    if isinstance(shape, coal.Cylinder):
        # A polygon around the circle, not inside it.
        angle = 2.0 * np.pi * np.arange(sides) / sides
        outer = shape.radius / np.cos(np.pi / sides)
        ring = np.column_stack([outer * np.cos(angle), outer * np.sin(angle)])
        ends = (-shape.halfLength, shape.halfLength)
        return (
            np.vstack([np.column_stack([ring, np.full(sides, z)]) for z in ends]),
            0.0,
        )
    if isinstance(shape, coal.ConvexBase):
        return (
            np.array([shape.point(k) for k in range(shape.num_points)]).reshape(-1, 3),
            0.0,
        )
    shape.computeLocalAABB()
    low, high = np.ravel(shape.aabb_local.min_), np.ravel(shape.aabb_local.max_)
    corners = np.array(np.meshgrid(*zip(low, high, strict=True))).reshape(3, -1).T
    return corners, 0.0


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
