"""One control period of an arm, rigid (leapfrog) or with springs in its joints
(substeps).
"""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from tests import Array
from tests.plants.friction.surface import Friction, Law, stick_slip
from tests.plants.mechanics.hidden import Hidden, TorqueSource
from tests.plants.mechanics.rigid import Rigid

FINEST = 0.5  # rad of the fastest vibration per substep


class Row(NamedTuple):
    """Truth at one instant: link motion, friction at the drive, angle that the log
    sees, (n,).
    """

    q: Array
    dq: Array
    ddq: Array
    friction: Array
    angle: Array


@dataclass
class _Joints:
    """An arm from rest at `start` (n,) rad, in control periods of `dt` s."""

    rigid: Rigid
    law: Law
    sources: tuple[TorqueSource, ...]
    hidden: Hidden
    start: Array
    dt: float


@dataclass
class RigidJoints(_Joints):
    """Drives and links move as one; friction may act on combinations of the joints'
    rates.
    """

    def __post_init__(self) -> None:
        self._a, self._reflected = self.hidden.coupling, self.rigid.arm.reflected
        self._back = np.linalg.inv(self._a) if self._a is not None else None
        self._q, self._first = self.start.copy(), True
        self._half, self._ddq, self._load, self._sign = np.zeros((4, len(self._q)))

    def reading_angle(self) -> Array:
        """Angle of the drives, which the controller reads now, (n,) rad."""
        return self._q

    def step(self, t: float, tau: Array) -> Row:
        """Advance by one period with the drives' torque (n,) N m; `t` is the row's
        instant.
        """
        dt, q = self.dt, self._q
        dq = self._half + 0.5 * dt * self._ddq
        mass, bias = self.rigid.terms(q, dq)
        push = tau - bias
        for source in self.sources:
            push = push + source(t, q, dq)
        ddq, friction = self._slip(t, q, dq, mass, push)
        if self._first:  # so that it is the first row that is at rest
            self._half, self._first = -0.5 * dt * ddq, False
        self._load = tau - friction - self._reflected * ddq
        row = Row(q, self._half + 0.5 * dt * ddq, ddq, friction, q)
        self._ddq, self._half = ddq, self._half + dt * ddq
        self._q = q + dt * self._half
        return row

    def _slip(
        self, t: float, q: Array, dq: Array, mass: Array, push: Array
    ) -> tuple[Array, Array]:
        """Acceleration and friction torque at the joints, (n,) each."""
        if self._a is None or self._back is None:
            dry = self.law(t, q, dq, self._load)
            force = push - dry.smooth
            ddq, rub, self._sign = stick_slip(
                mass, force, self._half, self.dt, dry, self._sign
            )
            return ddq, rub + dry.smooth
        a, back = self._a, self._back
        dry = self.law(t, a @ q, a @ dq, self._load)
        turned, force = back.T @ mass @ back, back.T @ push - dry.smooth
        rates = a @ self._half
        spin, rub, self._sign = stick_slip(
            turned, force, rates, self.dt, dry, self._sign
        )
        return back @ spin, a.T @ (rub + dry.smooth)


