"""The robot file and, for the arm with a URDF, the URDF that go with a plant's logs."""

import numpy as np

from tests import Array
from tests.plants.mechanics.rigid import rot_x
from tests.plants.simulate import Plant


def robot_toml(name: str, plant: Plant, *, urdf: str | None = None) -> str:
    """Text of `robot.toml`; geometry as modified DH unless a URDF's file name
    is given.
    """
    arm = plant.arm
    lines = ['schema = "seqid/robot@1"', f'name = "{name}"']
    lines += [] if urdf is None else [f'urdf = "{urdf}"']
    lines += [f"gravity = {arm.gravity.tolist()}"]
    numbers = {
        "torque_constant": plant.torque_constant,
        "gear_ratio": arm.gear,
        "rotor_inertia": arm.rotor_inertia,
        "encoder_resolution": plant.encoder_step,
        "position_limits": plant.position_limits,
        "velocity_limit": plant.velocity_limits,
    }
    for joint, (label, row) in enumerate(zip(arm.names, arm.dh.tolist(), strict=True)):
        lines += ["", "[[joint]]", f'name = "{label}"']
        if urdf is None:
            pairs = zip(("alpha", "a", "d", "theta0"), row, strict=True)
            lines.append(
                f"dh = {{ {', '.join(f'{key} = {value!r}' for key, value in pairs)} }}"
            )
        lines += [
            f"{key} = {values[joint].tolist()!r}" for key, values in numbers.items()
        ]
    for imu in plant.imus:
        sensors = zip(imu.positions.tolist(), imu.axes.tolist(), strict=True)
        lines += [
            "",
            "[[imu]]",
            f'name = "{imu.name}"',
            f'after_joint = "{arm.names[imu.after]}"',
        ]
        lines += ["accelerometers = ["]
        lines += [
            f"  {{ position = {place}, axis = {axis} }}," for place, axis in sensors
        ]
        lines += ["]", f"gyro = {str(imu.gyro_noise is not None).lower()}"]
    return "\n".join([*lines, "", "[channels]", 'effort = "current"', ""])


def urdf_text(name: str, plant: Plant) -> str:
    """URDF of the arm with the inertials that its maker would publish
    (`plant.nominal`).
    """
    parent, parts = "base_link", '  <link name="base_link"/>\n'
    for i, joint in enumerate(plant.arm.names):
        phi = plant.nominal.phi[i]
        mass, centre = float(phi[0]), phi[1:4] / float(phi[0])
        xx, xy, yy, xz, yz, zz = phi[4:]
        shift = mass * (centre @ centre * np.eye(3) - np.outer(centre, centre))
        central = np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]]) - shift
        ixx, ixy, ixz, _, iyy, iyz, _, _, izz = (f"{x:.9g}" for x in central.ravel())
        alpha, a, d, theta0 = plant.arm.dh[i].tolist()
        if theta0 != 0.0:
            raise ValueError(f"{joint}: theta0 is {theta0}, this writer needs 0")
        origin = np.array([a, 0.0, 0.0]) + rot_x(alpha) @ np.array([0.0, 0.0, d])
        low, high = plant.position_limits[i].tolist()
        parts += f"""\
  <link name="{joint}_link">
    <inertial>
      <origin xyz="{_xyz(centre)}" rpy="0 0 0"/>
      <mass value="{mass:.9g}"/>
      <inertia ixx="{ixx}" ixy="{ixy}" ixz="{ixz}" iyy="{iyy}" iyz="{iyz}" izz="{izz}"/>
    </inertial>
  </link>
  <joint name="{joint}" type="revolute">
    <parent link="{parent}"/>
    <child link="{joint}_link"/>
    <origin xyz="{_xyz(origin)}" rpy="{alpha!r} 0 0"/>
    <axis xyz="0 0 1"/>
    <limit lower="{low!r}" upper="{high!r}" effort="100.0"\
 velocity="{float(plant.velocity_limits[i])!r}"/>
  </joint>
"""
        parent = f"{joint}_link"
    return f'<?xml version="1.0"?>\n<robot name="{name}">\n{parts}</robot>\n'


def _xyz(values: Array) -> str:
    return " ".join(f"{float(x) + 0.0:.12g}" for x in values)
