"""Undeclared drives, transmissions and instruments, sized as in `friction`."""

from dataclasses import replace

import numpy as np

from tests import Array
from tests.plants.effects.friction import at, clear, rated_torque
from tests.plants.mechanics.hidden import Run, Spring, Stage
from tests.plants.mechanics.joints import swung
from tests.plants.mechanics.rigid import Rigid
from tests.plants.simulate import Plant


def ripple(plant: Plant, joint: int, size: float) -> Plant:
    """Order 2 of the motor (strain wave), also without current: sin(2 gear angle +
    0.7).
    """
    torque, pace = (
        at(plant, joint, clear(plant, joint, size)),
        2.0 * float(plant.arm.gear[joint]),
    )
    return plant.hiding(
        drives=lambda run: (
            lambda t, tau, angle: tau + torque * np.sin(pace * angle + 0.7)
        )
    )


def elastic(plant: Plant, joint: int, size: float) -> Plant:
    """Joint that bends by 20 mrad times size at rated torque, damping ratio 3 %; 5 to
    16 Hz.
    """
    return _spring(plant, joint, 0.020 * size, 0.03)


def backlash(plant: Plant, joint: int, size: float) -> Plant:
    """Gap of 4 mrad times size in all, between teeth that bend by 1 mrad at rated
    torque.
    """
    return _spring(plant, joint, 0.001, 0.2, 0.004 * size)


def _spring(
    plant: Plant, joint: int, bend: float, ratio: float, gap: float = 0.0
) -> Plant:
    stiffness = float(rated_torque(plant)[joint]) / bend
    inertia = swung(Rigid(plant.arm), joint, plant.position_limits.mean(axis=1))
    damping = float(2.0 * ratio * np.sqrt(stiffness * inertia))
    return plant.hiding(springs=Spring(joint, stiffness, damping, gap))


def coupling(plant: Plant, joint: int, size: float) -> Plant:
    """Drive of this joint also turns with the one before: rate = dq_j + 0.2 size
    dq_(j-1).
    """
    a = np.eye(plant.arm.n)
    a[joint, joint - 1] = 0.2 * size
    return replace(plant, hidden=replace(plant.hidden, coupling=a))


def encoder(plant: Plant, joint: int, size: float) -> Plant:
    """Eccentric disc: 5 mrad of the motor's turn times size, once per turn."""
    amplitude = at(plant, joint, 0.005 * size / (gear := float(plant.arm.gear[joint])))
    return plant.hiding(encoders=lambda angle: amplitude * np.sin(gear * angle + 0.4))


def gain(plant: Plant, joint: int, size: float) -> Plant:
    """Torque per ampere 8 % times size above the robot file's."""
    factor = 1.0 + at(plant, joint, 0.08 * size)
    return plant.hiding(drives=lambda run: lambda t, tau, angle: factor * tau)


def saturation(plant: Plant, joint: int, size: float) -> Plant:
    """8 % times size of the torque is lost at rated current, cubic in the current."""
    share, rated = at(plant, joint, 0.08 * size), rated_torque(plant)
    with np.errstate(divide="ignore"):
        top = rated / np.sqrt(3.0 * share)

    def stage(t: float, tau: Array, angle: Array) -> Array:
        most = np.clip(tau, -top, top)
        return most * (1.0 - share * (most / rated) ** 2)

    return plant.hiding(drives=lambda run: stage)


def lag(plant: Plant, joint: int, size: float) -> Plant:
    """Log holds the command; this motor's torque follows with 4 ms times size, first
    order.
    """
    time = at(plant, joint, 0.004 * size)

    def begin(run: Run) -> Stage:
        share, now = run.dt / (run.dt + time), None  # so that the mean delay is `time`

        def stage(t: float, tau: Array, angle: Array) -> Array:
            nonlocal now
            now = tau.copy() if now is None else now + share * (tau - now)
            return now

        return stage

    return plant.hiding(drives=begin)


def skew_all(plant: Plant, joint: int, size: float) -> Plant:
    """All currents are logged 4 ms times size late; the ends are held."""

    def error(t: Array, current: Array) -> Array:
        return np.column_stack([np.interp(t - 0.004 * size, t, x) for x in current.T])

    return plant.hiding(currents=error)


def averaged(plant: Plant, joint: int, size: float) -> Plant:
    """The driver logs the mean of all currents over the last 80 ms times size."""

    def error(t: Array, current: Array) -> Array:
        count = max(round(0.080 * size / float(t[1] - t[0])), 1)
        before = np.repeat(current[:1], count, axis=0)
        summed = np.cumsum(np.vstack([before, current]), axis=0)
        return (summed[count:] - summed[:-count]) / count

    return plant.hiding(currents=error)


def _amperes(plant: Plant, joint: int, size: float) -> Array:
    """A clear torque at the joint as current, (n,) A."""
    return at(
        plant, joint, clear(plant, joint, size) / float(plant.torque_per_ampere[joint])
    )


def bias(plant: Plant, joint: int, size: float) -> Plant:
    offset = _amperes(plant, joint, size)
    return plant.hiding(currents=lambda t, current: current + offset)


def drift(plant: Plant, joint: int, size: float) -> Plant:
    """Offset that grows by a clear torque in 15 minutes since power-on."""
    slope = _amperes(plant, joint, size) / 900.0
    return plant.hiding(currents=lambda t, current: current + slope * t[:, None])


def mains(plant: Plant, joint: int, size: float) -> Plant:
    """Hum of 50 Hz in the current reading, 2 % of rated times size, of one phase all
    the time.
    """
    amplitude, pace = 0.4 * _amperes(plant, joint, size), 2.0 * np.pi * 50.0
    return plant.hiding(
        currents=lambda t, current: (
            current + amplitude * np.sin(pace * t + 1.1)[:, None]
        )
    )
