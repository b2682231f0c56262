"""An arm in MuJoCo that follows a motion, its imperfections of the mechanics inside.

The same arms, controller and step as of `tests.studies.outside.simulate`, with effects
of drives only, in plain floats: a step of a two-joint arm takes some ten microseconds.
"""

import xml.etree.ElementTree as ET
from dataclasses import dataclass
from math import sin

import mujoco
import numpy as np

from tests import Array
from tests.studies.outside.arms import GRAVITY
from tests.studies.outside.effects import found
from tests.studies.outside.robotfiles import STEP_S, mjcf, row
from tests.studies.outside.simulate import DAMPING, controller
from tests.studies.truth.plan import Case

# of a joint that stands: without its brake it would sag by 10 mrad in this loop
BRAKE_NM = 1e3


@dataclass(frozen=True, kw_only=True)
class Followed:
    """What happened, at 1 kHz: (N,) s, (N, n) rad, N m and K, and what IMUs feel (N,
    s).
    """

    t: Array
    q: Array
    torque: Array
    warmth: Array
    sensed: Array


def model_of(case: Case, *, with_tool: bool = False) -> mujoco.MjModel:
    """Build the arm as it stands: on its base, with or without its tool."""
    root, last = mjcf(case.arm), case.arm.links[-1]
    if tilt := case.sizes("gravity"):
        angle, azimuth = np.radians(tilt["degrees"]), tilt["azimuth"]
        aside = np.sin(angle) * np.array([np.cos(azimuth), np.sin(azimuth)])
        found(root, "option").set(
            "gravity", row(-GRAVITY * np.array([*aside, np.cos(angle)]))
        )
    if with_tool and (tool := case.sizes("tool")):
        mass = tool["share"] * last.mass
        link = found(root, f".//body[@name='l{len(case.arm.links) - 1}']")
        body = ET.SubElement(link, "body", pos=row(2.0 * last.centre))
        size = row(np.full(3, 0.4 * mass * 0.03**2))
        ET.SubElement(body, "inertial", pos="0 0 0", mass=repr(mass), diaginertia=size)
    return mujoco.MjModel.from_xml_string(ET.tostring(root, encoding="unicode"))


def shares_up(case: Case) -> list[float]:
    """Return by which share each joint's friction is larger on the way up, (n,)."""
    sizes = case.sizes("asymmetry")
    return list(sizes["shares"]) if sizes else [0.0] * case.arm.n


def heat_of(case: Case, warmth: Array) -> Array:
    """Return the factor of friction (N,
    n) at so many kelvin above the cold arm (N, n).
    """
    sizes = case.sizes("warmth")
    per_kelvin = np.array(sizes["per_kelvin"]) if sizes else np.zeros(case.arm.n)
    return np.asarray(np.exp(per_kelvin * warmth))


class Instants:
    """Makes of an integrator's steps motion, torque and readings of one and the same
    instant.

    MuJoCo's step has its positions, its velocities and its damping at times that are
    half a step apart, and the acceleration that it states is the one before joint
    damping acts implicitly. An IMU 0.1 m off an axis shows that as an error of up to 3
    mm in its place, and viscous friction of 1 N m s/rad as 0.0005 kg m^2 of inertia.
    Here all of it is of the time of the positions.
    """

    def __init__(self, model: mujoco.MjModel, data: mujoco.MjData) -> None:
        self.model, self.data = model, data
        self._later_damping = 0.5 * STEP_S * model.dof_damping
        self._bias = np.zeros(model.nv)

    def step(self, acting: Array) -> tuple[Array, Array]:
        """Make a step; return the torque (n,) that belongs to it, and what IMUs feel
        (s,).

        `acting` (n,) N m is what drives it. All is of the instant at which the step
        began.
        """
        model, data = self.model, self.data
        dq_before = data.qvel.copy()
        mujoco.mj_step(model, data)
        dq_after = data.qvel.copy()
        bias_before = data.qfrc_bias.copy()
        ddq = (dq_after - dq_before) / STEP_S

        # What a step has computed of the positions is still that of its beginning.
        data.qvel[:] = dq_before + 0.5 * STEP_S * ddq
        mujoco.mj_comVel(model, data)
        mujoco.mj_rne(model, data, 0, self._bias)
        torque = acting + self._bias - bias_before - self._later_damping * ddq
        if model.nsensordata:
            mujoco.mj_sensorVel(model, data)
            data.qacc[:] = ddq
            data.flg_rnepost = 0
            mujoco.mj_sensorAcc(model, data)
        data.qvel[:] = dq_after
        return torque, data.sensordata


def follow(
    case: Case, reference: Array, start: float, *, with_tool: bool = False
) -> Followed:
    """Follow a motion (N, n) rad, 1 kHz, from `start` s of the session on."""
    arm, n = case.arm, case.arm.n
    model = model_of(case, with_tool=with_tool)
    data = mujoco.MjData(model)
    data.qpos[:] = reference[0]
    mujoco.mj_forward(model, data)

    # The controller of the other study, which knows the rigid arm.
    rate = np.gradient(reference, STEP_S, axis=0)
    felt, forward = controller(arm, reference, rate)
    kp = (felt * arm.bandwidth**2).tolist()
    kd = (felt * 2.0 * DAMPING * arm.bandwidth).tolist()

    times = start + np.arange(len(reference)) * STEP_S
    warmth = np.array([d.rise * -np.expm1(-times / d.warm_s) for d in arm.drives]).T
    heat = heat_of(case, warmth).tolist()
    up = shares_up(case)
    coulomb, waviness, phase, viscous = (
        arm.of(name).tolist() for name in ("coulomb", "waviness", "phase", "viscous")
    )
    out = case.sizes("left_out")
    if out and not out["moves"]:
        coulomb[out["joint"]] += BRAKE_NM
    wanted, wanted_rate, fed = reference.tolist(), rate.tolist(), forward.tolist()
    q = np.empty_like(reference)
    torque = np.empty_like(reference)
    sensed = np.empty((len(reference), model.nsensordata))
    instants = Instants(model, data)
    joints = range(n)
    dry, acting = [0.0] * n, [0.0] * n
    for k in range(len(reference)):
        now, speed = data.qpos.tolist(), data.qvel.tolist()
        told = [
            kp[j] * (wanted[k][j] - now[j])
            + kd[j] * (wanted_rate[k][j] - speed[j])
            + fed[k][j]
            for j in joints
        ]
        for j in joints:
            factor = heat[k][j] * (1.0 + up[j] if speed[j] > 0.0 else 1.0)
            dry[j] = factor * coulomb[j] * (1.0 + waviness[j] * sin(now[j] + phase[j]))
            # MuJoCo's own damping is the cold joint's.
            acting[j] = told[j] - (factor - 1.0) * viscous[j] * speed[j]
        model.dof_frictionloss[:] = dry
        data.qfrc_applied[:] = acting
        q[k] = now
        torque[k], sensed[k] = instants.step(np.array(told))
    return Followed(t=times, q=q, torque=torque, warmth=warmth, sensed=sensed)
