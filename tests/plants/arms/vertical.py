"""A two-joint arm of a small industrial robot's size that moves in the vertical
plane.
"""

import numpy as np

from tests.plants.arms.rigs import DOWN, array_on, geared, plain, standard_parameters
from tests.plants.friction.surface import SurfaceFriction
from tests.plants.mechanics.rigid import Arm
from tests.plants.simulate import Plant

LENGTH = 0.4  # m, of each link


def vertical_two_joint(*, simple_friction: bool = False) -> Plant:
    """Gears 100 and 80, links of 0.4 m, 3 and 2 kg; stretched and level at q = 0."""
    bars = [
        standard_parameters(3.0, (0.19, 0.01, 0.0), (0.03, 0.12, 0.12), np.eye(3)),
        standard_parameters(2.0, (0.17, -0.008, 0.0), (0.025, 0.11, 0.11), np.eye(3)),
    ]
    arm = Arm(
        names=("shoulder", "elbow"),
        dh=np.array([[np.pi / 2, 0.0, 0.2, 0.0], [0.0, LENGTH, 0.0, 0.0]]),
        phi=np.array(bars),
        gravity=DOWN,
        gear=np.array([100.0, 80.0]),
        rotor_inertia=np.array([5.0e-5, 2.5e-5]),
    )
    friction = SurfaceFriction(
        coulomb=np.array([2.6, 1.0]),
        viscous=np.array([1.5, 0.5]),
        stribeck=np.array([0.35, 0.15]),
        stribeck_speed=np.array([0.12, 0.15]),
        amplitude=np.array([[0.07, 0.04], [0.08, 0.03]]),
        phase=np.array([[0.4, 2.0], [-1.1, 0.6]]),
    )
    drive, rated = np.array([0.11, 0.09]), np.array([30.0, 9.0])  # N m/A, N m
    imus = (
        array_on("imu_a", 0, (0.3, 0.5, -0.2), (0.3, 0.02, 0.03)),
        array_on("imu_b", 1, (-0.4, 0.8, 0.1), (0.25, -0.02, 0.02)),
    )
    return geared(
        arm,
        plain(friction) if simple_friction else friction,
        np.array([1.0, 0.12]),
        torque_constant=drive,
        encoder_step=2.0 * np.pi / (2**14 * arm.gear),
        current_noise=0.004 * rated / (drive * arm.gear),
        position_limits=np.array([[-2.6, 2.6], [-2.4, 2.4]]),
        velocity_limits=np.array([2.6, 3.2]),
        acceleration_limits=np.array([10.0, 16.0]),
        current_step=2.0**-11,
        imus=imus,
    )
