"""Joint motion by the smoother against its sources, the paper's equations and the bound."""

from __future__ import annotations

import sys
from argparse import Namespace
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from seqid_cli.errors import SeqidError
from seqid_cli.motion.filters.butterworth import Lowpass
from seqid_cli.motion.filters.differentiation import differentiate
from seqid_cli.motion.imu.array import read_angular, speed_about
from seqid_cli.motion.imu.link_acceleration import best_motion
from seqid_cli.motion.motion import estimate_motion
from seqid_cli.motion.options import MotionOptions
from seqid_cli.motion.smoother.chunk import Chunk
from seqid_cli.motion.smoother.encoder import encoder_view
from seqid_cli.motion.smoother.imus import mounted_imus, read
from seqid_cli.motion.smoother.smooth import Smoothed, smoothed_motion
from seqid_cli.motion.smoother.solve import probed_covariance, solved
from seqid_cli.motion.smoother.system import linearised, normal_equations
from seqid_cli.motion.smoother.terms import Jerk
from seqid_cli.robot.kinematics import forward
from tests.studies.imu.fused_cases import GYRO_NOISE, Case, Fault, Rig, case
from tests.studies.tables import number, table
from tests.unit.motion.imu.two_joints import (
    joint_acceleration,
    joint_speed,
    second_joint_acceleration,
    second_joint_velocity,
)

Array = NDArray[np.float64]

SETTLED = slice(200, -200)
ENCODER_HZ = np.geomspace(2.0, 120.0, 30)
IMU_HZ = (10.0, 30.0, 90.0, 200.0, 400.0)
LINES_100, LINES_400 = 600, 2400  # counts per joint turn behind the gear of 6
EVERYTHING = Fault(bias=0.2, drift=0.05, gain=0.01, tilt_deg=0.5, delay_s=0.0203)


@dataclass(frozen=True)
class Row:
    """RMS errors (n,) of one rig: acceleration [rad/s^2], and velocity [rad/s] where compared."""

    label: str
    encoder: Array
    imu: Array | None
    paper: Array | None
    fused: Array
    stated: Array  # standard error that the smoother gives
    bound: Array
    encoder_speed: Array
    paper_speed: Array | None
    fused_speed: Array
    left_out: tuple[str, ...]


def rms(values: Array) -> Array:
    """RMS (n,) away from the ends."""
    return np.asarray(np.sqrt(np.mean(values[SETTLED] ** 2, axis=0)))


def differentiated(c: Case) -> tuple[Array, Array]:
    """Errors (n,) of velocity and acceleration of encoders, each with the cut-off of least error.

    Only who knows the truth can choose so.
    """
    rate = c.recording.rate_hz
    found = [differentiate(Lowpass(float(hz), rate)(c.recording.q), rate) for hz in ENCODER_HZ]
    speed = np.min([rms(dq - c.log.truth.dq) for dq, _ in found], axis=0)
    return np.asarray(speed), np.asarray(np.min([rms(ddq - c.truth) for _, ddq in found], axis=0))


def from_imus(c: Case) -> Array | None:
    """Errors (n,) of the IMUs sample by sample, with the best of several cut-offs."""
    errors = []
    for hz in IMU_HZ:
        motion = estimate_motion(c.recording, c.robot, MotionOptions(cutoff_hz=hz))
        try:
            got = best_motion(c.recording, c.robot, c.stage, motion, source="imu")
        except SeqidError:
            continue
        errors.append(rms(got.ddq - c.truth))
    return np.asarray(np.min(errors, axis=0)) if errors else None


def by_the_paper(c: Case) -> tuple[Array, Array] | None:
    """Errors (n,) of velocity (Eq. 31, 41) and acceleration (Eq. 30, 42), best of the cut-offs."""
    if c.robot.n > 2 or c.recording.gyros:
        return None
    found = [_paper(c, hz) for hz in IMU_HZ]
    speed = np.min([rms(dq - c.log.truth.dq) for dq, _ in found], axis=0)
    return np.asarray(speed), np.asarray(np.min([rms(a - c.truth) for _, a in found], axis=0))


