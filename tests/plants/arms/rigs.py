"""The simulated robots: the paper's one- and two-joint rigs and an arm of a UR5e's
size.
"""

from dataclasses import replace
from typing import Any

import numpy as np

from tests import Array
from tests.plants.controller import gains_for
from tests.plants.friction.surface import SurfaceFriction
from tests.plants.mechanics.rigid import Arm, rot_x, rot_z
from tests.plants.sensors import AccelerometerArray, tetrahedral_array
from tests.plants.simulate import Plant

GRAVITY = 9.81
DOWN = np.array([0.0, 0.0, -GRAVITY])
TILT = np.deg2rad(30.0)  # between the one-joint rig's axis and gravity
NAMES = ("joint_1", "joint_2")
GEAR = 6.0
COUNTS = 100  # encoder counts per motor turn
ROTOR = 2.5e-6  # kg m^2, Maxon 2140 class
TORQUE_CONSTANT = 0.0232  # N m/A
LINK_INERTIA = 0.0019  # kg m^2
MOMENT = 0.0087  # kg m
LINK_MASS = 0.12  # kg
UPPER_LENGTH = 0.3  # m, l_1 of Eq. 43
PI_1 = 0.0388  # kg m^2, I_1zz + N_1^2 I_m1 + m_2 l_1^2
Three = tuple[float, float, float]


def mounting(x: float, z: float, x2: float) -> Array:
    """Rotate a link's frame by angles in rad about x, z and x again: R_link_from_imu
    (3, 3).
    """
    return np.asarray(rot_x(x) @ rot_z(np.array(z)) @ rot_x(x2))


def array_on(
    name: str,
    after: int,
    turn: Three,
    lever: Three,
    *,
    size: float = 0.05,
    bias: float = 0.0,
) -> AccelerometerArray:
    """Twelve accelerometers over `size` m on the link after a joint, mounted as
    `mounting` says.
    """
    place = mounting(*turn), np.array(lever)
    return AccelerometerArray(name, after, *tetrahedral_array(size), *place, bias=bias)


def _light_link(izz: float, mx: float, mass: float) -> Array:
    """Standard parameters (10,) of a flat bar along x with `izz` about the joint's
    axis.
    """
    return np.array([mass, mx, 0.0, 0.0, 0.02 * izz, 0.0, izz, 0.0, 0.0, izz])


def off_nominal(arm: Arm, share: float) -> Arm:
    """What a controller or a CAD file believes: bodies off by up to `share`."""
    wave = 1.0 + share * np.sin(1.7 * np.arange(arm.n) + 0.6)
    return replace(arm, phi=arm.phi * wave[:, None])


def _paper_rig(
    dh: Array,
    phi: Array,
    friction: SurfaceFriction,
    inertia: Array,
    counts: int,
    **own: Any,
) -> Plant:
    n = len(dh)
    arm = Arm(NAMES[:n], dh, phi, DOWN, np.full(n, GEAR), np.full(n, ROTOR))
    return Plant(
        arm=arm,
        nominal=off_nominal(arm, 0.15),
        friction=friction,
        gains=gains_for(inertia, bandwidth=10.0, observer=50.0),
        torque_constant=np.full(n, TORQUE_CONSTANT),
        encoder_step=np.full(n, 2 * np.pi / (counts * GEAR)),
        position_limits=np.tile([-2.6, 2.6], (n, 1)),
        current_step=2.0**-8,
        coloured=0.1,
        **own,
    )


