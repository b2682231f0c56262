"""An arm as MJCF for the simulator, and as URDF and robot file for the user."""

import xml.etree.ElementTree as ET
from collections.abc import Sequence

import numpy as np

from tests import Array
from tests.studies.outside.arms import GRAVITY, Arm, Imu

STEP_S = 1e-3
# how hard it sticks
FRICTION = {"solreffriction": "0.002 1", "solimpfriction": "0.99 0.999 0.001"}


def row(values: Array) -> str:
    return " ".join(repr(float(x)) for x in np.ravel(values))


def mjcf(arm: Arm) -> ET.Element:
    """The arm for MuJoCo; dry friction is a constraint there,
    so that joints can stick.
    """
    root = ET.Element("mujoco")
    ET.SubElement(
        root, "compiler", angle="radian", eulerseq="XYZ", balanceinertia="false"
    )
    gravity = f"0 0 {-GRAVITY}"
    option = {
        "timestep": repr(STEP_S),
        "integrator": "implicitfast",
        "gravity": gravity,
    }
    ET.SubElement(root, "option", option)
    parent = ET.SubElement(root, "worldbody")
    sensors = ET.SubElement(root, "sensor")
    for k, link in enumerate(arm.links):
        place = {"pos": row(link.place), "euler": row(link.turn)}
        parent = ET.SubElement(parent, "body", {"name": f"l{k}", **place})
        matrix = link.inertia[[0, 1, 2, 0, 0, 1], [0, 1, 2, 1, 2, 2]]
        body = {
            "pos": row(link.centre),
            "mass": repr(link.mass),
            "fullinertia": row(matrix),
        }
        ET.SubElement(parent, "inertial", body)
        if k < arm.n:
            drive = arm.drives[k]
            joint = {
                "name": arm.names[k],
                "type": "hinge",
                "axis": row(link.axis),
            } | FRICTION
            joint |= {"armature": repr(drive.rotor), "damping": repr(drive.viscous)}
            ET.SubElement(
                parent, "joint", joint | {"frictionloss": repr(drive.coulomb)}
            )
        for i, imu in enumerate(arm.imus):
            if imu.link == k:
                _sites(parent, sensors, f"imu{i}", imu)
    ET.SubElement(root, "tendon")
    return root


def _sites(body: ET.Element, sensors: ET.Element, name: str, imu: Imu) -> None:
    w, *v = imu.quaternion
    for k, corner in enumerate(imu.corners):
        turned = corner + 2.0 * np.cross(v, np.cross(v, corner) + w * corner)
        site = f"{name}_{k}"
        at = {"name": site, "pos": row(imu.place + turned), "quat": row(imu.quaternion)}
        ET.SubElement(body, "site", at)
        ET.SubElement(sensors, "accelerometer", name=f"{site}_a", site=site)
    if imu.gyro:
        ET.SubElement(sensors, "gyro", name=f"{name}_g", site=f"{name}_0")


def urdf(arm: Arm) -> str:
    root = ET.Element("robot", name="outside")
    ET.SubElement(root, "link", name="base")
    for k, link in enumerate(arm.links):
        body = ET.SubElement(ET.SubElement(root, "link", name=f"l{k}"), "inertial")
        ET.SubElement(body, "origin", xyz=row(link.centre))
        ET.SubElement(body, "mass", value=repr(link.mass))
        upper = zip(*np.triu_indices(3), strict=True)
        values = {
            f"i{'xyz'[i]}{'xyz'[k]}": repr(float(link.inertia[i, k])) for i, k in upper
        }
        ET.SubElement(body, "inertia", values)
        name = arm.names[k] if (moves := k < arm.n) else f"lock{k}"
        joint = ET.SubElement(
            root, "joint", name=name, type="revolute" if moves else "fixed"
        )
        ET.SubElement(joint, "parent", link=f"l{k - 1}" if k else "base")
        ET.SubElement(joint, "child", link=f"l{k}")
        ET.SubElement(joint, "origin", xyz=row(link.place), rpy=row(link.turn))
        if moves:
            ET.SubElement(joint, "axis", xyz=row(link.axis))
            lower, upper = (
                link.middle - 2.0 * link.reach,
                link.middle + 2.0 * link.reach,
            )
            limit = ET.SubElement(joint, "limit", lower=repr(lower), upper=repr(upper))
            limit.attrib |= {"velocity": repr(1.5 * link.speed), "effort": "1e4"}
    return ET.tostring(root, encoding="unicode")


def robot_toml(
    arm: Arm,
    *,
    joints: Sequence[int] | None = None,
    of_robot: Sequence[str] = (),
    of_joints: Sequence[str] = (),
) -> str:
    """Robot file of all joints or of some; more lines for the robot and for every
    joint.
    """
    lines = ['schema = "seqid/robot@1"', 'name = "outside"', 'urdf = "arm.urdf"']
    lines += [f"gravity = [0.0, 0.0, {-GRAVITY}]", *of_robot]
    for j in range(arm.n) if joints is None else joints:
        drive = arm.drives[j]
        lines += [
            "[[joint]]",
            f'name = "{arm.names[j]}"',
            f"gear_ratio = {drive.ratio!r}",
        ]
        lines += [
            f"torque_constant = {drive.constant!r}",
            f"encoder_resolution = {drive.count!r}",
        ]
        lines += of_joints
    for k, imu in enumerate(arm.imus):
        lines += [
            "[[imu]]",
            f'name = "imu{k}"',
            f'after_joint = "{arm.names[imu.link]}"',
        ]
        lines += [f"gyro = {str(imu.gyro).lower()}", "accelerometers = ["]
        for corner in imu.corners:
            at = corner.tolist()
            lines += [
                f"  {{ position = {at}, axis = {a} }}," for a in np.eye(3).tolist()
            ]
        lines += ["]"]
    lines += ["[channels]", f'effort = "{"current" if arm.currents else "torque"}"']
    return "\n".join(lines) + "\n"
