"""The floor: the plane across gravity through the base frame's origin.

No point of the arm goes below it.

With u = -g / |g| the way up and x_i(q) the points of the links, each with a ball of
radius r_i around it, the arm keeps above its base plane where

    h(q) = min_i u' x_i(q) - r_i >= clearance.

Points are corners of the collision shapes where a URDF has them: a hull lies above a
plane where all its corners do. Without shapes they are the origins of the joints and of
the URDF's frames (a flange, a tool), and links count as the lines between them.

A point that no joint lifts, such as the first joint's origin, is no part of it. Nor is
a corner that no posture lifts far enough, as of the shape around a low shoulder; but a
link of which no corner can be above hangs below its base, and such an arm has no plan
with a floor.
"""

from dataclasses import dataclass
from typing import NoReturn

import numpy as np

from seqid_cli.errors import ConfigError
from seqid_cli.plan.limits import Limits
from seqid_cli.plan.settings import MarginSettings
from seqid_cli.robot.kinematics import forward
from seqid_cli.robot.types import Robot
from seqid_cli.robot.urdf_model import Geometry, LinkPoints, frame_points, shape_points
from seqid_cli.tiles import tiles
from seqid_cli.typing import Array, Index, Mask

NO_FLOOR = "--no-floor plans without it"


@dataclass(frozen=True, kw_only=True)
class Floor:
    """The plane that no point of an arm goes below.

    Parameters
    ----------
    robot : Robot
    up : (3,) float
        The way up in the base frame.
    points : LinkPoints
        What is looked at.
    clearance_m : float
        Height that is kept above the plane [m].
    shapes : bool
        Whether the points are those of collision shapes.
    ignored : int
        How many corners no posture lifts above the plane; they are not looked at.
    """

    robot: Robot
    up: Array
    points: LinkPoints
    clearance_m: float
    shapes: bool
    ignored: int

    def height(self, q: Array) -> Array:
        """Return how far the lowest point lies above the clearance.

        Parameters
        ----------
        q : (N, n) float
            Postures [rad; m where prismatic].

        Returns
        -------
        (N,) array
            Height [m], negative where a point is too low.
        """
        lowest = np.empty(len(q))
        # Heights of all points at all postures at once would take much memory.
        for part in tiles(len(q), size=1024):
            heights = _heights(self.robot, self.up, self.points, q[part])
            lowest[part] = heights.min(axis=1, initial=np.inf)
        return np.asarray(lowest - self.clearance_m)

    def below(self, q: Array) -> Mask:
        """Return which of the postures q (N, n) have a point too low."""
        return np.asarray(self.height(q) < 0.0)

    def height_along(self, joint: Index, postures: Array, places: Array) -> Array:
        """Return heights of the lowest points while one joint of each posture moves.

        A point's height is a cos q + b sin q + c in the angle of a joint, linear in a
        slide. So three places of each posture determine it at all others, which is much
        cheaper than the kinematics of all places.

        Parameters
        ----------
        joint : (M,) int
            The joint that moves.
        postures : (M, n) float
            Where all joints stand [rad; m where prismatic].
        places : (M, P) float
            Positions of the joint that moves.

        Returns
        -------
        (M, P) array
            Height above the clearance [m], negative where a point is too low.
        """
        count, n = postures.shape
        is_slide = self.robot.chain.prismatic[joint]
        angles = 2.0 * np.pi * np.arange(3) / 3.0
        nodes = np.where(is_slide[:, None], np.arange(3.0), angles)

        q = np.repeat(postures[:, None], 3, axis=1)
        q[np.arange(count), :, joint] = nodes
        at_nodes = _heights(self.robot, self.up, self.points, q.reshape(-1, n))
        coefficients = np.linalg.solve(
            _shapes_of(nodes, is_slide), at_nodes.reshape(count, 3, -1)
        )

        lowest = np.empty(places.shape)
        for part in tiles(count, size=64):
            heights = _shapes_of(places[part], is_slide[part]) @ coefficients[part]
            lowest[part] = heights.min(axis=2)
        return lowest - self.clearance_m

    @property
    def note(self) -> str:
        """Note of the plan on what was assumed of the floor."""
        kind = "collision shapes" if self.shapes else "origins of joints and frames"
        text = (
            f"floor: every point of the arm ({kind}) stays {100 * self.clearance_m:g}"
            " cm above the base plane, the plane across gravity through the base"
            f" frame's origin; {NO_FLOOR}"
        )
        if self.ignored:
            text += (
                f" ({self.ignored} corners that no posture lifts above it are left out)"
            )
        return text