def one_joint(*, quadrature_factor: int = 1) -> Plant:
    """Sec. 4.1: one link on an axis 30 degrees off gravity, 600 encoder counts per
    joint turn.
    """
    friction = SurfaceFriction(
        coulomb=np.array([0.027]),
        viscous=np.array([6e-4]),
        stribeck=np.array([0.004]),
        stribeck_speed=np.array([0.6]),
        amplitude=np.array([[0.10, 0.06, 0.03]]),
        phase=np.array([[0.3, 1.9, -0.8]]),
    )
    return _paper_rig(
        np.array([[TILT, 0.0, 0.0, 0.0]]),
        _light_link(LINK_INERTIA, MOMENT, LINK_MASS)[None],
        friction,
        np.array([LINK_INERTIA + GEAR**2 * ROTOR]),
        COUNTS * quadrature_factor,
        current_noise=np.array([0.036]),
        coulomb_guess=np.array([0.025]),
        velocity_limits=np.array([8.0]),
        acceleration_limits=np.array([60.0]),
        imus=(array_on("imu_a", 0, (0.4, -0.9, 0.3), (0.06, 0.012, 0.008), bias=0.02),),
    )


def two_joint() -> Plant:
    """Sec. 4.2: planar, axes along gravity, base parameters of Eq. 44 as in Table IV
    (CAD).
    """
    inner = PI_1 - GEAR**2 * ROTOR - LINK_MASS * UPPER_LENGTH**2
    links = _light_link(inner, 0.12, 0.62), _light_link(LINK_INERTIA, MOMENT, LINK_MASS)
    friction = SurfaceFriction(
        coulomb=np.array([0.040, 0.027]),
        viscous=np.array([2.0e-3, 6e-4]),
        stribeck=np.array([0.006, 0.004]),
        stribeck_speed=np.array([0.5, 0.6]),
        amplitude=np.array([[0.09, 0.06, 0.03], [0.10, 0.05, 0.04]]),
        phase=np.array([[1.1, -0.4, 0.7], [0.3, 1.9, -0.8]]),
    )
    imus = (
        array_on("imu_a", 0, (0.2, 0.7, -0.5), (0.25, 0.01, 0.02), bias=0.02),
        array_on("imu_b", 1, (-0.6, 0.4, 1.0), (0.08, -0.01, 0.01), bias=0.02),
    )
    return _paper_rig(
        np.array([[0.0, 0.0, 0.0, 0.0], [0.0, UPPER_LENGTH, 0.0, 0.0]]),
        np.vstack(links),
        friction,
        np.array([0.042, 0.0020]),
        COUNTS,
        current_noise=np.array([0.045, 0.036]),
        coulomb_guess=np.array([0.037, 0.025]),
        velocity_limits=np.array([6.0, 8.0]),
        acceleration_limits=np.array([30.0, 60.0]),
        imus=imus,
    )


UR5E_NAMES = ("shoulder_pan", "shoulder_lift", "elbow", "wrist_1", "wrist_2", "wrist_3")
UR5E_DH = np.array(
    [
        [0.0, 0.0, 0.1625, 0.0],
        [np.pi / 2, 0.0, 0.0, 0.0],
        [0.0, -0.425, 0.0, 0.0],
        [0.0, -0.3922, 0.1333, 0.0],
        [np.pi / 2, 0.0, 0.0997, 0.0],
        [-np.pi / 2, 0.0, 0.0996, 0.0],
    ]
)
# Mass kg, centre m, radii of gyration m about the centre along turned axes.
UR5E_BODIES = (
    (3.76, (0.004, 0.021, -0.027), (0.068, 0.064, 0.055)),
    (8.06, (-0.213, 0.006, 0.121), (0.045, 0.152, 0.150)),
    (2.85, (-0.187, -0.005, 0.024), (0.038, 0.131, 0.129)),
    (1.37, (0.003, 0.014, 0.022), (0.041, 0.038, 0.036)),
    (1.30, (-0.002, -0.012, 0.019), (0.040, 0.037, 0.035)),
    (0.365, (0.011, 0.007, -0.024), (0.030, 0.029, 0.034)),
)
UR5E_ROTORS = np.array([1.0e-4, 1.0e-4, 8.0e-5, 2.4e-5, 2.4e-5, 2.2e-5])
UR5E_COULOMB = np.array([8.2, 9.4, 6.6, 1.9, 1.7, 1.4])


