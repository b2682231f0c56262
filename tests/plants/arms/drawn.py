"""Arms drawn at random: other chains, sizes, drives and instruments than any rig's."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from tests.plants.arms.rigs import GRAVITY, mounting, off_nominal, standard_parameters
from tests.plants.controller import gains_for
from tests.plants.friction.surface import SurfaceFriction
from tests.plants.mechanics.rigid import Arm, Rigid
from tests.plants.simulate import Plant

Array = NDArray[np.float64]

JOINTS = (3, 4, 5, 7)
TURNS = (0.0, np.pi / 2, -np.pi / 2)  # rad, alpha of modified DH
POSTURES = 200
DRIVE_SEED = 77


@dataclass(frozen=True)
class _Loads:
    """What the arm asks of its drives, (n,): median diagonal of M, largest gravity torque."""

    inertia: Array
    gravity: Array


def drawn_arm(seed: int) -> Plant:
    """Draw an arm of three to seven joints that reaches 0.4 to 1.5 m.

    Consecutive axes are parallel or at right angles; masses fall off towards the tool; drives have
    gears from 30 to 160, friction of 5 to 15 % of what the joint carries, encoders from 14 to 19
    bits a joint turn and current noise of 0.2 to 0.8 % of that load.
    """
    rng = np.random.default_rng([DRIVE_SEED, seed])
    n = JOINTS[seed % len(JOINTS)]
    gear = rng.uniform(30.0, 160.0, n)
    bare = _chain(rng, n, gear)
    limits = rng.uniform(1.4, 2.9, n)[:, None] * np.array([-1.0, 1.0])
    loads = _loads(bare, limits)
    rotors = loads.inertia * rng.uniform(0.2, 1.2, n) / gear**2
    arm = replace(bare, rotor_inertia=rotors)
    speed = rng.uniform(1.5, 3.2, n)
    accel = rng.uniform(4.0, 9.0, n) * speed
    inertia = loads.inertia + arm.reflected
    carried = loads.gravity + 0.6 * inertia * accel
    friction = _friction(rng, carried, speed)
    drive = rng.uniform(0.05, 0.15, n)
    hiss = rng.uniform(0.002, 0.008, n) * carried / (drive * gear)
    return Plant(
        arm=arm,
        nominal=off_nominal(arm, 0.12),
        friction=friction,
        gains=gains_for(inertia, bandwidth=15.0, observer=120.0),
        torque_constant=drive,
        encoder_step=2 * np.pi / 2.0 ** rng.uniform(14.0, 19.0, n),
        current_noise=hiss,
        coulomb_guess=0.85 * friction.coulomb,
        position_limits=limits,
        velocity_limits=speed,
        acceleration_limits=accel,
        current_step=0.3 * hiss,
        coloured=float(rng.uniform(0.0, 0.2)),
    )


def _chain(rng: np.random.Generator, n: int, gear: Array) -> Arm:
    """The links alone: geometry, bodies, gravity as an upright, wall or ceiling mount has it."""
    length = rng.uniform(0.4, 1.5) / n
    alpha = rng.choice(TURNS, n, p=(0.4, 0.3, 0.3))
    alpha[min(1, n - 1)] = np.pi / 2  # not all axes upright
    dh = np.column_stack(
        [
            alpha,
            length * rng.uniform(0.0, 1.6, n) * (rng.uniform(size=n) < 0.7),
            length * rng.uniform(-0.6, 1.2, n) * (rng.uniform(size=n) < 0.7),
            np.zeros(n),
        ]
    )
    top = rng.uniform(3.0, 12.0) * length / 0.2
    masses = top * 0.65 ** np.arange(n) * rng.uniform(0.7, 1.4, n)
    bodies = [
        standard_parameters(
            mass,
            tuple(length * rng.uniform(-0.5, 0.5, 3)),
            tuple(length * rng.uniform(0.2, 0.45, 3)),
            mounting(*rng.uniform(-1.0, 1.0, 3)),
        )
        for mass in masses
    ]
    mount = rng.choice(4)
    down = np.array([[0, 0, -1.0], [0, 0, -1.0], [0, 0, 1.0], [0.0, -1.0, 0.0]])[mount]
    names = tuple(f"axis_{k + 1}" for k in range(n))
    return Arm(names, dh, np.array(bodies), GRAVITY * down, gear, np.zeros(n))


def _loads(arm: Arm, limits: Array) -> _Loads:
    rng = np.random.default_rng(0)
    rigid, inertia, gravity = Rigid(arm), [], []
    for _ in range(POSTURES):
        q = rng.uniform(*limits.T)
        inertia.append(np.diag(rigid.terms(q, np.zeros(arm.n))[0]).copy())
        gravity.append(np.abs(rigid.gravity_torque(q)))
    return _Loads(np.median(inertia, axis=0), np.max(gravity, axis=0))


def _friction(rng: np.random.Generator, carried: Array, speed: Array) -> SurfaceFriction:
    n = len(carried)
    coulomb = rng.uniform(0.05, 0.15, n) * carried
    return SurfaceFriction(
        coulomb=coulomb,
        viscous=rng.uniform(0.2, 0.8, n) * coulomb / speed,
        stribeck=rng.uniform(0.05, 0.2, n) * coulomb,
        stribeck_speed=rng.uniform(0.04, 0.1, n) * speed,
        amplitude=rng.uniform(0.02, 0.08, (n, 2)),
        phase=rng.uniform(-np.pi, np.pi, (n, 2)),
    )
