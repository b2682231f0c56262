"""The robot file and, for the arm with a URDF, the URDF that go with a plant's logs."""

import numpy as np

from tests import Array
from tests.plants.mechanics.rigid import Arm, rot_x
from tests.plants.sensors import AccelerometerArray
from tests.plants.simulate import Plant


def robot_toml(name: str, plant: Plant, *, urdf: str | None = None) -> str:
    """Text of `robot.toml`; geometry as modified DH unless a URDF's file name is given."""
    lines = ['schema = "seqid/robot@1"', f'name = "{name}"']
    if urdf is not None:
        lines.append(f'urdf = "{urdf}"')
    lines.append(f"gravity = {_row(plant.arm.gravity)}")
    for joint in range(plant.arm.n):
        lines += ["", *_joint(plant, joint, with_dh=urdf is None)]
    for imu in plant.imus:
        lines += ["", *_imu(plant.arm, imu)]
    return "\n".join([*lines, "", "[channels]", 'effort = "current"', ""])


def _joint(plant: Plant, joint: int, *, with_dh: bool) -> list[str]:
    low, high = plant.position_limits[joint]
    lines = ["[[joint]]", f'name = "{plant.arm.names[joint]}"']
    if with_dh:
        alpha, a, d, theta0 = (float(x) for x in plant.arm.dh[joint])
        lines.append(f"dh = {{ alpha = {alpha!r}, a = {a!r}, d = {d!r}, theta0 = {theta0!r} }}")
    return [
        *lines,
        f"torque_constant = {float(plant.torque_constant[joint])!r}",
        f"gear_ratio = {float(plant.arm.gear[joint])!r}",
        f"rotor_inertia = {float(plant.arm.rotor_inertia[joint])!r}",
        f"encoder_resolution = {float(plant.encoder_step[joint])!r}",
        f"position_limits = [{float(low)!r}, {float(high)!r}]",
        f"velocity_limit = {float(plant.velocity_limits[joint])!r}",
    ]


def _imu(arm: Arm, imu: AccelerometerArray) -> list[str]:
    rows = [
        f"  {{ position = {_row(p)}, axis = {_row(a)} }},"
        for p, a in zip(imu.positions, imu.axes, strict=True)
    ]
    return [
        "[[imu]]",
        f'name = "{imu.name}"',
        f'after_joint = "{arm.names[imu.after]}"',
        "accelerometers = [",
        *rows,
        "]",
        f"gyro = {str(imu.gyro_noise is not None).lower()}",
    ]


def _row(values: Array) -> str:
    return "[" + ", ".join(repr(float(x)) for x in values) + "]"


def urdf_text(name: str, plant: Plant) -> str:
    """URDF of the arm with the inertials that its maker would publish (`plant.nominal`)."""
    links = ["base_link", *(f"{joint}_link" for joint in plant.arm.names)]
    parts = ['<?xml version="1.0"?>', f'<robot name="{name}">', '  <link name="base_link"/>']
    for i, joint in enumerate(plant.arm.names):
        parts += _urdf_link(links[i + 1], plant.nominal.phi[i])
        parts += _urdf_joint(plant, i, joint, links[i], links[i + 1])
    return "\n".join([*parts, "</robot>", ""])


def _urdf_link(name: str, phi: Array) -> list[str]:
    mass, centre, inertia = central_inertia(phi)
    ixx, ixy, ixz, _, iyy, iyz, _, _, izz = (f"{x:.9g}" for x in inertia.ravel())
    return [
        f'  <link name="{name}">',
        "    <inertial>",
        f'      <origin xyz="{_xyz(centre)}" rpy="0 0 0"/>',
        f'      <mass value="{mass:.9g}"/>',
        f'      <inertia ixx="{ixx}" ixy="{ixy}" ixz="{ixz}" iyy="{iyy}" iyz="{iyz}" izz="{izz}"/>',
        "    </inertial>",
        "  </link>",
    ]


def _urdf_joint(plant: Plant, i: int, joint: str, parent: str, child: str) -> list[str]:
    alpha, a, d, theta0 = (float(x) for x in plant.arm.dh[i])
    if theta0 != 0.0:
        raise ValueError(f"{joint}: theta0 is {theta0}, this writer needs 0")
    origin = np.array([a, 0.0, 0.0]) + rot_x(alpha) @ np.array([0.0, 0.0, d])
    low, high = (float(x) for x in plant.position_limits[i])
    effort = 100.0
    return [
        f'  <joint name="{joint}" type="revolute">',
        f'    <parent link="{parent}"/>',
        f'    <child link="{child}"/>',
        f'    <origin xyz="{_xyz(origin)}" rpy="{alpha!r} 0 0"/>',
        '    <axis xyz="0 0 1"/>',
        f'    <limit lower="{low!r}" upper="{high!r}" effort="{effort!r}"'
        f' velocity="{float(plant.velocity_limits[i])!r}"/>',
        "  </joint>",
    ]


def _xyz(values: Array) -> str:
    return " ".join(f"{float(x) + 0.0:.12g}" for x in values)


def central_inertia(phi: Array) -> tuple[float, Array, Array]:
    """Mass kg, centre of mass (3,) m and inertia about it (3, 3) kg m^2, link axes."""
    mass, centre = float(phi[0]), phi[1:4] / phi[0]
    xx, xy, yy, xz, yz, zz = phi[4:]
    origin = np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
    shift = mass * (centre @ centre * np.eye(3) - np.outer(centre, centre))
    return mass, centre, origin - shift