def _paper(c: Case, hz: float) -> tuple[Array, Array]:
    """Velocity and acceleration (N, n), as Sec. 3 has them, signs by the encoder."""
    recording, chain = c.recording, c.robot.chain
    lowpass = Lowpass(hz, recording.rate_hz)
    rough = differentiate(Lowpass(20.0, recording.rate_hz)(recording.q), recording.rate_hz)[0]
    w: list[Array] = []
    dw: list[Array] = []
    for imu in c.robot.imus:
        values = recording.accelerometers[imu.name]
        reading = read_angular(imu, values, None, lowpass, recording.valid)
        R = np.array(c.stage.imus[imu.name].rotation)
        dw.append(reading.dw @ R.T)
        # Both joints turn about z: so do the links.
        axis = R.T @ np.array([0.0, 0.0, 1.0])
        sign = np.sign(rough[:, : imu.after_joint + 1].sum(axis=1))
        speed = speed_about(reading.products, axis) * sign
        w.append(speed[:, None] * np.array([0.0, 0.0, 1.0]))
    first = joint_acceleration(dw[0], chain.axis[0], 1.0)
    if c.robot.n == 1:
        about = R.T @ chain.axis[0]
        speed = joint_speed(reading.products, about, 1.0) * np.sign(rough[:, 0])
        return speed[:, None], first[:, None]
    R_before = forward(chain, recording.q).R
    R_lm = R_before[:, 1].transpose(0, 2, 1) @ R_before[:, 0]
    velocity = second_joint_velocity(R_lm, w[0], w[1], chain.axis[1])
    second = second_joint_acceleration(R_lm, w[0], dw[0], dw[1], velocity, chain.axis[1])
    return np.column_stack([w[0][:, 2], velocity]), np.column_stack([first, second])


def bound(c: Case, rig: Rig) -> Array:
    """Cramer-Rao bound (n,) of the acceleration, for a white jerk of the true size.

    It knows the sensors' noise and faults, where they sit, and the motion.
    """
    views = [
        encoder_view(c.recording.q[:, j], float(c.plant.encoder_step[j])) for j in range(c.robot.n)
    ]
    imus = []
    for x, array in zip(mounted_imus(c.recording, c.robot, c.stage), c.plant.imus, strict=True):
        noise = np.full(x.place.channels, np.hypot(array.noise, array.resolution / np.sqrt(12)))
        noise[len(x.place.positions) :] = GYRO_NOISE
        place = replace(x.place, R=array.rotation, lever=array.lever)
        taken = read(x, c.recording, slice(None))
        imus.append(replace(taken, place=place, noise=noise, delay=rig.fault.delay_s))
    dt, truth = 1.0 / c.recording.rate_hz, c.log.truth
    chunk = Chunk(c.robot, tuple(views), dt, 1, tuple(imus)).gathered()
    found = np.diff(truth.ddq, axis=0) / dt
    second = found.T @ found / len(found)
    size = np.sqrt(np.diag(second))
    jerk = Jerk(size, second / np.outer(size, size), np.ones_like(truth.q))
    q = truth.q - dt**2 * truth.ddq / 6
    coefficients = np.vstack([q[:1], q, q[-1:], q[-1:]])
    normal = normal_equations(
        chunk, coefficients, jerk, linearised(chunk, coefficients), constants="place"
    )
    solution = replace(solved(chunk, coefficients, jerk, normal), constants="place")
    covariance = probed_covariance(solution, solution)[1]
    return np.asarray(np.sqrt(np.mean(covariance[:, :, 2, 2], axis=0)))


def measured(label: str, rig: Rig) -> Row:
    """One row."""
    c = case(rig)
    got: Smoothed = smoothed_motion(c.recording, c.robot, c.stage)
    speed, acceleration = differentiated(c)
    paper = by_the_paper(c)
    return Row(
        label,
        acceleration,
        from_imus(c),
        paper[1] if paper else None,
        rms(got.ddq - c.truth),
        rms(np.sqrt(got.covariance[:, :, 2, 2])),
        bound(c, rig),
        speed,
        paper[0] if paper else None,
        rms(got.dq - c.log.truth.dq),
        tuple(sorted({imu.name for imu in c.robot.imus} - set(got.mounted))),
    )


