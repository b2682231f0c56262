"""URDF to chain, nominal inertials and collision shapes, by Pinocchio.

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
from typing import Any, NamedTuple
from xml.etree import ElementTree

import coal
import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from seqid_cli.being_read import being_read
from seqid_cli.errors import ConfigError
from seqid_cli.robot.kinematics import tidy_axis, tidy_position, tidy_rotation
from seqid_cli.robot.types import Array, Chain, Robot
from seqid_cli.robot.urdf import UrdfText, read_urdf_text

WIDE = "1e9"  # a limit that no joint reaches


def chain_from_urdf(
    urdf: UrdfText,
    names: tuple[str, ...],
    source: Path,
    positions: Mapping[str, float] | None = None,
) -> tuple[Chain, Array | None]:
    """Build the chain of some joints, all other joints locked and merged.

    Parameters
    ----------
    names : tuple of str
        The joints, in chain order.
    source : Path
        The robot file that names them.
    positions : mapping of str to float, optional
        Where other joints are locked [rad, m]; at zero those that are not named.

    Returns
    -------
    Chain
        Quarter turns and zeros that the URDF rounds are exact (see `tidy_rotation`).
    ndarray, (n, 10), or None
        Nominal inertials in Pinocchio's order; None where the URDF has none.

    Raises
    ------
    ConfigError
        The URDF is inconsistent, or `names` is no serial chain in this order.
    """
    model = whole_model(urdf)
    posture = _locked_posture(model, positions or {})
    reduced = pin.buildReducedModel(model, _other_joints(model, names), posture)
    _check_chain(reduced, names, urdf, source)

    nominal = None
    if urdf.root.find("link/inertial") is not None:
        nominal = np.array(
            [inertia.toDynamicParameters() for inertia in reduced.inertias[1:]]
        )
    joints = [urdf.joints[name] for name in names]
    placements = reduced.jointPlacements[1:]
    chain = Chain(
        rotation=np.array([tidy_rotation(place.rotation) for place in placements]),
        position=np.array([tidy_position(place.translation) for place in placements]),
        axis=np.array([tidy_axis(np.array(joint.axis)) for joint in joints]),
        prismatic=np.array([joint.kind == "prismatic" for joint in joints]),
    )
    return chain, nominal


def _locked_posture(model: pin.Model, positions: Mapping[str, float]) -> Array:
    """Return the configuration with joints at positions [rad, m], others at zero."""
    # A continuous joint is (cos, sin) in the configuration, so its zero is not 0.0:
    # neutral knows.
    posture = pin.neutral(model)
    for name, position in positions.items():
        joint = model.joints[model.getJointId(name)]
        step = np.zeros(model.nv)
        step[joint.idx_v] = position
        posture = pin.integrate(model, posture, step)
    return np.asarray(posture)


def _other_joints(model: pin.Model, names: Sequence[str]) -> list[int]:
    """Return the numbers of the joints that are none of `names`; 0 is the universe."""
    return [k for k in range(1, model.njoints) if model.names[k] not in names]


def whole_model(urdf: UrdfText) -> pin.Model:
    """Read all links and joints of a URDF; raises ConfigError if it is inconsistent."""
    try:
        with being_read(urdf.path), _silenced():
            return pin.buildModelFromXML(readable(urdf))
    except (ValueError, RuntimeError) as problem:
        lines = str(problem).strip().splitlines()
        reason = lines[0] if lines else "no reason given"
        raise ConfigError(
            f"not a usable URDF: {reason}",
            where=str(urdf.path),
            hint="Check it with `check_urdf` (liburdfdom-tools).",
        ) from None


def readable(urdf: UrdfText) -> str:
    """Return a URDF's text as Pinocchio reads it.

    Joints that lack part of their <limit> get a wide one; links named like a joint are
    renamed.
    """
    root = copy.deepcopy(urdf.root)
    for joint in root.findall("joint"):
        if joint.get("type") not in ("revolute", "prismatic"):
            continue
        wide = {"effort": WIDE, "velocity": WIDE}
        limit = joint.find("limit")
        if limit is None:
            limit = ElementTree.SubElement(joint, "limit")
            wide |= {"lower": f"-{WIDE}", "upper": WIDE}
        limit.attrib.update({**wide, **limit.attrib})

    for path, key in (
        ("link", "name"),
        ("joint/parent", "link"),
        ("joint/child", "link"),
    ):
        for element in root.findall(path):
            if element.get(key) in urdf.joints:
                element.set(key, f"{element.get(key)}/link")
    return ElementTree.tostring(root, encoding="unicode")


@contextlib.contextmanager
def _silenced() -> Iterator[None]:
    """Drop what the library writes to the screen: names in it may steer a terminal."""
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
    """Raise ConfigError unless joint k of `names` is the child of joint k - 1."""
    children_of: dict[str, list[str]] = {}
    for k in range(1, model.njoints):
        parent = model.names[model.parents[k]]
        children_of.setdefault(parent, []).append(model.names[k])

    order: list[str] = []
    joint = str(model.names[0])
    while joint in children_of:
        children = children_of[joint]
        if len(children) > 1:
            branches = " and ".join(map(repr, children))
            raise ConfigError(
                f"joints {branches} are on different branches of {urdf.path.name}",
                where=str(source),
                hint="Name the joints of one serial chain only; the others are locked"
                " at zero.",
            )
        joint = children[0]
        order.append(joint)
    if tuple(order) != names:
        raise ConfigError(
            f"the [[joint]] tables are not in chain order: {', '.join(names)}",
            where=str(source),
            hint=f"The order in {urdf.path.name} is: {', '.join(order)}.",
        )


WALL_M = 20.0  # thickness of the walls around the workspace
# x, y, z of one corner, x, y, z of the other, in m in the base frame
Box = Sequence[float]


@dataclass(frozen=True)
class Geometry:
    """An arm's links and the boxes around it, ready to be checked."""

    model: Any  # pinocchio.Model
    data: Any  # pinocchio.Data
    shapes: Any  # pinocchio.GeometryModel, with the pairs to be checked
    shape_data: Any  # pinocchio.GeometryData, with the clearance

    def collides(self, q: Array) -> NDArray[np.bool_]:
        """Return which postures q (N, n) bring a pair nearer than the clearance."""
        neutral = pin.neutral(self.model)
        collisions = [
            pin.computeCollisions(
                self.model,
                self.data,
                self.shapes,
                self.shape_data,
                pin.integrate(self.model, neutral, posture),
                True,  # the first collision is enough
            )
            for posture in q
        ]
        return np.array(collisions, dtype=bool)


