"""One joint that hunts: a PID controller on a coarse encoder, dry friction that sticks
exactly.
"""

from dataclasses import dataclass

import numpy as np

from tests import Array


@dataclass(frozen=True, kw_only=True)
class HuntingJoint:
    """A joint about a horizontal axis, SI units."""

    counts: int  # of the encoder, per turn of the joint
    inertia: float = 0.5
    coulomb: float = 6.0
    viscous: float = 5.0
    weight: float = 8.0  # torque of gravity where it is level
    bandwidth: float = 30.0  # rad/s, of the controller
    integral: float = 3.0  # 1/s
    smoothing: float = 100.0  # rad/s, of the velocity that the controller feels
    noise: float = 0.15  # N m, of the torque as it is logged
    rate_hz: float = 1000.0

    @property
    def step(self) -> float:
        """Angle of one count, rad."""
        return 2.0 * np.pi / self.counts

    def friction(self, speed: float) -> float:
        """Friction at a constant speed, N m."""
        return self.coulomb + self.viscous * speed


@dataclass(frozen=True)
class HuntingLog:
    """What is logged, and what no instrument shows: the angle and the velocity."""

    t: Array
    q: Array
    tau: Array
    angle: Array
    velocity: Array


def back_and_forth(
    speeds: Array, *, way: float, rest_s: float, rate_hz: float
) -> Array:
    """Angles (N,) rad of moves over `way` rad, there and back at each speed."""
    parts = [np.full(round(rest_s * rate_hz), -way / 2.0)]
    for speed in speeds:
        count = round(way / speed * rate_hz)
        there = -way / 2.0 + way * np.arange(1, count + 1) / count
        for move in (there, there[::-1]):
            parts += [move, np.full(round(rest_s * rate_hz), move[-1])]
    return np.concatenate(parts)


def run(
    joint: HuntingJoint, speeds: Array, *, seed: int, every: int, way: float = 2.0
) -> HuntingLog:
    """Move the joint there and back at each speed;
    log every so many control periods.
    """
    dt = 1.0 / joint.rate_hz
    wanted = back_and_forth(speeds, way=way, rest_s=0.5, rate_hz=joint.rate_hz)
    rates = np.gradient(wanted, dt)
    stiffness, damping = (
        joint.inertia * joint.bandwidth**2,
        2.0 * joint.inertia * joint.bandwidth,
    )
    share = joint.smoothing * dt / (1.0 + joint.smoothing * dt)

    angle, velocity, felt = float(wanted[0]), 0.0, 0.0
    sum_torque = joint.weight * np.sin(angle)
    before = np.round(angle / joint.step) * joint.step
    rows = np.empty((len(wanted), 4))
    for k in range(len(wanted)):
        seen = np.round(angle / joint.step) * joint.step
        felt += share * ((seen - before) / dt - felt)
        before = seen
        error = wanted[k] - seen
        sum_torque += joint.integral * stiffness * error * dt
        tau = stiffness * error + damping * (rates[k] - felt) + sum_torque
        rows[k] = seen, tau, angle, velocity

        force = tau - joint.weight * np.sin(angle)
        if velocity == 0.0:  # it sticks up to the dry level
            over = max(abs(force) - joint.coulomb, 0.0)
            push = np.sign(force) * over / joint.inertia
        else:
            rub = np.sign(velocity) * joint.coulomb + joint.viscous * velocity
            push = (force - rub) / joint.inertia
            if (velocity + push * dt) * velocity < 0.0:
                push = -velocity / dt
        velocity += push * dt
        velocity = 0.0 if abs(velocity) < 1e-12 else velocity
        angle += velocity * dt

    kept = rows[::every]
    hiss = joint.noise * np.random.default_rng(seed).standard_normal(len(kept))
    t = np.arange(len(kept)) * every * dt
    return HuntingLog(t, kept[:, 0], kept[:, 1] + hiss, kept[:, 2], kept[:, 3])
