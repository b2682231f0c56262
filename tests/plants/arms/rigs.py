"""The simulated robots: the paper's one- and two-joint rigs and an arm of a UR5e's size."""

from dataclasses import replace

import numpy as np

from tests import Array
from tests.plants.controller import gains_for
from tests.plants.friction.surface import SurfaceFriction
from tests.plants.mechanics.rigid import Arm, rot_x, rot_z
from tests.plants.sensors import AccelerometerArray, tetrahedral_array
from tests.plants.simulate import Plant

GRAVITY = 9.81
TILT = np.deg2rad(30.0)  # between the one-joint rig's axis and gravity
GEAR = 6.0
COUNTS = 100  # encoder counts per motor turn
ROTOR = 2.5e-6  # kg m^2, Maxon 2140 class
TORQUE_CONSTANT = 0.0232  # N m/A
LINK_INERTIA = 0.0019  # kg m^2
MOMENT = 0.0087  # kg m
LINK_MASS = 0.12  # kg
UPPER_LENGTH = 0.3  # m, l_1 of Eq. 43
PI_1 = 0.0388  # kg m^2, I_1zz + N_1^2 I_m1 + m_2 l_1^2


def mounting(x: float, z: float, x2: float) -> Array:
    """Build a rotation R_link_from_imu (3, 3), by angles in rad about x, z and x again."""
    return np.asarray(rot_x(x) @ rot_z(np.array(z)) @ rot_x(x2))


def array_on(
    name: str,
    after: int,
    turn: tuple[float, float, float],
    lever: tuple[float, float, float],
    *,
    size: float = 0.05,
    bias: float = 0.0,
) -> AccelerometerArray:
    """Twelve accelerometers over `size` m on the link after a joint, mounted as `mounting` says."""
    positions, axes = tetrahedral_array(size)
    place = mounting(*turn), np.array(lever)
    return AccelerometerArray(name, after, positions, axes, *place, bias=bias)


def _light_link(izz: float, mx: float, mass: float) -> Array:
    """Return standard parameters (10,) of a flat bar along x with `izz` about the joint's axis."""
    thin = 0.02 * izz
    return np.array([mass, mx, 0.0, 0.0, thin, 0.0, izz, 0.0, 0.0, izz])


def off_nominal(arm: Arm, share: float) -> Arm:
    """Return what a controller or a CAD file believes: bodies off by up to `share`."""
    wave = 1.0 + share * np.sin(1.7 * np.arange(arm.n) + 0.6)
    return replace(arm, phi=arm.phi * wave[:, None])


def one_joint(*, quadrature_factor: int = 1) -> Plant:
    """Sec. 4.1: one link on an axis 30 degrees off gravity, 600 encoder counts per joint turn."""
    arm = Arm(
        names=("joint_1",),
        dh=np.array([[TILT, 0.0, 0.0, 0.0]]),
        phi=_light_link(LINK_INERTIA, MOMENT, LINK_MASS)[None],
        gravity=np.array([0.0, 0.0, -GRAVITY]),
        gear=np.array([GEAR]),
        rotor_inertia=np.array([ROTOR]),
    )
    imu = array_on("imu_a", 0, (0.4, -0.9, 0.3), (0.06, 0.012, 0.008), bias=0.02)
    friction = SurfaceFriction(
        coulomb=np.array([0.027]),
        viscous=np.array([6e-4]),
        stribeck=np.array([0.004]),
        stribeck_speed=np.array([0.6]),
        amplitude=np.array([[0.10, 0.06, 0.03]]),
        phase=np.array([[0.3, 1.9, -0.8]]),
    )
    return Plant(
        arm=arm,
        nominal=off_nominal(arm, 0.15),
        friction=friction,
        gains=gains_for(np.array([LINK_INERTIA + GEAR**2 * ROTOR]), bandwidth=10.0, observer=50.0),
        torque_constant=np.array([TORQUE_CONSTANT]),
        encoder_step=np.array([2 * np.pi / (COUNTS * quadrature_factor * GEAR)]),
        current_noise=np.array([0.036]),
        coulomb_guess=np.array([0.025]),
        position_limits=np.array([[-2.6, 2.6]]),
        velocity_limits=np.array([8.0]),
        acceleration_limits=np.array([60.0]),
        current_step=2.0**-8,
        coloured=0.1,
        imus=(imu,),
    )