def floor_of(
    robot: Robot,
    limits: Limits,
    postures: Array,
    geometry: Geometry | None = None,
    *,
    margins: MarginSettings = MarginSettings(),
    still_m: float = 1e-3,
) -> Floor | None:
    """Build the floor of an arm; None where gravity has no direction or lifts nothing.

    Parameters
    ----------
    robot : Robot
    limits : Limits
        Joints that are kept still stay in the middle of their ranges.
    postures : (P, n) float
        Drawn within the limits [rad; m where prismatic]: what they lift counts.
    geometry : Geometry, optional
        Collision shapes, where the URDF has them.
    margins : MarginSettings
        They say how high above the plane the arm keeps: between the samples that are
        checked a point may be lower by a millimetre or two, and a controller
        overshoots.
    still_m : float
        Points whose height changes by less are lifted by no joint [m].

    Returns
    -------
    Floor or None

    Raises
    ------
    ConfigError
        The arm, or one of its links, hangs below the base plane whatever its joints do.
    """
    gravity = float(np.linalg.norm(robot.gravity))
    if gravity == 0.0:
        return None
    up = -robot.gravity / gravity
    clearance_m = margins.floor_clearance
    points, with_shapes = _points_of(robot, geometry)
    heights = _heights(robot, up, points, postures)
    is_lifted = np.ptp(heights, axis=0) > still_m
    is_reachable = heights.max(axis=0) >= clearance_m

    # A link none of whose points can be above: the arm is not made to stand on this
    # plane.
    for j in np.unique(points.link[is_lifted]):
        of_link = is_lifted & (points.link == j)
        if not is_reachable[of_link].any():
            _refuse(robot, f"the link behind joint {robot.joint_names[int(j)]!r}")
    is_checked = is_lifted & is_reachable
    if not is_checked.any():
        return None

    floor = Floor(
        robot=robot,
        up=up,
        points=LinkPoints(
            link=points.link[is_checked],
            position=points.position[is_checked],
            radius=points.radius[is_checked],
        ),
        clearance_m=clearance_m,
        shapes=with_shapes,
        ignored=int(np.sum(is_lifted & ~is_reachable)),
    )
    if floor.below(postures).all():
        _refuse(robot, "the arm")
    return floor


def _shapes_of(q: Array, is_slide: Mask) -> Array:
    """Return what a height is made of, at positions q (M, P) of one joint each.

    The columns (M, P, 3) are 1, cos q, sin q of joints that turn and 1, q, q^2 of those
    that slide; the last has no share there.
    """
    turning = np.stack([np.ones_like(q), np.cos(q), np.sin(q)], axis=-1)
    sliding = np.stack([np.ones_like(q), q, q**2], axis=-1)
    return np.where(is_slide[:, None, None], sliding, turning)


def _refuse(robot: Robot, subject: str) -> NoReturn:
    """Raise that the arm, or a link of it, cannot stay above the base plane."""
    message = (
        f"{subject} is below the base plane (across gravity) in all postures that were"
        " drawn"
    )
    hint = (
        "If the arm hangs on a wall or a ceiling, plan with --no-floor; else correct"
        " gravity or position_limits in the robot file."
    )
    raise ConfigError(message, where=str(robot.source), hint=hint)


def _points_of(robot: Robot, geometry: Geometry | None) -> tuple[LinkPoints, bool]:
    """Return all points that are looked at, and whether they are of shapes.

    They are the corners of all shapes, and the origins of joints and frames.
    """
    joint_origins = LinkPoints(
        link=np.arange(robot.n),
        position=np.zeros((robot.n, 3)),
        radius=np.zeros(robot.n),
    )
    parts = [joint_origins, frame_points(robot)]
    with_shapes = False
    if geometry is not None:
        corners = shape_points(geometry)
        with_shapes = len(corners.link) > 0
        parts.append(corners)

    points = LinkPoints(
        link=np.concatenate([part.link for part in parts]),
        position=np.concatenate([part.position for part in parts]),
        radius=np.concatenate([part.radius for part in parts]),
    )
    return points, with_shapes


def _heights(robot: Robot, up: Array, points: LinkPoints, q: Array) -> Array:
    """Return heights (N, K) [m] of the balls' lowest points above the base plane."""
    frames = forward(robot.chain, q)
    origin_height = frames.p @ up
    up_in_link = np.einsum("niab,a->nib", frames.R, up)

    heights = np.empty((len(q), len(points.link)))
    for j in np.unique(points.link):
        of_link = points.link == j
        above_origin = up_in_link[:, j] @ points.position[of_link].T
        height = origin_height[:, j, None] + above_origin
        heights[:, of_link] = height - points.radius[of_link]
    return heights