@dataclass
class ElasticJoints(_Joints):
    """Some drives turn apart from their links; drives' own coordinates come after the
    links'.

    One period runs from half a period before the row's instant to half a period after
    it, so that position, torque and acceleration of one row belong together, as in the
    rigid arm. The controller has read the encoders at the period's begin. Friction of a
    joint with a spring acts on its drive.
    """

    def __post_init__(self) -> None:
        start, hidden, self._reflected = (
            self.start,
            self.hidden,
            self.rigid.arm.reflected,
        )
        if hidden.coupling is not None:
            raise ValueError(
                "a plant with springs cannot have coupled transmissions as well"
            )
        self._springs = hidden.springs
        self._joints = np.array([spring.joint for spring in hidden.springs])
        self._n = n = len(start)
        # which coordinate a joint's friction and motor act on
        self._drive = np.arange(n)
        self._drive[self._joints] = n + np.arange(len(self._joints))
        stiff = [
            s.stiffness / swung(self.rigid, s.joint, start) for s in hidden.springs
        ]
        parts = int(np.ceil(np.sqrt(max(stiff)) * self.dt / FINEST))
        self._parts = max(2, parts + parts % 2)  # even
        self._x, self._load = self._at_rest(start), np.zeros(n)
        self._v, self._a, self._sign = np.zeros((3, len(self._x)))

    def _at_rest(self, start: Array) -> Array:
        """Coordinates at rest with the drives at `start` and the springs carrying
        gravity.
        """
        q, drive = start.copy(), start[self._joints]
        for _ in range(20):
            load = self.rigid.gravity_torque(q)
            wind = np.array(
                [spring.wind_at(float(load[spring.joint])) for spring in self._springs]
            )
            q[self._joints] = drive - wind
        return np.concatenate([q, drive])

    def reading_angle(self) -> Array:
        return self._x[self._drive]

    def step(self, t: float, tau: Array) -> Row:
        n, h, drive, own = self._n, self.dt / self._parts, self._drive, self._joints
        now = self._v + 0.5 * h * self._a
        mass = np.zeros((len(self._x), len(self._x)))
        mass[:n, :n], bias = self.rigid.terms(self._x[:n], now[:n])
        mass[own, own] -= self._reflected[own]
        mass[drive[own], drive[own]] = self._reflected[own]
        inverse = np.asarray(np.linalg.inv(mass))
        dry = self.law(t, self._x[drive], now[drive], self._load)
        slow = np.zeros_like(self._x)
        slow[drive] = tau - dry.smooth
        slow[:n] -= bias
        for source in self.sources:
            slow[:n] += source(t, self._x[:n], now[:n])
        levels = Friction(*(np.zeros_like(self._x) for _ in range(3)))
        levels.forward[drive], levels.backward[drive] = dry.forward, dry.backward
        for part in range(self._parts):
            rub = self._substep(h, mass, inverse, slow, levels)
            if part == self._parts // 2:
                row = self._row(h, rub[drive] + dry.smooth)
            self._v = self._v + h * self._a
            self._x = self._x + h * self._v
        self._load = tau - row.friction - self._reflected * self._a[drive]
        return row

    def _substep(
        self, h: float, mass: Array, inverse: Array, slow: Array, levels: Friction
    ) -> Array:
        """Update the acceleration; return the dry friction of every coordinate."""
        force, x, v, a = slow.copy(), self._x, self._v, self._a
        for k, spring in enumerate(self._springs, start=self._n):
            i = spring.joint
            rate = v[k] - v[i] + 0.5 * h * (a[k] - a[i])
            torque = spring.torque(float(x[k] - x[i]), float(rate))
            force[i] += torque
            force[k] -= torque
        sign, drive = self._sign, self._drive
        rub = np.where(sign > 0, levels.forward, -levels.backward)
        guess = inverse @ (force - rub)
        if not sign[drive].all() or ((v + h * guess) * sign)[drive].min() < 0:
            guess, rub, self._sign = stick_slip(mass, force, v, h, levels, sign)
        self._a = guess
        return rub

    def _row(self, h: float, friction: Array) -> Row:
        rate = self._v + 0.5 * h * self._a
        links = (x[: self._n].copy() for x in (self._x, rate, self._a))
        return Row(*links, friction, self._x[self._drive])


def swung(rigid: Rigid, joint: int, q: Array) -> float:
    """Inertia of drive and link against each other with the other joints free,
    kg m^2.
    """
    reflected, mass = rigid.arm.reflected, rigid.terms(q, np.zeros_like(q))[0].copy()
    mass[joint, joint] -= reflected[joint]
    return float(1.0 / (np.linalg.inv(mass)[joint, joint] + 1.0 / reflected[joint]))
