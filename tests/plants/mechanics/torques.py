"""Torques on the links that no robot file knows: springs, contacts, and laws of no name."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import pinocchio as pin

from tests import Array
from tests.plants.mechanics.hidden import Run, TorqueSource
from tests.plants.mechanics.rigid import Arm, build_model


@dataclass(frozen=True)
class State:
    """A torque of the state on one joint: law(q, dq) N m, both (n,)."""

    joint: int
    law: Callable[[Array, Array], float]

    def begin(self, run: Run) -> TorqueSource:
        """Return the source of one run."""

        def source(t: float, q: Array, dq: Array) -> Array:
            out = np.zeros_like(q)
            out[self.joint] = self.law(q, dq)
            return out

        return source


@dataclass(frozen=True)
class LinearSpring:
    """-stiffness (q - rest) on one joint; N m/rad, rad."""

    joint: int
    stiffness: float
    rest: float

    def begin(self, run: Run) -> TorqueSource:
        """Return the source of one run."""
        law = State(self.joint, lambda q, dq: -self.stiffness * (q[self.joint] - self.rest))
        return law.begin(run)


@dataclass(frozen=True)
class Counterbalance:
    """A coil spring between a point of either link, `arm` of the other's distance from the axis.

    Distances are in that of the point on the base, so that the stiffness is N m; the angle at the
    axis between the two is q - zero, `slack` the spring's length without tension.
    """

    joint: int
    stiffness: float
    arm: float
    slack: float
    zero: float

    def begin(self, run: Run) -> TorqueSource:
        """Return the source of one run."""
        return State(self.joint, lambda q, dq: self.torque(float(q[self.joint]))).begin(run)

    def torque(self, q: float) -> float:
        """Minus the slope of the energy of the stretched spring, N m."""
        angle = q - self.zero
        length = float(np.sqrt(1.0 + self.arm**2 - 2.0 * self.arm * np.cos(angle)))
        pull = self.stiffness * max(length - self.slack, 0.0)
        return -pull * self.arm * float(np.sin(angle)) / length


@dataclass(frozen=True)
class AccelerationCube:
    """-size (ddq/top)^3 on one joint, N m, ddq from the rates of the last two periods.

    Beyond `top` rad/s^2 it grows no more.
    """

    joint: int
    size: float
    top: float

    def begin(self, run: Run) -> TorqueSource:
        """Return the source of one run."""
        i, before = self.joint, np.nan

        def source(t: float, q: Array, dq: Array) -> Array:
            nonlocal before
            rate = float(dq[i])
            ddq = 0.0 if np.isnan(before) else (rate - before) / run.dt
            before = rate
            out = np.zeros_like(q)
            out[i] = -self.size * min(max(ddq / self.top, -1.0), 1.0) ** 3
            return out

        return source


@dataclass(frozen=True)
class Push:
    """A half-sine push at `begin` s since power-on for `length` s, force (3,) N, base frame."""

    begin: float
    length: float
    force: Array

    def at(self, t: float) -> Array:
        """Force at t, (3,) N."""
        phase = (t - self.begin) / self.length
        return self.force * (np.sin(np.pi * phase) if 0.0 < phase < 1.0 else 0.0)


@dataclass(frozen=True)
class Contact:
    """Somebody pushes the last link at `point` (3,) m of its frame, once or twice per log.

    The times, directions and lengths (0.2 to 0.6 s) come from the log's start and seed; `force` N.
    """

    arm: Arm
    point: Array
    force: float

    def pushes(self, run: Run) -> list[Push]:
        """Draw what happens in one log."""
        rng = np.random.default_rng([run.seed, round(1000.0 * run.start), 11])
        count = int(rng.integers(1, 3))
        out = []
        for part in range(count):
            share = (part + rng.uniform(0.15, 0.75)) / count
            way = rng.standard_normal(3)
            size = self.force * rng.uniform(0.8, 1.2) / np.linalg.norm(way)
            begin = run.start + share * run.duration
            out.append(Push(begin, float(rng.uniform(0.2, 0.6)), size * way))
        return out

    def begin(self, run: Run) -> TorqueSource:
        """Return the source of one run."""
        pushes = self.pushes(run)
        model = build_model(self.arm)
        data = model.createData()

        def source(t: float, q: Array, dq: Array) -> Array:
            for push in pushes:
                if push.begin < t < push.begin + push.length:
                    return self.torque(model, data, q, push.at(t))
            return np.zeros_like(q)

        return source

    def torque(self, model: pin.Model, data: pin.Data, q: Array, force: Array) -> Array:
        """J^T F of a force (3,) N in the base frame at the point, (n,) N m."""
        pin.computeJointJacobians(model, data, q)
        last = self.arm.n
        jac = pin.getJointJacobian(model, data, last, pin.LOCAL_WORLD_ALIGNED)
        lever = data.oMi[last].rotation @ self.point
        return np.asarray(jac[:3].T @ force + jac[3:].T @ np.cross(lever, force))
