"""Rigid-body forward dynamics of a serial arm, written apart from the package."""

from dataclasses import dataclass

import numpy as np
import pinocchio as pin

from tests import Array

PHI_NAMES = ("m", "mx", "my", "mz", "Ixx", "Ixy", "Iyy", "Ixz", "Iyz", "Izz")


@dataclass(frozen=True)
class Arm:
    """Constants of the arm; geometry is modified DH (Craig), the axis is the link
    frame's z.
    """

    names: tuple[str, ...]
    dh: Array  # (n, 4) alpha [rad], a [m], d [m], theta0 [rad]
    phi: Array  # (n, 10), as PHI_NAMES, inertia about the link frame's origin
    gravity: Array  # (3,) m/s^2 in the base frame
    gear: Array  # (n,)
    rotor_inertia: Array  # (n,) kg m^2, motor side
    # rotors, on the link before their joint, react on that link
    rotor_coupling: bool = False

    @property
    def n(self) -> int:
        return len(self.names)

    @property
    def reflected(self) -> Array:
        """Rotor inertia seen at the joint, (n,) kg m^2."""
        return self.gear**2 * self.rotor_inertia


def rot_x(angle: float) -> Array:  # rad
    c, s = np.cos(angle), np.sin(angle)
    return np.array([[1.0, 0.0, 0.0], [0.0, c, -s], [0.0, s, c]])


def rot_z(angle: Array) -> Array:
    """Rotations about z by `angle` (N,) rad, (N, 3, 3)."""
    (c, s), out = (np.cos(angle), np.sin(angle)), np.zeros((*angle.shape, 3, 3))
    out[..., 0, 0], out[..., 0, 1], out[..., 1, 0], out[..., 1, 1], out[..., 2, 2] = (
        c,
        -s,
        s,
        c,
        1,
    )
    return out


def placement(row: Array) -> tuple[Array, Array]:
    """Rotation (3, 3) and origin (3,) m of a link frame in the one before it,
    at q = 0.
    """
    alpha, a, d, theta0 = (float(x) for x in row)
    tilt = rot_x(alpha)
    return tilt @ rot_z(np.array(theta0)), np.array([a, 0.0, 0.0]) + tilt @ np.array(
        [0.0, 0.0, d]
    )


def build_model(arm: Arm) -> pin.Model:
    model = pin.Model()
    model.gravity.linear = arm.gravity
    parent = 0
    for name, row, phi in zip(arm.names, arm.dh, arm.phi, strict=True):
        rotation, origin = placement(row)
        parent = model.addJoint(
            parent, pin.JointModelRZ(), pin.SE3(rotation, origin), name
        )
        inertia = pin.Inertia.FromDynamicParameters(phi)
        model.appendBodyToJoint(parent, inertia, pin.SE3.Identity())
    return model