def standard_parameters(
    mass: float, centre: tuple[float, ...], gyration: tuple[float, ...], turn: Array
) -> Array:
    """Standard parameters (10,) of a body with principal axes `turn` (3, 3)."""
    c = np.array(centre)
    central = mass * turn @ np.diag(np.array(gyration) ** 2) @ turn.T
    about = central + mass * (c @ c * np.eye(3) - np.outer(c, c))
    return np.array([mass, *(mass * c), *about[[0, 0, 1, 0, 1, 2], [0, 1, 1, 2, 2, 2]]])


def plain(friction: SurfaceFriction) -> SurfaceFriction:
    """Coulomb and viscous friction alone."""
    return replace(
        friction, stribeck=0 * friction.stribeck, amplitude=0 * friction.amplitude
    )


def geared(arm: Arm, friction: SurfaceFriction, inertia: Array, **own: Any) -> Plant:
    """An industrial arm: stiff controller for links of `inertia` (n,), 1/f in a tenth
    of noise.
    """
    return Plant(
        arm=arm,
        nominal=off_nominal(arm, 0.12),
        friction=friction,
        gains=gains_for(arm.reflected + inertia, bandwidth=20.0, observer=150.0),
        coulomb_guess=0.9 * friction.coulomb,
        coloured=0.1,
        **own,
    )


def six_joint(*, simple_friction: bool = False) -> Plant:
    """An arm with a UR5e's geometry and masses, strain-wave-like drives, two arrays."""
    k = np.arange(6)
    bodies = [
        standard_parameters(*body, mounting(0.05 * (i + 1), 0.06 - 0.02 * i, 0.04))
        for i, body in enumerate(UR5E_BODIES)
    ]
    arm = Arm(
        UR5E_NAMES, UR5E_DH, np.array(bodies), DOWN, np.full(6, 101.0), UR5E_ROTORS
    )
    waves = (0.08 + 0.015 * np.sin(k), 0.05 + 0.01 * np.cos(k), np.full(6, 0.02))
    friction = SurfaceFriction(
        coulomb=UR5E_COULOMB,
        viscous=np.array([7.4, 8.3, 5.8, 1.7, 1.5, 1.3]),
        stribeck=np.array([1.1, 1.3, 0.9, 0.3, 0.3, 0.25]),
        stribeck_speed=np.array([0.15, 0.15, 0.18, 0.25, 0.25, 0.25]),
        amplitude=np.column_stack(waves),
        phase=np.column_stack([0.4 + 1.1 * k, 2.0 - 0.7 * k, 0.5 * k]),
    )
    imus = (
        array_on("imu_a", 2, (0.5, -0.4, 0.9), (-0.30, 0.03, 0.06), size=0.06),
        array_on("imu_b", 5, (-0.3, 1.1, 0.2), (0.02, 0.01, 0.04), size=0.06),
    )
    return geared(
        arm,
        plain(friction) if simple_friction else friction,
        np.array([2.0, 2.4, 0.6, 0.03, 0.02, 0.005]),
        torque_constant=np.array([0.122, 0.120, 0.118, 0.104, 0.101, 0.103]),
        encoder_step=np.full(6, 2.0**-15),
        current_noise=np.array([0.075, 0.075, 0.06, 0.022, 0.022, 0.022]),
        position_limits=np.array(
            [
                [-2.8, 2.8],
                [-2.7, 0.3],
                [-2.4, 2.4],
                [-2.9, 2.9],
                [-2.8, 2.8],
                [-2.8, 2.8],
            ]
        ),
        velocity_limits=np.array([2.2, 2.2, 2.6, 3.1, 3.1, 3.1]),
        acceleration_limits=np.array([9.0, 9.0, 12.0, 22.0, 22.0, 25.0]),
        current_step=np.array([2.0**-5] * 3 + [2.0**-6] * 3),
        imus=imus,
    )
