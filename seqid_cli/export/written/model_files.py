"""Model files of an arm at work: URDF and MJCF, read by Pinocchio and MuJoCo."""

from __future__ import annotations

import importlib.util
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pinocchio as pin

from seqid_cli.export.written.arm import FrictionalArm, WrittenArm, check_joints
from seqid_cli.robot.types import Robot
from seqid_cli.typing import Array


class _PinocchioArm(FrictionalArm):
    """Links in Pinocchio; joints that are not the arm's are locked at zero.

    Attributes
    ----------
    velocity_at : list of int
        Where the arm's joints are among the velocities of Pinocchio.
    springs : list of array
        Torque of each joint by powers of its position, N m, N m/rad ...
    armature : (n,) array
        Inertias of rotors as the joints feel them, kg m^2.
    """

    def __init__(self, model: pin.Model, robot: Robot) -> None:
        super().__init__(robot.n)
        names = list(model.names)
        check_joints(names, robot)
        locked = [
            k for k in range(1, model.njoints) if names[k] not in robot.joint_names
        ]
        reduced = pin.buildReducedModel(model, locked, pin.neutral(model))
        reduced.gravity.linear = robot.gravity
        reduced.armature = np.zeros(reduced.nv)  # it is added here
        self._model = reduced
        self._data = reduced.createData()

        joints = [
            reduced.joints[reduced.getJointId(name)] for name in robot.joint_names
        ]
        self.velocity_at = [joint.idx_v for joint in joints]
        self.springs: list[Array] = [np.zeros(1)] * robot.n
        self.armature = np.zeros(robot.n)

    def rigid(self, q: Array, dq: Array, ddq: Array) -> Array:
        """Return the torque (N, n) N m of links, gravity, rotors and springs."""
        model = self._model
        neutral = pin.neutral(model)
        tau = np.empty_like(q)
        position, velocity, acceleration = np.zeros((3, model.nv))
        for k in range(len(q)):
            position[self.velocity_at] = q[k]
            velocity[self.velocity_at] = dq[k]
            acceleration[self.velocity_at] = ddq[k]
            configuration = pin.integrate(model, neutral, position)
            torque = pin.rnea(model, self._data, configuration, velocity, acceleration)
            tau[k] = torque[self.velocity_at]

        tau += self.armature * ddq
        for j, law in enumerate(self.springs):
            tau[:, j] += np.polynomial.Polynomial(law)(q[:, j])
        return tau


class UrdfArm(_PinocchioArm):
    """A URDF: `dynamics` of its joints, and rotors from the transmissions."""

    def __init__(self, path: Path, robot: Robot) -> None:
        text = path.read_text(encoding="utf-8")
        super().__init__(pin.buildModelFromXML(text), robot)

        root = ElementTree.fromstring(text)
        joints = {joint.get("name"): joint for joint in root.findall("joint")}
        for j, name in enumerate(robot.joint_names):
            dynamics = joints[name].find("dynamics")
            if dynamics is not None:
                self.coulomb[j] = float(dynamics.get("friction", 0.0))
                self.viscous[j] = float(dynamics.get("damping", 0.0))

        for transmission in root.findall("transmission"):
            moved = [joint.get("name") for joint in transmission.findall("joint")]
            if len(moved) == 1 and moved[0] in robot.joint_names:
                j = robot.joint_names.index(moved[0])
                self.armature[j] = _reflected_inertia(transmission)


def _reflected_inertia(transmission: ElementTree.Element) -> float:
    """Return the rotor inertia of a transmission as its joint feels it, kg m^2."""
    drake = "{http://drake.mit.edu}"
    rotor = transmission.find(f"actuator/{drake}rotor_inertia")
    ratio = transmission.find(f"actuator/{drake}gear_ratio")
    if rotor is None or ratio is None:
        return 0.0
    return float(rotor.get("value", 0.0)) * float(ratio.get("value", 1.0)) ** 2


def mjcf_arm(path: Path, robot: Robot) -> WrittenArm:
    """Return MJCF as MuJoCo reads it, or else as Pinocchio does.

    The latter is for machines on which MuJoCo is not installed.
    """
    if importlib.util.find_spec("mujoco") is not None:
        return MujocoArm(path, robot)
    return PinocchioMjcfArm(path, robot)


class MujocoArm(FrictionalArm):
    """MJCF in MuJoCo: its inverse dynamics, limits and contacts apart."""

    def __init__(self, path: Path, robot: Robot) -> None:
        import mujoco

        super().__init__(robot.n)
        self._mujoco = mujoco
        model = mujoco.MjModel.from_xml_path(str(path))
        check_joints([model.joint(k).name for k in range(model.njnt)], robot)
        joints = [model.joint(name) for name in robot.joint_names]
        self._velocity_at = [int(joint.dofadr[0]) for joint in joints]
        self._position_at = [int(joint.qposadr[0]) for joint in joints]

        # Later versions give damping as several numbers, by powers of the speed.
        damping = np.asarray(model.dof_damping).reshape(model.nv, -1)
        self.viscous = damping[self._velocity_at, 0].copy()
        self.coulomb = np.asarray(model.dof_frictionloss)[self._velocity_at].copy()

        # Inverse dynamics of links, rotors and springs alone.
        model.dof_damping[:] = 0.0
        model.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_CONSTRAINT
        self._model = model
        self._data = mujoco.MjData(model)

    def rigid(self, q: Array, dq: Array, ddq: Array) -> Array:
        """Return the torque (N, n) N m of links, gravity, rotors and springs."""
        data = self._data
        tau = np.empty_like(q)
        for k in range(len(q)):
            data.qpos[self._position_at] = q[k]
            data.qvel[self._velocity_at] = dq[k]
            data.qacc[self._velocity_at] = ddq[k]
            self._mujoco.mj_inverse(self._model, data)
            tau[k] = data.qfrc_inverse[self._velocity_at]
        return tau


class PinocchioMjcfArm(_PinocchioArm):
    """MJCF in Pinocchio, with what Pinocchio leaves out read from the file."""

    def __init__(self, path: Path, robot: Robot) -> None:
        super().__init__(pin.buildModelFromMJCF(str(path)), robot)
        root = ElementTree.parse(path).getroot()
        joints = {joint.get("name"): joint for joint in root.iter("joint")}
        for j, name in enumerate(robot.joint_names):
            joint = joints[name]
            self.armature[j] = float(joint.get("armature", 0.0))
            self.viscous[j] = float(joint.get("damping", 0.0))
            self.coulomb[j] = float(joint.get("frictionloss", 0.0))

            # A polynomial in how far the joint is from where its spring is slack.
            stiffness = [float(word) for word in joint.get("stiffness", "0").split()]
            slack_at = float(joint.get("springref", 0.0))
            stretch = np.polynomial.Polynomial([-slack_at, 1.0])
            torque = np.polynomial.Polynomial([0.0, *stiffness])(stretch)
            self.springs[j] = np.asarray(torque.coef, dtype=np.float64)
