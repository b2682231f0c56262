"""Closed-loop forward dynamics: controller, actuator, arm and instruments, one step per
period.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Any, NamedTuple

import numpy as np

from tests import Array
from tests.plants.controller import Controller, Gains, feedforward
from tests.plants.friction.laws import Heat
from tests.plants.friction.surface import FrictionModel
from tests.plants.mechanics.hidden import Hidden, Run
from tests.plants.mechanics.joints import ElasticJoints, RigidJoints
from tests.plants.mechanics.rigid import Arm, Rigid, link_motion
from tests.plants.motions.trajectories import Reference
from tests.plants.sensors import AccelerometerArray, noise, quantise


@dataclass(frozen=True)
class Plant:
    """A robot with everything that its logs depend on; arrays are (n,)."""

    arm: Arm
    nominal: Arm  # what the controller believes, as `coulomb_guess`
    friction: FrictionModel
    gains: Gains
    torque_constant: Array
    encoder_step: Array
    current_noise: Array  # A, standard deviation at the control rate
    coulomb_guess: Array
    position_limits: Array  # (n, 2) rad
    velocity_limits: Array
    acceleration_limits: Array
    current_step: Array | float = 0.0
    coloured: float = 0.0  # share of the noise's variance that is 1/f
    imus: tuple[AccelerometerArray, ...] = ()
    hidden: Hidden = field(default_factory=Hidden)
    heat: Heat | None = None  # then the logs carry temperatures

    @property
    def torque_per_ampere(self) -> Array:
        """Joint torque per motor current, (n,) N m/A."""
        return self.torque_constant * self.arm.gear

    def hiding(self, **parts: Any) -> Plant:
        """The same with one part more of each kind of `Hidden`."""
        more = {
            kind: (*getattr(self.hidden, kind), part) for kind, part in parts.items()
        }
        return replace(self, hidden=replace(self.hidden, **more))


class Truth(NamedTuple):
    """What no instrument shows: the motion of the links and the torques, (N, n), SI."""

    q: Array
    dq: Array
    ddq: Array
    tau: Array  # actuator torque at the joint
    friction: Array
    angle: Array  # at the encoders that the log reads, before their errors
    commanded: Array  # torque that the currents stand for


@dataclass(frozen=True)
class Log:
    """What the robot records: t (N,) s from 0, q (N, n) rad, current (N, n) A, arrays
    m/s^2.
    """

    t: Array
    q: Array
    current: Array
    accelerometers: dict[str, Array]
    truth: Truth
    start: float = 0.0  # of the first row since power-on, s
    temperature: Array | None = None  # (N, n) degC


def simulate(
    plant: Plant,
    reference: Reference,
    seed: int,
    *,
    every: int = 1,
    imus: bool = True,
    start: float = 0.0,
) -> Log:
    """Run `reference` on `plant` and record every `every`-th control period."""
    rng = np.random.default_rng(seed)
    rate, samples = reference.rate_hz, len(reference.q)
    run = Run(start, reference.duration, 1.0 / rate, seed)
    truth = _run(plant, reference, run)
    hiss = noise(
        rng, samples, plant.current_noise, coloured=plant.coloured, rate_hz=rate
    )
    kept = Truth(*(x[::every] for x in truth))
    readings = {
        imu.name: imu.read(
            link_motion(plant.arm, imu.after, kept.q, kept.dq, kept.ddq), rng
        )
        for imu in (plant.imus if imus else ())
    }
    current = _current(plant, truth, run)[::every]
    return Log(
        t=np.arange(len(kept.q), dtype=np.float64) * every / rate,
        q=quantise(_seen(plant, kept.angle), plant.encoder_step),
        current=quantise(current + hiss[::every], plant.current_step),
        accelerometers=readings,
        truth=kept,
        start=start,
        temperature=_temperature(plant, truth, run, every),
    )


def _seen(plant: Plant, angle: Array) -> Array:
    for error in plant.hidden.encoders:
        angle = angle + error(angle)
    return angle


def _current(plant: Plant, truth: Truth, run: Run) -> Array:
    """Current that the drives report, before noise, (N, n) A."""
    current = truth.commanded / plant.torque_per_ampere
    t = np.asarray(run.start + run.dt * np.arange(len(current)), dtype=np.float64)
    for error in plant.hidden.currents:
        current = error(t, current)
    return current


def _temperature(plant: Plant, truth: Truth, run: Run, every: int) -> Array | None:
    """Read the gears' temperatures, 0.1 K a step, (N, n) degC."""
    if plant.heat is None:
        return None
    power = np.abs(truth.friction * truth.dq)
    degrees = plant.heat.trace(run.start, power, run.dt)[::every]
    rng = np.random.default_rng([run.seed, 7])
    return quantise(degrees + 0.05 * rng.standard_normal(degrees.shape), 0.1)


def _run(plant: Plant, reference: Reference, run: Run) -> Truth:
    """Integrate the motion; rows at every control instant.

    Positions live at the control instants t_k and velocities half a period later
    (leapfrog, second order, no energy drift). The torque commanded at t_k acts from
    half a period before to half a period after, so position, current and acceleration
    of one row belong to the same instant.
    """
    dt, hidden = run.dt, plant.hidden
    controller, wanted = Controller(plant.gains, dt), reference.q
    ahead = feedforward(Rigid(plant.nominal), reference, plant.coulomb_guess)
    stages = [begin(run) for begin in hidden.drives]
    sources = tuple(begin(run) for begin in hidden.torques)
    kind = ElasticJoints if hidden.springs else RigidJoints
    body = kind(
        Rigid(plant.arm), plant.friction.begin(), sources, hidden, wanted[0], dt
    )
    out = Truth(*(np.empty(wanted.shape) for _ in Truth._fields))
    for k in range(len(wanted)):
        t = run.start + k * dt
        angle = body.reading_angle()
        seen = quantise(_seen(plant, angle), plant.encoder_step)
        out.commanded[k] = tau = controller.torque(seen, wanted[k], ahead[k])
        for stage in stages:
            tau = stage(t, tau, angle)
        out.q[k], out.dq[k], out.ddq[k], out.friction[k], out.angle[k] = body.step(
            t, tau
        )
        out.tau[k] = tau
    return out
