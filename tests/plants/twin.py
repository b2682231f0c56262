"""A second simulator of the same arms: other equations, other integrator, other controller; fast.

Rigid bodies by a recursion of Newton and Euler in modified DH frames (`rigid.py` asks Pinocchio).
Each control period is cut into substeps of an explicit midpoint rule whose velocities solve the
inclusion of Coulomb friction exactly,

    M (v' - v) = dt (tau - h(q, v) - viscous v - f),    f_i in level_i Sgn(v'_i),

by Gauss-Seidel over the joints (Moreau's time stepping; `friction.stick_slip` switches states).
The torque is held over a period. Row k tells the instant t_k: the current is the mean of the torque
over the two halves of periods around it, and so are the true acceleration and friction.
"""

from __future__ import annotations

from typing import Any

import numba
import numpy as np
from numpy.typing import NDArray

from tests.plants.friction.surface import SurfaceFriction
from tests.plants.mechanics.rigid import Arm, link_motion
from tests.plants.motions.trajectories import Reference
from tests.plants.sensors import noise, quantise
from tests.plants.simulate import Log, Plant, Truth

Array = NDArray[np.float64]

SUBSTEPS = 2  # of a control period
SWEEPS = 60  # of Gauss-Seidel at most
_compiled: Any = numba.njit(cache=True)


def simulate(
    plant: Plant,
    reference: Reference,
    seed: int,
    *,
    every: int = 1,
    imus: bool = True,
    noisy: bool = True,
) -> Log:
    """Run `reference` on `plant`; arguments and result as those of `simulate.simulate`.

    Without `noisy` neither the current nor the encoder has errors (the controller's encoder has).

    Raises
    ------
    TypeError
        If the plant's friction is not a `SurfaceFriction`.
    """
    friction = plant.friction
    if not isinstance(friction, SurfaceFriction):
        raise TypeError(f"friction is a {type(friction).__name__}, not a SurfaceFriction")
    rng = np.random.default_rng(seed)
    rate = reference.rate_hz
    q, dq, ddq, tau, dry = _run(
        *_body(plant.arm),
        *_body(plant.nominal),
        friction.coulomb,
        friction.viscous,
        friction.stribeck,
        friction.stribeck_speed,
        friction.amplitude,
        friction.phase,
        plant.gains.stiffness,
        plant.gains.damping,
        plant.gains.observer,
        plant.coulomb_guess,
        plant.encoder_step,
        np.ascontiguousarray(reference.q),
        np.ascontiguousarray(reference.dq),
        np.ascontiguousarray(reference.ddq),
        1.0 / rate,
    )
    kept = Truth(*(x[::every] for x in (q, dq, ddq, tau, dry, q, tau)))
    hiss = noise(rng, len(q), plant.current_noise, coloured=plant.coloured, rate_hz=rate)[::every]
    current = kept.tau / plant.torque_per_ampere
    readings = {
        imu.name: imu.read(link_motion(plant.arm, imu.after, kept.q, kept.dq, kept.ddq), rng)
        for imu in (plant.imus if imus else ())
    }
    return Log(
        t=np.arange(len(kept.q), dtype=np.float64) * every / rate,
        q=quantise(kept.q, plant.encoder_step) if noisy else kept.q,
        current=quantise(current + hiss, plant.current_step) if noisy else current,
        accelerometers=readings,
        truth=kept,
    )


def inverse(arm: Arm, q: Array, dq: Array, ddq: Array) -> Array:
    """Torque (n,) N m of a motion without friction, rotors included."""
    n = arm.n
    tau = np.zeros(n)
    turns = np.zeros((n, 3, 3))
    dh, phi, gravity, reflected, spin = _body(arm)
    _turns(dh, q, turns)
    _newton_euler(dh, phi, gravity, reflected, spin, turns, dq, ddq, tau, np.zeros((n, 15)))
    return tau


def _body(arm: Arm) -> tuple[Array, Array, Array, Array, Array]:
    """Arrays of an arm; the last one is the spin (n,) by which rotors act on their carriers."""
    spin = arm.gear * arm.rotor_inertia * float(arm.rotor_coupling)
    return arm.dh, arm.phi, arm.gravity, arm.reflected, spin


@_compiled
def _turns(dh, q, out):  # type: ignore[no-untyped-def]
    """Rotation (n, 3, 3) of each link frame in the one before it."""
    for i in range(len(q)):
        ca, sa = np.cos(dh[i, 0]), np.sin(dh[i, 0])
        c, s = np.cos(q[i] + dh[i, 3]), np.sin(q[i] + dh[i, 3])
        out[i, 0, 0], out[i, 0, 1], out[i, 0, 2] = c, -s, 0.0
        out[i, 1, 0], out[i, 1, 1], out[i, 1, 2] = ca * s, ca * c, -sa
        out[i, 2, 0], out[i, 2, 1], out[i, 2, 2] = sa * s, sa * c, ca