def geometry_of(
    robot: Robot,
    postures: Array,
    boxes: Sequence[Box] = (),
    workspace: Box | None = None,
    *,
    clearance_m: float = 0.02,
    usual_contact: float = 0.5,
) -> Geometry | None:
    """Read the collision geometry of a URDF.

    Parameters
    ----------
    postures : ndarray, (P, n)
        Drawn postures, by which links that always touch are found [rad, m].
    boxes : sequence of Box
        Where no link may be.
    workspace : Box, optional
        Out of which no link may reach.
    clearance_m : float
        How near counts as a collision [m].
    usual_contact : float
        Share of the postures in which links that touch are not checked against each
        other.

    Returns
    -------
    Geometry or None
        None without a URDF, without shapes, or where a mesh is not found.
    """
    if robot.urdf is None:
        return None
    arm = _arm_with_shapes(robot, robot.urdf)
    if arm is None:
        return None
    model, shapes = arm
    for shape in shapes.geometryObjects:
        if isinstance(shape.geometry, coal.BVHModelBase):
            shape.geometry.buildConvexHull(True, "Qt")
            shape.geometry = shape.geometry.convex

    # Links against each other, but for neighbours, which touch at their joint.
    n_shapes = shapes.ngeoms
    parents = [shape.parentJoint for shape in shapes.geometryObjects]
    for a in range(n_shapes):
        for b in range(a):
            if abs(parents[a] - parents[b]) > 1:
                shapes.addCollisionPair(pin.CollisionPair(b, a))
    _without_usual_contact(model, shapes, postures, clearance_m, usual_contact)

    # Moving links against the boxes; the base stands where it stands.
    walls = [] if workspace is None else _walls(workspace)
    for box in [*boxes, *walls]:
        number = _add_box(shapes, box)
        for a in range(n_shapes):
            if parents[a] > 0:
                shapes.addCollisionPair(pin.CollisionPair(a, number))
    shape_data = _with_clearance(shapes, clearance_m)
    return Geometry(model, model.createData(), shapes, shape_data)


def _arm_with_shapes(robot: Robot, path: Path) -> tuple[Any, Any] | None:
    """Return the model of a robot's joints and its shapes; None if it has no shapes."""
    urdf = read_urdf_text(path)
    xml = readable(urdf)
    model = whole_model(urdf)
    # Meshes lie beside the URDF, above it, or in packages.
    folders = [str(folder) for folder in path.resolve().parents]
    folders += os.environ.get("ROS_PACKAGE_PATH", "").split(os.pathsep)
    try:
        with being_read(path), _silenced(), warnings.catch_warnings():
            warnings.simplefilter("ignore")
            shapes = pin.buildGeomFromUrdfString(model, xml, pin.COLLISION, folders)
    except ValueError:
        return None
    if not shapes.ngeoms:
        return None
    others = _other_joints(model, robot.joint_names)
    reduced, reduced_shapes = pin.buildReducedModel(
        model, shapes, others, pin.neutral(model)
    )
    return reduced, reduced_shapes


def _add_box(shapes: Any, box: Box) -> int:
    """Add a box that stands in the base frame to shapes; returns its number."""
    corner = np.array(box[:3])
    opposite = np.array(box[3:])
    place = pin.SE3(np.eye(3), (corner + opposite) / 2)
    solid = coal.Box(*np.abs(opposite - corner))
    name = f"box_{shapes.ngeoms}"
    return int(shapes.addGeometryObject(pin.GeometryObject(name, 0, place, solid)))


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

    @classmethod
    def none(cls) -> "LinkPoints":
        """Return no points at all."""
        return cls(
            link=np.zeros(0, np.intp), position=np.zeros((0, 3)), radius=np.zeros(0)
        )