def two_joint() -> Plant:
    """Sec. 4.2: planar, axes along gravity, base parameters of Eq. 44 as in Table IV (CAD)."""
    reflected = GEAR**2 * ROTOR
    inner = PI_1 - reflected - LINK_MASS * UPPER_LENGTH**2
    arm = Arm(
        names=("joint_1", "joint_2"),
        dh=np.array([[0.0, 0.0, 0.0, 0.0], [0.0, UPPER_LENGTH, 0.0, 0.0]]),
        phi=np.vstack(
            [_light_link(inner, 0.12, 0.62), _light_link(LINK_INERTIA, MOMENT, LINK_MASS)]
        ),
        gravity=np.array([0.0, 0.0, -GRAVITY]),
        gear=np.full(2, GEAR),
        rotor_inertia=np.full(2, ROTOR),
    )
    imus = (
        array_on("imu_a", 0, (0.2, 0.7, -0.5), (0.25, 0.01, 0.02), bias=0.02),
        array_on("imu_b", 1, (-0.6, 0.4, 1.0), (0.08, -0.01, 0.01), bias=0.02),
    )
    friction = SurfaceFriction(
        coulomb=np.array([0.040, 0.027]),
        viscous=np.array([2.0e-3, 6e-4]),
        stribeck=np.array([0.006, 0.004]),
        stribeck_speed=np.array([0.5, 0.6]),
        amplitude=np.array([[0.09, 0.06, 0.03], [0.10, 0.05, 0.04]]),
        phase=np.array([[1.1, -0.4, 0.7], [0.3, 1.9, -0.8]]),
    )
    return Plant(
        arm=arm,
        nominal=off_nominal(arm, 0.15),
        friction=friction,
        gains=gains_for(np.array([0.042, 0.0020]), bandwidth=10.0, observer=50.0),
        torque_constant=np.full(2, TORQUE_CONSTANT),
        encoder_step=np.full(2, 2 * np.pi / (COUNTS * GEAR)),
        current_noise=np.array([0.045, 0.036]),
        coulomb_guess=np.array([0.037, 0.025]),
        position_limits=np.array([[-2.6, 2.6], [-2.6, 2.6]]),
        velocity_limits=np.array([6.0, 8.0]),
        acceleration_limits=np.array([30.0, 60.0]),
        current_step=2.0**-8,
        coloured=0.1,
        imus=imus,
    )


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
UR5E_NAMES = ("shoulder_pan", "shoulder_lift", "elbow", "wrist_1", "wrist_2", "wrist_3")
UR5E_MASS = (3.76, 8.06, 2.85, 1.37, 1.30, 0.365)
UR5E_CENTRE = (
    (0.004, 0.021, -0.027),
    (-0.213, 0.006, 0.121),
    (-0.187, -0.005, 0.024),
    (0.003, 0.014, 0.022),
    (-0.002, -0.012, 0.019),
    (0.011, 0.007, -0.024),
)
UR5E_GYRATION = (  # radii of gyration about the centre of mass, m, along turned axes
    (0.068, 0.064, 0.055),
    (0.045, 0.152, 0.150),
    (0.038, 0.131, 0.129),
    (0.041, 0.038, 0.036),
    (0.040, 0.037, 0.035),
    (0.030, 0.029, 0.034),
)


def standard_parameters(
    mass: float, centre: tuple[float, ...], gyration: tuple[float, ...], turn: Array
) -> Array:
    """Return standard parameters (10,) of a body with principal axes `turn` (3, 3)."""
    c = np.array(centre)
    radii = np.array(gyration) ** 2
    central = mass * turn @ np.diag(radii) @ turn.T
    about = central + mass * (c @ c * np.eye(3) - np.outer(c, c))
    upper = [about[0, 0], about[0, 1], about[1, 1], about[0, 2], about[1, 2], about[2, 2]]
    return np.array([mass, *(mass * c), *upper])


