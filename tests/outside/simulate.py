"""One log of an arm in MuJoCo: a controller follows a motion, and sensors say what they see."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import mujoco
import numpy as np
from numpy.typing import NDArray

from tests.outside.arms import Arm, mjcf
from tests.outside.motions import STEP_S

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Effect:
    """What the model lacks: how it acts on the simulated arm.

    `model` changes it once, `dry` gives dry friction (n,) from (friction, dq, load), `torque`
    changes what is logged of the torques (N, n) over time, `push` adds a torque (n,) at a moment.
    """

    name: str = "clean"
    joint: int | None = None
    size: float = 0.0
    model: Callable[[mujoco.MjModel], None] | None = None
    dry: Callable[[Array, Array, Array], Array] | None = None
    torque: Callable[[Array], Array] | None = None
    push: Callable[[float], Array] | None = None


NOTHING = Effect()


@dataclass(frozen=True)
class Log:
    """What was logged: t (N,) s, q (N, n) rad, current (N, n) A; and the true torque (N, n) N m."""

    t: Array
    q: Array
    current: Array
    true_torque: Array


def simulate(arm: Arm, reference: Array, seed: int, effect: Effect = NOTHING) -> Log:
    """Follow a motion (N, n) at 1 kHz with a PD controller and the weight fed forward."""
    model = mujoco.MjModel.from_xml_string(mjcf(arm))
    if effect.model:
        effect.model(model)
    data = mujoco.MjData(model)
    data.qpos[:] = reference[0]
    mujoco.mj_forward(model, data)
    felt = 1.0 / model.dof_invweight0
    kp, kd = felt * 40.0**2, felt * 2.0 * 0.8 * 40.0
    speed = np.gradient(reference, STEP_S, axis=0)
    q, tau = np.empty_like(reference), np.empty_like(reference)
    for k, (wanted, rate) in enumerate(zip(reference, speed, strict=True)):
        base = np.array([x.friction(y) for x, y in zip(arm.links, data.qpos, strict=True)])
        load = data.qfrc_bias.copy()
        model.dof_frictionloss[:] = effect.dry(base, data.qvel, load) if effect.dry else base
        torque = kp * (wanted - data.qpos) + kd * (rate - data.qvel) + load
        q[k], tau[k] = data.qpos, torque
        data.qfrc_applied[:] = torque + (effect.push(k * STEP_S) if effect.push else 0.0)
        mujoco.mj_step(model, data)
    return _logged(arm, q, tau, seed, effect)


def _logged(arm: Arm, q: Array, tau: Array, seed: int, effect: Effect) -> Log:
    rng = np.random.default_rng([seed, 5])
    every = round(1.0 / (STEP_S * arm.rate_hz))
    told = effect.torque(tau) if effect.torque else tau
    coulomb = np.array([link.coulomb for link in arm.links])
    told = told + rng.normal(size=told.shape) * arm.noise * coulomb
    counts = np.array([link.count for link in arm.links])
    constants = np.array([link.constant for link in arm.links])
    rows = slice(None, None, every)
    t = np.arange(len(q))[rows] * STEP_S
    return Log(t, counts * np.round(q[rows] / counts), told[rows] / constants, tau[rows])
