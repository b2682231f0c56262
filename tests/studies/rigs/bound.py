"""Cramer-Rao bound of the one-joint rig's parameters, from its true motion and true
friction.

The current's noise e and the encoder's n enter the residual of the torque equation as e
- G n, with G ~ I d^2/dt^2 + F_v d/dt of the joint. With an arbitrary motion as nuisance
the information about the parameters is H' (S_e + G S_n G')^-1 H exactly; here it is
summed over frequencies:

    J = sum_k conj(H_k) H_k / (N s(f_k)),    s = D^2 s_e + |G|^2 s_n,

H_k the discrete Fourier transform of the columns, s spectral densities per sample, D
the torque per ampere. Rows at rest are zero: friction balances there, whatever the
parameters.
"""

from collections.abc import Sequence

import numpy as np

from tests import Array
from tests.plants.mechanics.rigid import rot_x
from tests.plants.simulate import Log, Plant
from tests.studies.rigs.repetition import surface_of

RIGID = ("mx_1", "my_1", "Izz_1")
SLIDES = 1e-3  # rad/s


def bound(
    plant: Plant, logs: Sequence[Log], name: str, *, friction: bool, motion: bool
) -> float:
    """Smallest standard error of an unbiased estimate of one of `RIGID` (kg m,
    kg m^2).
    """
    information = 0.0
    for log in logs:
        rate = 1.0 / float(log.t[1] - log.t[0])
        columns = rigid_columns(plant, log)
        if not friction:
            columns = np.hstack([columns, friction_columns(plant, log)])
        sliding = np.abs(log.truth.dq[:, :1]) > SLIDES
        density = noise_density(plant, len(log.t), rate, encoder=not motion)
        information += whittle(columns * sliding, density)
    # Scaled first: the columns' units differ by orders of magnitude.
    scale, k = 1.0 / np.sqrt(np.diag(information)), RIGID.index(name)
    covariance = np.linalg.inv(information * np.outer(scale, scale)) * np.outer(
        scale, scale
    )
    return float(np.sqrt(covariance[k, k]))


def whittle(columns: Array, density: Array) -> Array:
    """Information (p, p) of columns (N, p) in noise of density (N // 2 + 1,) per
    sample.
    """
    count = len(columns)
    spectrum, twice = np.fft.rfft(columns, axis=0), np.full(len(density), 2.0)
    twice[[0, -1] if count % 2 == 0 else 0] = 1.0
    weighted = spectrum * (twice / (count * density))[:, None]
    return np.asarray((spectrum.conj().T @ weighted).real)


def noise_density(plant: Plant, count: int, rate_hz: float, *, encoder: bool) -> Array:
    """Spectral density of the torque residual's noise, (N m)^2 per sample, joint 1."""
    frequency = np.fft.rfftfreq(count)
    density = plant.coloured * coloured_density(frequency, rate_hz) + (
        1.0 - plant.coloured
    )
    step = float(np.broadcast_to(plant.current_step, plant.current_noise.shape)[0])
    current = float(plant.current_noise[0]) ** 2 * density + step**2 / 12.0
    total = float(plant.torque_per_ampere[0]) ** 2 * current
    if not encoder:
        return np.asarray(total)
    omega = 2.0 * np.pi * frequency * rate_hz
    inertia = float(plant.arm.phi[0, 9] + plant.arm.reflected[0])
    gain = (inertia * omega**2) ** 2 + (
        float(surface_of(plant).viscous[0]) * omega
    ) ** 2
    return np.asarray(total + gain * float(plant.encoder_step[0]) ** 2 / 12.0)


def coloured_density(frequency: Array, rate_hz: float) -> Array:
    """Unit-variance 1/f part of the current's noise: first-order processes a decade
    apart.
    """
    corners = 10.0 ** np.arange(-1, np.log10(rate_hz / 8.0))
    poles = np.exp(-2.0 * np.pi * corners / rate_hz)
    turn = np.exp(-2j * np.pi * frequency)[:, None]
    return np.asarray(
        np.mean((1.0 - poles**2) / np.abs(1.0 - poles * turn) ** 2, axis=1)
    )


def rigid_columns(plant: Plant, log: Log) -> Array:
    """Torque per m r_x, m r_y and I_zz along the true motion, (N, 3)."""
    q = log.truth.q[:, 0]
    g_0 = rot_x(float(plant.arm.dh[0, 0])).T @ plant.arm.gravity
    g_x = g_0[0] * np.cos(q) + g_0[1] * np.sin(q)
    g_y = g_0[1] * np.cos(q) - g_0[0] * np.sin(q)
    return np.column_stack([-g_y, g_x, log.truth.ddq[:, 0]])


def friction_columns(plant: Plant, log: Log) -> Array:
    """Torque per coefficient of friction of the plant's own form along the true
    motion.
    """
    q, v = log.truth.q[:, 0], log.truth.dq[:, 0]
    surface = surface_of(plant)
    sign, angle = (
        np.sign(v)[:, None],
        np.outer(q, np.arange(1, surface.amplitude.shape[1] + 1)),
    )
    hump = np.exp(-((v / float(surface.stribeck_speed[0])) ** 2))[:, None]
    return np.hstack(
        [sign, sign * np.sin(angle), sign * np.cos(angle), sign * hump, v[:, None]]
    )