@_compiled
def _cross(a, b):  # type: ignore[no-untyped-def]
    return (a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0])


@_compiled
def _back(R, v):  # type: ignore[no-untyped-def]
    return (
        R[0, 0] * v[0] + R[1, 0] * v[1] + R[2, 0] * v[2],
        R[0, 1] * v[0] + R[1, 1] * v[1] + R[2, 1] * v[2],
        R[0, 2] * v[0] + R[1, 2] * v[1] + R[2, 2] * v[2],
    )


@_compiled
def _out(R, v):  # type: ignore[no-untyped-def]
    return (
        R[0, 0] * v[0] + R[0, 1] * v[1] + R[0, 2] * v[2],
        R[1, 0] * v[0] + R[1, 1] * v[1] + R[1, 2] * v[2],
        R[2, 0] * v[0] + R[2, 1] * v[1] + R[2, 2] * v[2],
    )


@_compiled
def _sum(a, b):  # type: ignore[no-untyped-def]
    return (a[0] + b[0], a[1] + b[1], a[2] + b[2])


@_compiled
def _origin(row):  # type: ignore[no-untyped-def]
    return (row[1], -np.sin(row[0]) * row[2], np.cos(row[0]) * row[2])


@_compiled
def _newton_euler(  # type: ignore[no-untyped-def]
    dh, phi, gravity, reflected, spin, turns, dq, ddq, tau, work
):
    """Torque (n,) of a motion into `tau`; `work` (n, 15) holds force, moment, rates per link."""
    n = len(dq)
    w = (0.0, 0.0, 0.0)
    dw = (0.0, 0.0, 0.0)
    acc = (-gravity[0], -gravity[1], -gravity[2])
    for i in range(n):
        R, p = turns[i], _origin(dh[i])
        axis = (R[0, 2], R[1, 2], R[2, 2])
        tau[i] = reflected[i] * ddq[i]
        if i > 0 and spin[i] != 0.0:  # the rotor's spin turns with the link that carries it
            tau[i] += spin[i] * (axis[0] * dw[0] + axis[1] * dw[1] + axis[2] * dw[2])
            gyro = _cross(w, axis)
            for k in range(3):
                work[i - 1, 3 + k] += spin[i] * (ddq[i] * axis[k] + dq[i] * gyro[k])
        acc = _back(R, _sum(acc, _sum(_cross(dw, p), _cross(w, _cross(w, p)))))
        w = _back(R, w)
        dw = _back(R, dw)
        rate = (0.0, 0.0, dq[i])
        dw = _sum(_sum(dw, _cross(w, rate)), (0.0, 0.0, ddq[i]))
        w = _sum(w, rate)
        m = phi[i]
        c = (m[1], m[2], m[3])
        force = _sum(_cross(dw, c), _cross(w, _cross(w, c)))
        Iw = (
            m[4] * w[0] + m[5] * w[1] + m[7] * w[2],
            m[5] * w[0] + m[6] * w[1] + m[8] * w[2],
            m[7] * w[0] + m[8] * w[1] + m[9] * w[2],
        )
        Idw = (
            m[4] * dw[0] + m[5] * dw[1] + m[7] * dw[2],
            m[5] * dw[0] + m[6] * dw[1] + m[8] * dw[2],
            m[7] * dw[0] + m[8] * dw[1] + m[9] * dw[2],
        )
        moment = _sum(_sum(Idw, _cross(w, Iw)), _cross(c, acc))
        for k in range(3):
            work[i, k] = force[k] + m[0] * acc[k]
            work[i, 3 + k] = moment[k]
    for i in range(n - 1, -1, -1):
        tau[i] += work[i, 5]
        if i > 0:
            R, p = turns[i], _origin(dh[i])
            force = _out(R, (work[i, 0], work[i, 1], work[i, 2]))
            moment = _sum(_out(R, (work[i, 3], work[i, 4], work[i, 5])), _cross(p, force))
            for k in range(3):
                work[i - 1, k] += force[k]
                work[i - 1, 3 + k] += moment[k]


@_compiled
def _terms(  # type: ignore[no-untyped-def]
    dh, phi, gravity, reflected, spin, q, dq, turns, work, mass, bias, unit, column
):
    """Mass matrix (n, n) and bias torque (n,) of M ddq + h = tau."""
    n = len(q)
    none = np.zeros(n)
    still = np.zeros(3)
    _turns(dh, q, turns)
    _newton_euler(dh, phi, gravity, reflected, spin, turns, dq, none, bias, work)
    for j in range(n):
        unit[:] = 0.0
        unit[j] = 1.0
        _newton_euler(dh, phi, still, reflected, spin, turns, none, unit, column, work)
        mass[:, j] = column


