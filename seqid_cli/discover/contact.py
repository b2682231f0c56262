"""Where the arm was pushed: a force on a link, and the point that it acts on.

A force F(t) at a point of link k turns the joints up to k,

    r_i(t) = -(z_i x (x(t) - p_i))' F(t),    F(t) = s(t) d,

r_i what is left of the torque of joint i, z_i its axis and p_i a point of it, x the
point on the link, all seen from the base; of a prismatic joint z_i' F. The direction d
of a push hardly changes; its size s is a broken line over time. Point and direction are
searched, for each of them s follows by least squares. Where the arm turns too little
under the push, every point on the force's line does as well: then there is none.

In shapes, M is the number of samples of a push, k the number of joints that feel it.
"""

from functools import partial
from typing import NamedTuple

import numpy as np

from seqid_cli.discover.investigate import Investigation
from seqid_cli.discover.survey.events import Interval
from seqid_cli.params.results.diagnosis import ContactPoint
from seqid_cli.robot.kinematics import forward
from seqid_cli.robot.types import Robot
from seqid_cli.typing import Array, Mask

KNOT_S = 0.5  # between knots of the force's size
MOST_KNOTS = 12
MOST_SAMPLES = 200  # of a push, that are fitted
STARTS = 6  # directions that a search begins with: both ways of each axis
DETERMINED_M = 0.1  # standard error of a coordinate, up to which a point is told
LINK_M = 1.0  # of the point from the link's frame, as it is likely beforehand
EXPLAINED = 0.8  # share of a push's square that the force must explain
LEAST_JOINTS = 2


class _Push(NamedTuple):
    """What a push does: samples of the joints up to the link that was pushed.

    `residual` (M, k) N m in units of each joint's noise, `counts` (M, k), `noise` (k,)
    N m; `turn` (M, 3, 3), `place` (M, 3) m of the link's frame, `axis` (M, k, 3) and
    `pivot` (M, k, 3) m of the joints, all seen from the base; `is_prismatic` (k,);
    `knots` (M, b) hat functions of the force's size.
    """

    residual: Array
    counts: Mask
    noise: Array
    turn: Array
    place: Array
    axis: Array
    pivot: Array
    is_prismatic: Mask
    knots: Array


def contact_point(
    investigation: Investigation, robot: Robot, event: Interval
) -> ContactPoint | None:
    """Return where a push acted, as far as its torques tell.

    Parameters
    ----------
    investigation : Investigation
        All that a diagnosis is made from.
    robot : Robot
        The arm.
    event : Interval
        The push.

    Returns
    -------
    ContactPoint or None
        None where the joints determine no coordinate of a point.
    """
    from scipy.optimize import least_squares

    if len(event.joints) < LEAST_JOINTS:
        return None
    push = _push_of(investigation, robot, event)
    total = float(np.sum(push.residual[push.counts] ** 2))
    if total <= 0.0:
        return None

    # Azimuth and elevation of the direction, then the point in the link's frame.
    best = None
    for number in range(STARTS):
        direction = np.zeros(3)
        direction[number // 2] = 1.0 - 2.0 * (number % 2)
        angles = [np.arctan2(direction[1], direction[0]), np.arcsin(direction[2])]
        start = np.array([*angles, 0.0, 0.0, 0.0])
        fit = least_squares(partial(_misfit, push), start, max_nfev=40)
        if best is None or fit.cost < best.cost:
            best = fit
    assert best is not None
    if 2.0 * best.cost > (1.0 - EXPLAINED) * total:
        return None

    n_free = max(push.residual.size - len(best.x) - push.knots.shape[1], 1)
    variance = max(2.0 * best.cost / n_free, 1.0)
    jacobian = np.asarray(best.jac, dtype=np.float64)
    covariance = variance * np.linalg.pinv(jacobian.T @ jacobian)
    std_error = np.sqrt(np.maximum(np.diag(covariance)[2:], 0.0))
    is_determined = std_error < DETERMINED_M
    if not is_determined.any():
        return None
    sizes, _ = _sizes(push, best.x)
    return ContactPoint(
        after_joint=robot.joint_names[event.joints[-1]],
        point=_told(best.x[2:], is_determined),
        std_error=_told(std_error, is_determined),
        force=float(np.max(np.abs(push.knots @ sizes))),
    )


def _told(values: Array, is_determined: Mask) -> list[float | None]:
    """Return numbers (3,), None where they are not determined."""
    return [
        float(value) if is_known else None
        for value, is_known in zip(values, is_determined, strict=True)
    ]


def _push_of(investigation: Investigation, robot: Robot, event: Interval) -> _Push:
    """Take the samples of a push."""
    scene = investigation.ground.stage.scenes[event.scene]
    link = event.joints[-1]
    joints = np.arange(link + 1)
    inside = np.flatnonzero(event.inside(scene))
    inside = inside[:: max(1, len(inside) // MOST_SAMPLES)]

    noise = np.maximum(investigation.model.noise.sigma[joints], 1e-12)
    left = investigation.model.left()[event.scene][inside][:, joints]
    counts = scene.slides[inside][:, joints]
    frames = forward(robot.chain, scene.motion.q[inside])

    t = scene.motion.t[inside] - scene.motion.t[0]
    n_knots = int(np.clip((event.end - event.start) / KNOT_S + 2, 2, MOST_KNOTS))
    at = np.linspace(event.start, event.end, n_knots)
    hats = np.stack([np.interp(t, at, unit) for unit in np.eye(n_knots)], axis=1)
    return _Push(
        residual=np.where(counts, left / noise, 0.0),
        counts=counts,
        noise=noise,
        turn=frames.R[:, link],
        place=frames.p[:, link],
        axis=frames.z[:, joints],
        pivot=frames.p[:, joints],
        is_prismatic=np.array([robot.joints[joint].prismatic for joint in joints]),
        knots=hats,
    )


def _sizes(push: _Push, x: Array) -> tuple[Array, Array]:
    """Return sizes of the force (b,) N at the knots, and what it leaves (M, k)."""
    azimuth, elevation = x[:2]
    way = np.array(
        [
            np.cos(azimuth) * np.cos(elevation),
            np.sin(azimuth) * np.cos(elevation),
            np.sin(elevation),
        ]
    )
    point = push.place + push.turn @ x[2:]
    arm = point[:, None, :] - push.pivot
    turning = np.where(push.is_prismatic[:, None], push.axis, np.cross(push.axis, arm))
    torque = np.where(push.counts, -(turning @ way) / push.noise, 0.0)
    columns = (torque[:, :, None] * push.knots[:, None, :]).reshape(
        -1, push.knots.shape[1]
    )
    y = push.residual.reshape(-1)
    sizes = np.linalg.lstsq(columns, y, rcond=1e-9)[0]
    return np.asarray(sizes, dtype=np.float64), y - columns @ sizes


def _misfit(push: _Push, x: Array) -> Array:
    """Return what the best force of a direction and point leaves, in noise.

    A point is likely to be on the link: that decides what no torque tells.
    """
    return np.concatenate([_sizes(push, x)[1], x[2:] / LINK_M])