def _ur5e_arm() -> Arm:
    bodies = [
        standard_parameters(m, c, g, mounting(0.05 * (i + 1), 0.06 - 0.02 * i, 0.04))
        for i, (m, c, g) in enumerate(zip(UR5E_MASS, UR5E_CENTRE, UR5E_GYRATION, strict=True))
    ]
    return Arm(
        names=UR5E_NAMES,
        dh=UR5E_DH,
        phi=np.array(bodies),
        gravity=np.array([0.0, 0.0, -GRAVITY]),
        gear=np.full(6, 101.0),
        rotor_inertia=np.array([1.0e-4, 1.0e-4, 8.0e-5, 2.4e-5, 2.4e-5, 2.2e-5]),
    )


def _ur5e_friction() -> SurfaceFriction:
    k = np.arange(6)
    first, second = 0.08 + 0.015 * np.sin(k), 0.05 + 0.01 * np.cos(k)
    amplitude = np.column_stack([first, second, np.full(6, 0.02)])
    phase = np.column_stack([0.4 + 1.1 * k, 2.0 - 0.7 * k, 0.5 * k])
    return SurfaceFriction(
        coulomb=np.array([8.2, 9.4, 6.6, 1.9, 1.7, 1.4]),
        viscous=np.array([7.4, 8.3, 5.8, 1.7, 1.5, 1.3]),
        stribeck=np.array([1.1, 1.3, 0.9, 0.3, 0.3, 0.25]),
        stribeck_speed=np.array([0.15, 0.15, 0.18, 0.25, 0.25, 0.25]),
        amplitude=amplitude,
        phase=phase,
    )


def plain(friction: SurfaceFriction) -> SurfaceFriction:
    """Coulomb and viscous friction alone."""
    none = np.zeros_like(friction.coulomb)
    return replace(friction, stribeck=none, amplitude=np.zeros_like(friction.amplitude))


def six_joint(*, simple_friction: bool = False) -> Plant:
    """Build an arm with a UR5e's geometry and masses, strain-wave-like drives, two arrays."""
    arm = _ur5e_arm()
    imus = (
        array_on("imu_a", 2, (0.5, -0.4, 0.9), (-0.30, 0.03, 0.06), size=0.06),
        array_on("imu_b", 5, (-0.3, 1.1, 0.2), (0.02, 0.01, 0.04), size=0.06),
    )
    friction = plain(_ur5e_friction()) if simple_friction else _ur5e_friction()
    drive = np.array([0.122, 0.120, 0.118, 0.104, 0.101, 0.103])
    hiss = np.array([0.075, 0.075, 0.06, 0.022, 0.022, 0.022])
    inertia = arm.reflected + np.array([2.0, 2.4, 0.6, 0.03, 0.02, 0.005])
    return Plant(
        arm=arm,
        nominal=off_nominal(arm, 0.12),
        friction=friction,
        gains=gains_for(inertia, bandwidth=20.0, observer=150.0),
        torque_constant=drive,
        encoder_step=np.full(6, 2.0**-15),
        current_noise=hiss,
        coulomb_guess=0.9 * friction.coulomb,
        position_limits=np.array(
            [[-2.8, 2.8], [-2.7, 0.3], [-2.4, 2.4], [-2.9, 2.9], [-2.8, 2.8], [-2.8, 2.8]]
        ),
        velocity_limits=np.array([2.2, 2.2, 2.6, 3.1, 3.1, 3.1]),
        acceleration_limits=np.array([9.0, 9.0, 12.0, 22.0, 22.0, 25.0]),
        current_step=np.array([2.0**-5] * 3 + [2.0**-6] * 3),
        coloured=0.1,
        imus=imus,
    )
