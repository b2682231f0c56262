"""Rigs that the smoother is judged by: errors of its sources alone, and the bound of
its model.
"""

from dataclasses import replace
from functools import cache

import numpy as np

from seqid_cli.errors import SeqidError
from seqid_cli.imu.link_acceleration import best_motion
from seqid_cli.imu.smoother.chunk import Chunk, Jerk, encoder_view
from seqid_cli.imu.smoother.imus import mounted_imus, read
from seqid_cli.imu.smoother.smooth import Smoothed, smoothed_motion
from seqid_cli.imu.smoother.solve import interpolated, probed_variance, renewed
from seqid_cli.imu.smoother.system import linearised
from seqid_cli.motion.filters.butterworth import Lowpass
from seqid_cli.motion.filters.differentiation import differentiate
from seqid_cli.motion.motion import estimate_motion
from seqid_cli.motion.options import MotionOptions
from tests import Array
from tests.plants.fused import GYRO_NOISE, Case, Rig, case

SETTLED = slice(200, -200)
ENCODER_HZ = np.geomspace(2.0, 120.0, 30)
IMU_HZ = (10.0, 30.0, 90.0, 200.0, 400.0)
RIGS = {
    "one": Rig(1, seconds=3.0),
    "one_400": Rig(1, 2400, seconds=3.0),  # counts per joint turn behind the gear of 6
    "two": Rig(2, seconds=3.0),
    "six": Rig(6, seconds=3.0),
}

recorded = cache(case)


def scene(name: str) -> Case:
    """Three seconds of one or two joints at their limits, or of all six."""
    return recorded(RIGS[name])


@cache
def smoothed(rig: Rig, *, imus: bool = True) -> Smoothed:
    c = recorded(rig)
    return smoothed_motion(c.recording, c.robot, c.stage if imus else None)


def rms(values: Array) -> Array:
    return np.asarray(np.sqrt(np.mean(values[SETTLED] ** 2, axis=0)))


def error(rig: Rig, got: Smoothed | None = None) -> Array:
    """RMS errors (n,) of the acceleration."""
    return rms((got or smoothed(rig)).ddq - recorded(rig).truth)


def alone(rig: Rig) -> Array:
    """RMS errors (n,) of what the smoother makes of the encoders alone."""
    return error(rig, smoothed(rig, imus=False))


def variance(got: Smoothed) -> Array:
    return interpolated(np.arange(len(got.q)), got.places, got.variance)


def coverage(rig: Rig, got: Smoothed | None = None) -> Array:
    """RMS (n,) of the acceleration's errors over their standard errors."""
    got = got or smoothed(rig)
    return rms((got.ddq - recorded(rig).truth) / np.sqrt(variance(got)[:, :, 2]))


def differentiated(c: Case) -> Array:
    """Return errors (n,) of the encoders' acceleration.

    They are by the best cut-off, which only the truth tells.
    """
    rate = c.recording.rate_hz
    derivatives = [
        differentiate(Lowpass(float(hz), rate)(c.recording.q), rate)
        for hz in ENCODER_HZ
    ]
    return np.asarray(np.min([rms(ddq - c.truth) for _, ddq in derivatives], axis=0))


def from_imus(c: Case) -> Array:
    """Errors (n,) of the IMUs sample by sample, with the best of several cut-offs."""
    errors = []
    for hz in IMU_HZ:
        motion = estimate_motion(c.recording, c.robot, MotionOptions(cutoff_hz=hz))
        try:
            got = best_motion(c.recording, c.robot, c.stage, motion, source="imu")
        except SeqidError:
            continue
        errors.append(rms(got.ddq - c.truth))
    return np.asarray(np.min(errors, axis=0))


def bound(c: Case, rig: Rig) -> Array:
    """Return the Cramer-Rao bound (n,) of the acceleration for a white jerk.

    It is for an estimator that knows the jerk's size, all sensors and the motion.
    """
    views = map(encoder_view, c.recording.q.T, c.plant.encoder_step.tolist())
    imus = []
    for x, array in zip(
        mounted_imus(c.recording, c.robot, c.stage), c.plant.imus, strict=True
    ):
        noise = np.full(
            x.place.channels, np.hypot(array.noise, array.resolution / np.sqrt(12))
        )
        noise[len(x.place.positions) :] = GYRO_NOISE
        place = replace(x.place, R=array.rotation, lever=array.lever)
        taken = read(x, c.recording, slice(None))
        imus.append(replace(taken, place=place, noise=noise, delay=rig.fault.delay_s))
    dt = 1.0 / c.recording.rate_hz
    truth = c.log.truth

    chunk = Chunk(
        robot=c.robot, views=tuple(views), dt=dt, every=1, imus=tuple(imus)
    ).gathered()

    true_jerk = np.diff(truth.ddq, axis=0) / dt
    second = true_jerk.T @ true_jerk / len(true_jerk)
    size = np.sqrt(np.diag(second))
    jerk = Jerk(
        size=size,
        correlation=second / np.outer(size, size),
        relative=np.ones_like(truth.q),
    )

    # Coefficients of the true motion: the position less h^2 / 6 of the acceleration.
    q = truth.q - dt**2 * truth.ddq / 6
    coefficients = np.vstack([q[:1], q, q[-1:], q[-1:]])
    solution = renewed(
        chunk, coefficients, jerk, linearised(chunk, coefficients), "place"
    )
    _, variance_of_motion = probed_variance(solution, solution)
    return np.asarray(np.sqrt(np.mean(variance_of_motion[:, :, 2], axis=0)))
