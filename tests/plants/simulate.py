"""Closed-loop forward dynamics: controller, actuator, arm and instruments, one step per period.

Positions live at the control instants t_k and velocities half a period later (leapfrog, second
order, no energy drift). The torque commanded at t_k acts from half a period before to half a period
after, so position, current and acceleration of one row belong to the same instant.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from tests.plants.controller import Controller, Gains, feedforward
from tests.plants.friction import Friction, FrictionModel, stick_slip
from tests.plants.rigid import Arm, Rigid, link_motion
from tests.plants.sensors import AccelerometerArray, noise, quantise
from tests.plants.trajectories import Reference

Array = NDArray[np.float64]
TorqueSource = Callable[[float, Array, Array], Array]  # (t, q, dq) -> (n,) N m acting on the joints


@dataclass(frozen=True)
class Plant:
    """A robot with everything that its logs depend on; arrays are (n,).

    `nominal` and `coulomb_guess` are what the controller believes. `current_noise` A is the
    standard deviation at the control rate, a share `coloured` of whose variance is 1/f. `sources`
    are further torques that act on the joints (ripple, springs, contact).
    """

    arm: Arm
    nominal: Arm
    friction: FrictionModel
    gains: Gains
    torque_constant: Array
    encoder_step: Array
    current_noise: Array
    coulomb_guess: Array
    position_limits: Array  # (n, 2) rad
    velocity_limits: Array
    acceleration_limits: Array
    current_step: Array | float = 0.0
    coloured: float = 0.0
    imus: tuple[AccelerometerArray, ...] = ()
    sources: tuple[TorqueSource, ...] = field(default=())

    @property
    def torque_per_ampere(self) -> Array:
        """Joint torque per motor current, (n,) N m/A."""
        return self.torque_constant * self.arm.gear


@dataclass(frozen=True)
class Truth:
    """What no instrument shows: the motion and the torques, (N, n), SI."""

    q: Array
    dq: Array
    ddq: Array
    tau: Array  # actuator torque at the joint
    friction: Array


@dataclass(frozen=True)
class Log:
    """What the robot records: t (N,) s, q (N, n) rad, current (N, n) A, arrays' readings m/s^2."""

    t: Array
    q: Array
    current: Array
    accelerometers: dict[str, Array]
    truth: Truth


def simulate(
    plant: Plant, reference: Reference, seed: int, *, every: int = 1, imus: bool = True
) -> Log:
    """Run `reference` on `plant` and record every `every`-th control period.

    Parameters
    ----------
    plant : Plant
    reference : Reference, (N, n) at the control rate; the run starts at rest on its first row
    seed : int, of all noise
    every : int, control periods per recorded row
    imus : bool, whether the accelerometer arrays are recorded
    """
    rng = np.random.default_rng(seed)
    rate = reference.rate_hz
    truth = _run(plant, reference)
    samples = len(reference.q)
    drive = plant.torque_per_ampere
    hiss = noise(rng, samples, plant.current_noise, coloured=plant.coloured, rate_hz=rate)
    kept = Truth(*(getattr(truth, x)[::every] for x in ("q", "dq", "ddq", "tau", "friction")))
    readings = {
        imu.name: imu.read(link_motion(plant.arm, imu.after, kept.q, kept.dq, kept.ddq), rng)
        for imu in (plant.imus if imus else ())
    }
    return Log(
        t=np.arange(len(kept.q), dtype=np.float64) * every / rate,
        q=quantise(kept.q, plant.encoder_step),
        current=quantise(kept.tau / drive + hiss[::every], plant.current_step),
        accelerometers=readings,
        truth=kept,
    )


def _run(plant: Plant, reference: Reference) -> Truth:
    """Integrate the motion; rows at every control instant."""
    dt = 1.0 / reference.rate_hz
    rigid, law = Rigid(plant.arm), plant.friction.begin()
    controller = Controller(plant.gains, dt)
    ahead = feedforward(Rigid(plant.nominal), reference, plant.coulomb_guess)
    wanted, reflected, step = reference.q, plant.arm.reflected, plant.encoder_step
    samples, n = wanted.shape
    out = Truth(*(np.empty((samples, n)) for _ in range(5)))
    q, half = wanted[0].copy(), np.zeros(n)
    ddq, load, sign = np.zeros(n), np.zeros(n), np.zeros(n)
    for k in range(samples):
        t = k * dt
        tau = controller.torque(quantise(q, step), wanted[k], ahead[k])
        dq = half + 0.5 * dt * ddq
        mass, bias = rigid.terms(q, dq)
        dry = law(t, q, dq, load)
        force = tau - bias - dry.smooth
        for source in plant.sources:
            force = force + source(t, q, dq)
        ddq, rub, sign = stick_slip(mass, force, half, dt, Friction(*dry), sign)
        if k == 0:
            half = -0.5 * dt * ddq  # so that it is the first row that is at rest
        friction = rub + dry.smooth
        load = tau - friction - reflected * ddq
        out.q[k], out.dq[k], out.ddq[k] = q, half + 0.5 * dt * ddq, ddq
        out.tau[k], out.friction[k] = tau, friction
        half = half + dt * ddq
        q = q + dt * half
    return out
