"""Motion of one or two moving joints from IMUs, as the paper writes it (Eq. 29-31, 39-42).

Frames: link m carries IMU a, link l > m IMU b; joints before m and between m and l are locked.
Vectors are in the frame that their name ends with. The general case, any joints and IMUs, is
`seqid_cli.motion.imu.link_acceleration`: these are what it is tested against.
"""

from __future__ import annotations

import numpy as np

from seqid_cli.typing import Array


def joint_acceleration(dw: Array, dw_reference: Array, reference: float) -> Array:
    """Eq. 30: joint acceleration (N,) rad/s^2 by comparison with a reference motion.

    The paper averages the ratios of the three components; here they are weighted by the square of
    the reference's component, since a component across the axis is noise over zero.

    Parameters
    ----------
    dw : (N, 3) array
        Angular acceleration of the IMU [rad/s^2].
    dw_reference : (3,) array
        The same while the joint accelerates with `reference` [rad/s^2].
    reference : float
        Joint acceleration of the reference motion [rad/s^2].
    """
    ratio: Array = dw @ dw_reference / (dw_reference @ dw_reference)
    return reference * ratio


def second_joint_velocity(R_lm: Array, w_m: Array, w_l: Array, axis: Array) -> Array:
    """Eq. 41: velocity (N,) rad/s of joint l.

    Parameters
    ----------
    R_lm : (N, 3, 3) array
        Rotates from link m's to link l's frame.
    w_m, w_l : (N, 3) arrays
        Angular velocity of link m in its frame and of link l in its own [rad/s].
    axis : (3,) array
        Axis of joint l in link l's frame.
    """
    velocity: Array = (w_l - np.einsum("nij,nj->ni", R_lm, w_m)) @ axis
    return velocity


def second_joint_acceleration(
    R_lm: Array, w_m: Array, dw_m: Array, dw_l: Array, velocity: Array, axis: Array
) -> Array:
    """Eq. 42: acceleration (N,) rad/s^2 of joint l, `velocity` (N,) being Eq. 41's result."""
    carried = np.einsum("nij,nj->ni", R_lm, dw_m)
    turning = np.cross(np.einsum("nij,nj->ni", R_lm, w_m), velocity[:, None] * axis)
    acceleration: Array = (dw_l - carried - turning) @ axis
    return acceleration