def shape_points(geometry: Geometry) -> LinkPoints:
    """Return balls whose convex hulls hold the collision shapes of an arm's links."""
    links = []
    positions = []
    radii = []
    for shape in geometry.shapes.geometryObjects:
        if shape.parentJoint == 0:  # the base, or a box around the arm
            continue
        balls = _balls_of(shape.geometry)
        place = shape.placement
        positions.append(balls.centers @ place.rotation.T + place.translation)
        links.append(np.full(len(balls.centers), shape.parentJoint - 1))
        radii.append(np.full(len(balls.centers), balls.radius))
    if not links:
        return LinkPoints.none()
    return LinkPoints(
        link=np.concatenate(links),
        position=np.concatenate(positions),
        radius=np.concatenate(radii),
    )


def frame_points(robot: Robot) -> LinkPoints:
    """Return the origins of all frames behind a joint: links, flange, tool.

    There are none without a URDF.
    """
    if robot.urdf is None:
        return LinkPoints.none()
    model = whole_model(read_urdf_text(robot.urdf))
    others = _other_joints(model, robot.joint_names)
    reduced = pin.buildReducedModel(model, others, pin.neutral(model))
    frames = [frame for frame in reduced.frames if frame.parentJoint > 0]
    origins = np.array([frame.placement.translation for frame in frames])
    return LinkPoints(
        link=np.array([frame.parentJoint - 1 for frame in frames], dtype=np.intp),
        position=origins.reshape(-1, 3),
        radius=np.zeros(len(frames)),
    )


class _Balls(NamedTuple):
    """Balls whose convex hull holds a shape, in its own frame."""

    centers: Array  # (K, 3) m
    radius: float = 0.0  # m


def _balls_of(shape: Any, *, sides: int = 16) -> _Balls:
    """Return balls about a shape; round ends of a cylinder have so many `sides`."""
    if isinstance(shape, coal.Sphere):
        return _Balls(np.zeros((1, 3)), float(shape.radius))
    if isinstance(shape, coal.Capsule):
        half = shape.halfLength
        ends = np.array([[0.0, 0.0, -half], [0.0, 0.0, half]])
        return _Balls(ends, float(shape.radius))
    if isinstance(shape, coal.Cylinder):
        # A polygon around the circle, not inside it.
        angle = 2.0 * np.pi * np.arange(sides) / sides
        outer = shape.radius / np.cos(np.pi / sides)
        ring = np.column_stack([outer * np.cos(angle), outer * np.sin(angle)])
        low = np.column_stack([ring, np.full(sides, -shape.halfLength)])
        high = np.column_stack([ring, np.full(sides, shape.halfLength)])
        return _Balls(np.vstack([low, high]))
    if isinstance(shape, coal.ConvexBase):
        points = np.array([shape.point(k) for k in range(shape.num_points)])
        return _Balls(points.reshape(-1, 3))

    # Any other shape by the corners of the box around it.
    shape.computeLocalAABB()
    low = np.ravel(shape.aabb_local.min_)
    high = np.ravel(shape.aabb_local.max_)
    ranges = zip(low, high, strict=True)
    return _Balls(np.array(np.meshgrid(*ranges)).reshape(3, -1).T)


def _with_clearance(shapes: Any, clearance_m: float) -> Any:
    """Return data for shapes in which nearer than the clearance is a collision."""
    data = shapes.createData()
    for request in data.collisionRequests:
        request.security_margin = clearance_m
    return data


def _without_usual_contact(
    model: Any, shapes: Any, postures: Array, clearance_m: float, share: float
) -> None:
    """Remove the pairs that touch in more than a share of the postures (P, n)."""
    data = model.createData()
    shape_data = _with_clearance(shapes, clearance_m)
    n_contacts = np.zeros(len(shapes.collisionPairs))
    for posture in postures:
        q = pin.integrate(model, pin.neutral(model), posture)
        pin.computeCollisions(model, data, shapes, shape_data, q, False)
        n_contacts += [result.isCollision() for result in shape_data.collisionResults]

    # Pairs are copied first: removing one moves the others.
    is_usual = n_contacts > share * len(postures)
    pairs = [(pair.first, pair.second) for pair in shapes.collisionPairs]
    for (first, second), is_removed in zip(pairs, is_usual, strict=True):
        if is_removed:
            shapes.removeCollisionPair(pin.CollisionPair(first, second))


def _walls(workspace: Box) -> list[Box]:
    """Return six boxes around a box."""
    low, high = np.sort(np.reshape(workspace, (2, 3)), axis=0)
    walls: list[Box] = []
    for axis in range(3):
        for below, above in ((low - WALL_M, low), (high, high + WALL_M)):
            corners = np.array([low - WALL_M, high + WALL_M])
            corners[0, axis] = below[axis]
            corners[1, axis] = above[axis]
            walls.append(corners.ravel().tolist())
    return walls