def rigs(*, quick: bool) -> list[tuple[str, Rig]]:
    """The rows of the table."""
    found = [("1 joint, 100 lines", Rig(1, LINES_100)), ("1 joint, 400", Rig(1, LINES_400))]
    if quick:
        return [(name, replace(rig, seconds=2.0)) for name, rig in found]
    for joints in (1, 2):
        name = f"{joints} joint{'s' if joints > 1 else ''}"
        counts = {"100 lines": LINES_100, "400": LINES_400, "4096 a turn": 4096, "17 bits": 2**17}
        found += [
            (f"{name}, {lines}", Rig(joints, count))
            for lines, count in counts.items()
            if (f"{name}, {lines}", Rig(joints, count)) not in found
        ]
        found.append((f"{name}, 400, gyro IMUs", Rig(joints, LINES_400, gyro=True)))
        found.append((f"{name}, 400, rests", Rig(joints, LINES_400, pauses=True)))
    for layout, name in (("end", "one array"), ("two", "two arrays"), ("each", "one a link")):
        found += [(f"6 joints, 17 bits, {name}", Rig(6, 2**17, layout=layout))]
        found += [(f"6 joints, 4096, {name}", Rig(6, 4096, layout=layout))]
    found.append(("6 joints, 17 bits, two gyro IMUs", Rig(6, 2**17, gyro=True)))
    found.append(("6 joints, 17 bits, gyro IMU a link", Rig(6, 2**17, "each", gyro=True)))
    return found + [
        (f"{joints} joint{'s' if joints > 1 else ''}, {name}", Rig(joints, counts, fault=fault))
        for joints, counts in ((1, LINES_400), (2, LINES_400), (6, 2**17))
        for name, fault in FAULTS.items()
    ]


FAULTS = {
    "bias 0.5 m/s^2": Fault(bias=0.5),
    "drift 0.1 m/s^2": Fault(drift=0.1),
    "scale 1 %": Fault(gain=0.01),
    "misaligned 0.5 deg": Fault(tilt_deg=0.5),
    "clock 2 ms late": Fault(delay_s=0.002),
    "clock 20 ms late": Fault(delay_s=0.02),
    "all of it": EVERYTHING,
    "last IMU lost midway": Fault(lost=True),
}


def rendered(rows: Sequence[Row]) -> str:
    """Tables in Markdown."""
    header = ["rig", "encoder", "IMU", "Eq. 30, 42", "fused", "stated", "bound"]
    header += ["fused / encoder", "fused / bound"]
    lines = []
    for row in rows:
        parts = (row.encoder, row.imu, row.paper, row.fused, row.stated, row.bound)
        own = [_mean(x) for x in parts]
        own += [number(float(np.max(row.fused / row.encoder)))]
        own += [number(float(np.max(row.fused / row.bound)))]
        label = row.label + (f" ({', '.join(row.left_out)} left out)" if row.left_out else "")
        lines.append([label, *own])
    speeds = [
        [row.label, _mean(row.encoder_speed), _mean(row.paper_speed), _mean(row.fused_speed)]
        for row in rows
        if row.paper_speed is not None
    ]
    second = table(["rig", "encoder", "Eq. 31, 41", "fused"], speeds)
    return f"{table(header, lines)}\n\nVelocity, rad/s:\n\n{second}"


def _mean(errors: Array | None) -> str:
    """RMS over the joints."""
    return "-" if errors is None else number(float(np.sqrt(np.mean(errors**2))))


def study(chosen: Namespace) -> str:
    """All rows."""
    rows = []
    for label, rig in rigs(quick=chosen.quick):
        rows.append(measured(label, rig))
        sys.stderr.write(f"{label}: {_mean(rows[-1].fused)}\n")
    return rendered(rows)