@_compiled
def _level(coulomb, stribeck, speed, amplitude, phase, q, v, out):  # type: ignore[no-untyped-def]
    """Dry friction's level (n,) N m."""
    for i in range(len(q)):
        wave = 1.0
        for k in range(amplitude.shape[1]):
            wave += amplitude[i, k] * np.sin((k + 1) * q[i] + phase[i, k])
        out[i] = coulomb[i] * wave + stribeck[i] * np.exp(-((v[i] / speed[i]) ** 2))


@_compiled
def _slip(mass, push, level, v, dt, after, dry):  # type: ignore[no-untyped-def]
    """Velocity (n,) after `dt` under `push` (n,) and dry friction, which goes to `dry`."""
    n = len(v)
    after[:] = v
    for _ in range(SWEEPS):
        change = 0.0
        for i in range(n):
            right = dt * push[i]
            for j in range(n):
                right += mass[i, j] * v[j]
                if j != i:
                    right -= mass[i, j] * after[j]
            most = dt * level[i]
            taken = min(max(right, -most), most)
            new = (right - taken) / mass[i, i]
            dry[i] = taken / dt
            change = max(change, abs(new - after[i]))
            after[i] = new
        if change < 1e-13:
            break


@_compiled
def _run(  # type: ignore[no-untyped-def]
    dh,
    phi,
    gravity,
    reflected,
    spin,
    own_dh,
    own_phi,
    own_gravity,
    own_reflected,
    own_spin,
    coulomb,
    viscous,
    stribeck,
    stribeck_speed,
    amplitude,
    phase,
    stiffness,
    damping,
    observer,
    guess,
    step,
    wanted,
    wanted_v,
    wanted_a,
    dt,
):
    """Closed loop: PD on the encoder and its filtered rate, nominal inverse dynamics ahead."""
    count, n = wanted.shape
    q, v = wanted[0].copy(), np.zeros(n)
    Q, V = np.zeros((count, n)), np.zeros((count, n))
    A, T, F = np.zeros((count, n)), np.zeros((count, n)), np.zeros((count, n))
    turns, work = np.zeros((n, 3, 3)), np.zeros((n, 15))
    mass, bias = np.zeros((n, n)), np.zeros(n)
    unit, column, level = np.zeros(n), np.zeros(n), np.zeros(n)
    after, dry, push, middle = np.zeros(n), np.zeros(n), np.zeros(n), np.zeros(n)
    ahead, last, tau, rate = np.zeros(n), np.zeros(n), np.zeros(n), np.zeros(n)
    friction, before_a, before_f = np.zeros(n), np.zeros(n), np.zeros(n)
    for i in range(n):
        last[i] = np.round(q[i] / step[i]) * step[i]
    for k in range(count):
        _turns(own_dh, wanted[k], turns)
        _newton_euler(
            own_dh, own_phi, own_gravity, own_reflected, own_spin,
            turns, wanted_v[k], wanted_a[k], ahead, work,
        )  # fmt: skip
        Q[k], V[k] = q, v
        for i in range(n):
            seen = np.round(q[i] / step[i]) * step[i]
            share = 1.0 - np.exp(-observer[i] * dt)
            rate[i] += share * ((seen - last[i]) / dt - rate[i])
            last[i] = seen
            old = tau[i]
            tau[i] = ahead[i] + guess[i] * np.sign(wanted_v[k, i])
            tau[i] += stiffness[i] * (wanted[k, i] - seen) + damping[i] * (wanted_v[k, i] - rate[i])
            T[k, i] = 0.5 * ((old if k > 0 else tau[i]) + tau[i])
        friction[:] = 0.0
        h = dt / SUBSTEPS
        start = v.copy()
        for _ in range(SUBSTEPS):
            # half a step to the middle, whose forces make the whole step
            _terms(
                dh, phi, gravity, reflected, spin,
                q, v, turns, work, mass, bias, unit, column,
            )  # fmt: skip
            _level(coulomb, stribeck, stribeck_speed, amplitude, phase, q, v, level)
            push[:] = tau - bias - viscous * v
            _slip(mass, push, level, v, 0.5 * h, after, dry)
            middle[:] = q + 0.25 * h * (v + after)
            _terms(
                dh, phi, gravity, reflected, spin,
                middle, after, turns, work, mass, bias, unit, column,
            )  # fmt: skip
            _level(coulomb, stribeck, stribeck_speed, amplitude, phase, middle, after, level)
            push[:] = tau - bias - viscous * after
            friction += viscous * after / SUBSTEPS
            _slip(mass, push, level, v, h, after, dry)
            friction += dry / SUBSTEPS
            q = q + 0.5 * h * (v + after)
            v = after.copy()
        gained = (v - start) / dt
        A[k] = 0.5 * ((before_a if k > 0 else gained) + gained)
        F[k] = 0.5 * ((before_f if k > 0 else friction) + friction)
        before_a[:], before_f[:] = gained, friction
    return Q, V, A, T, F