class Rigid:
    """M(q) and h(q, dq) of M ddq + h = tau, rotors included."""

    def __init__(self, arm: Arm) -> None:
        self.arm, self._model = arm, build_model(arm)
        self._data, self._reflected = self._model.createData(), np.diag(arm.reflected)
        self._lower = np.tril_indices(arm.n, -1)

    def terms(self, q: Array, dq: Array) -> tuple[Array, Array]:
        """Mass matrix (n, n) kg m^2 and bias torque (n,) N m (Coriolis and gravity)."""
        mass = pin.crba(self._model, self._data, q, pin.Convention.WORLD)
        mass[self._lower] = mass.T[self._lower]
        mass = mass + self._reflected
        bias = pin.nonLinearEffects(self._model, self._data, q, dq)
        if self.arm.rotor_coupling:
            extra_mass, extra_bias = self._rotor_terms(q, dq)
            mass, bias = mass + extra_mass, bias + extra_bias
        return mass, bias

    def gravity_torque(self, q: Array) -> Array:
        """Torque (n,) N m that holds the arm at rest."""
        return np.array(pin.computeGeneralizedGravity(self._model, self._data, q))

    def inverse(self, q: Array, dq: Array, ddq: Array) -> Array:
        """Torque (n,) N m of a motion by Pinocchio's RNEA, rotors added,
        no friction.
        """
        tau = pin.rnea(self._model, self._data, q, dq, ddq) + self._reflected @ ddq
        if self.arm.rotor_coupling:
            extra_mass, extra_bias = self._rotor_terms(q, dq)
            tau = tau + extra_mass @ ddq + extra_bias
        return np.array(tau)

    def energy(self, q: Array, dq: Array) -> float:
        """Kinetic plus potential energy, J, rotors included."""
        mass, _ = self.terms(q, dq)
        potential = pin.computePotentialEnergy(self._model, self._data, q)
        return float(0.5 * dq @ mass @ dq) + float(potential)

    def _rotor_terms(self, q: Array, dq: Array) -> tuple[Array, Array]:
        """Reaction of spin I_m N dq_i z_i on the link before joint i, and of that link
        on it.
        """
        model, data, arm = self._model, self._data, self.arm
        pin.computeJointJacobians(model, data, q)
        pin.forwardKinematics(model, data, q, dq, np.zeros(arm.n))
        mass, bias = np.zeros((arm.n, arm.n)), np.zeros(arm.n)
        for i in range(1, arm.n):
            spin = arm.gear[i] * arm.rotor_inertia[i]
            jac = pin.getJointJacobian(model, data, i, pin.LOCAL_WORLD_ALIGNED)[3:]
            axis, turn = data.oMi[i + 1].rotation[:, 2], data.oMi[i].rotation
            omega, lever = turn @ data.v[i].angular, jac.T @ axis
            mass[i] += spin * lever
            mass[:, i] += spin * lever
            bias[i] += spin * axis @ (turn @ data.a[i].angular)
            bias += spin * dq[i] * jac.T @ crossed(omega, axis)
        return mass, bias


def crossed(a: Array, b: Array) -> Array:
    """Cross product of two vectors (3,), without what `np.cross` does for stacks."""
    (a1, a2, a3), (b1, b2, b3) = a.tolist(), b.tolist()
    return np.array([a2 * b3 - a3 * b2, a3 * b1 - a1 * b3, a1 * b2 - a2 * b1])


@dataclass(frozen=True)
class LinkMotion:
    """Motion of one link frame; rates and origin's acceleration in the link frame."""

    rotation: Array  # (N, 3, 3), R_BL
    omega: Array  # (N, 3) rad/s
    alpha: Array  # (N, 3) rad/s^2
    force: Array  # (N, 3) m/s^2, acceleration minus gravity


def link_motion(arm: Arm, link: int, q: Array, dq: Array, ddq: Array) -> LinkMotion:
    """Move along the chain to `link` (0-based), vectorised over the N samples of q, dq,
    ddq.
    """
    count = len(q)
    rotation = np.broadcast_to(np.eye(3), (count, 3, 3))
    omega, alpha = np.zeros((count, 3)), np.zeros((count, 3))
    force = np.broadcast_to(-arm.gravity, (count, 3))
    for i in range(link + 1):
        fixed, origin = placement(arm.dh[i])
        force = (
            force + np.cross(alpha, origin) + np.cross(omega, np.cross(omega, origin))
        )
        turn = fixed @ rot_z(q[:, i])
        back = np.swapaxes(turn, 1, 2)
        omega, alpha, force = (
            np.einsum("nij,nj->ni", back, x) for x in (omega, alpha, force)
        )
        rate = np.zeros((count, 3))
        rate[:, 2] = dq[:, i]
        alpha = alpha + np.cross(omega, rate)
        alpha[:, 2] += ddq[:, i]
        omega = omega + rate
        rotation = rotation @ turn
    return LinkMotion(rotation, omega, alpha, force)
