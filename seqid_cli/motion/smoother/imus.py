"""IMUs for the motion smoother: what calibration knows of them, and their live readings."""

from dataclasses import replace

import numpy as np
from scipy.ndimage import uniform_filter1d
from scipy.spatial.transform import Rotation

from seqid_cli.logs.recording import Recording
from seqid_cli.motion.imu.array import entries
from seqid_cli.motion.imu.sensor import Mounting
from seqid_cli.motion.smoother.chunk import Mounted
from seqid_cli.params.schema import ImuCalibration, ImuStage
from seqid_cli.robot.types import Imu, Robot
from seqid_cli.robust import white_noise
from seqid_cli.typing import Array, Index, Mask

# Prior standard deviations where no calibration says better, and what changes since it
# was made.
BIAS_DRIFT, GYRO_BIAS_DRIFT, DELAY_DRIFT_S = 0.05, 0.005, 0.001
LEAST_NOISE = 1e-3  # m/s^2 or rad/s


def mounted_imus(
    recording: Recording, robot: Robot, stage: ImuStage | None
) -> list[Mounted]:
    """IMUs with calibration and readings, as the calibration has them, without their readings."""
    known = stage.imus if stage else {}
    both = known.keys() & recording.accelerometers.keys()
    return [_mounted(x, known[x.name], recording) for x in robot.imus if x.name in both]


def _mounted(imu: Imu, known: ImuCalibration, recording: Recording) -> Mounted:
    count, rates = len(imu.axes), 3 if imu.gyro and imu.name in recording.gyros else 0
    R, lever = np.array(known.rotation), entries(known.lever, 3, 0.0)
    bias, density, gains = (
        np.concatenate([entries(own, count, usual), entries(gyros, rates, usual)])
        for own, gyros, usual in (
            (known.accelerometer_bias, known.gyro_bias, 0.0),
            (known.accelerometer_noise, known.gyro_noise, 0.0),
            (known.accelerometer_scale, known.gyro_scale, 1.0),
        )
    )
    own = known.accelerometer_axes
    axes = np.array(own) if len(own) == count else imu.axes
    if rates:
        axes = np.vstack([axes, known.gyro_axes or np.eye(3)])
    prior = _prior(known, count, rates)
    nothing = np.zeros((0, count + rates))
    return Mounted(
        name=imu.name,
        place=Mounting(imu.after_joint, imu.positions, axes * gains[:, None], R, lever),
        raw=nothing,
        live=nothing > 0,
        noise=np.maximum(density * np.sqrt(recording.rate_hz / 2), LEAST_NOISE),
        bias=bias,
        delay=known.time_offset_s if known.time_offset_std_error_s is not None else 0.0,
        gyro_delay=known.gyro_delay_s if rates else 0.0,
        away=np.zeros(len(prior)),
        precision=np.diag(prior**-2.0),
        y=nothing,
        seen=nothing > 0,
    )


def _prior(
    known: ImuCalibration,
    count: int,
    rates: int,
    *,
    delay_s: float = 0.02,
    lever_drift: float = 0.0002,
    gain_drift: float = 0.001,
    turn_deg: tuple[float, float] = (0.03, 10.0),
    bias_prior: float = 0.3,
    gyro_bias_prior: float = 0.05,
    lever_prior: float = 1.0,
    gain_prior: float = 0.01,
) -> Array:
    """Standard deviations (g,) of biases, place, turn, clock offset and axes."""
    turns = known.std_errors_deg or [known.std_error_deg]
    bias, gyro_bias, lever, gain, gyro_gain = (
        np.hypot(entries(values, size, default), drift)
        for values, size, default, drift in (
            (known.accelerometer_bias_std_errors, count, bias_prior, BIAS_DRIFT),
            (known.gyro_bias_std_errors, rates, gyro_bias_prior, GYRO_BIAS_DRIFT),
            (known.lever_std_errors, 3, lever_prior, lever_drift),
            (known.accelerometer_scale_std_errors, count, gain_prior, gain_drift),
            (known.gyro_scale_std_errors, rates, gain_prior, gain_drift),
        )
    )
    usual = np.degrees(gain_prior)
    tilts = entries(known.accelerometer_tilt_std_errors_deg, count, usual)
    tilts = np.append(tilts, entries(known.gyro_tilt_std_errors_deg, rates, usual))
    axes = np.maximum(np.concatenate([gain, gyro_gain]), np.radians(tilts))
    offset = known.time_offset_std_error_s
    late = delay_s if offset is None else float(np.hypot(offset, DELAY_DRIFT_S))
    turn = np.full(3, np.radians(np.clip(np.max(turns), *turn_deg)))
    return np.concatenate([bias, gyro_bias, lever, turn, [late], np.repeat(axes, 3)])


def read(x: Mounted, recording: Recording, own: slice) -> Mounted:
    """Give an IMU its readings of one stretch of the log."""
    parts = [recording.accelerometers[x.name][own]]
    has_gyro = x.place.channels > len(x.place.positions)
    if has_gyro:
        parts.append(recording.gyros[x.name][own])
    raw = np.hstack(parts)
    live: Mask = np.isfinite(raw) & recording.valid[own, None]
    raw = np.where(live, raw, 0.0)
    live &= ~_silent(raw, recording.rate_hz)
    noise = np.maximum(white_noise(raw, np.asarray(live.all(axis=1))), 0.5 * x.noise)
    live &= ~clipped(raw, live, noise)
    if has_gyro and x.gyro_delay:
        _on_accelerometers_clock(raw, live, recording.t[own], x)
    return replace(x, raw=raw, live=live, noise=np.maximum(noise, LEAST_NOISE))


def _on_accelerometers_clock(raw: Array, live: Mask, t: Array, x: Mounted) -> None:
    """Move a gyro's channels, in place, to the times of the accelerometers.

    After this one clock holds for all channels. Values between two samples are on
    straight lines: the gyro is later by a fraction of a sample, as a rule.
    """
    later = t + x.gyro_delay
    for channel in range(len(x.place.positions), x.place.channels):
        raw[:, channel] = np.interp(later, t, raw[:, channel])
        counts = np.interp(later, t, live[:, channel].astype(float))
        live[:, channel] &= counts > 0.999


def _silent(
    raw: Array, rate_hz: float, *, stuck_s: float = 0.5, min_alike: int = 25
) -> Mask:
    """Where a sensor repeats its last reading in all channels, or one while the others move."""
    values = np.ascontiguousarray(raw.T)
    same = np.zeros(values.shape, dtype=bool)
    np.equal(values[:, 1:], values[:, :-1], out=same[:, 1:])
    silent = uniform_filter1d(same.all(axis=0).astype(float), min_alike) > 0.9
    # The window's whole width is as silent as its middle.
    silent = uniform_filter1d(silent.astype(float), min_alike + 2) > 0
    width = max(min_alike, int(stuck_s * rate_hz))
    stuck = np.zeros_like(same)
    often = np.count_nonzero(same, axis=1) / len(raw)
    for k in np.flatnonzero(often > min(width, len(raw)) / (2 * len(raw))):
        others = np.delete(same, k, axis=0).mean(axis=0)
        alone = uniform_filter1d(same[k] & (others < 0.5), width, output=float) > 0.9
        stuck[k] = uniform_filter1d(alone.astype(float), width) > 0
    return np.asarray((stuck | silent).T)


def clipped(
    raw: Array,
    live: Mask,
    noise: Array,
    *,
    clipped_noise: float = 20.0,
    min_clipped: int = 3,
) -> Mask:
    """Where a channel stays at its own limit for several samples, with those beside them."""
    found = np.zeros_like(live)
    for k in np.flatnonzero(live.any(axis=0)):
        channel = np.ascontiguousarray(raw[:, k])
        values = channel[live[:, k]]
        middle = float(np.median(values))
        for limit in (values.min(), values.max()):
            at = channel == limit
            if abs(limit - middle) < clipped_noise * noise[k] or at.sum() < min_clipped:
                continue
            run = (
                np.convolve(at.astype(float), np.ones(min_clipped), "same")
                > min_clipped - 0.5
            )
            found[:, k] |= np.convolve(run, np.ones(min_clipped + 2), "same") > 0.5
    return found


def moved(x: Mounted, change: Array) -> Mounted:
    """Renew an IMU's constants by `change` (g,)."""
    place, channels = x.place, x.place.channels
    bias, lever, turn, late, axes = np.split(change, channels + np.array([0, 3, 6, 7]))
    turned, axes = Rotation.from_rotvec(turn), place.axes + axes.reshape(-1, 3)
    place = replace(
        place, lever=place.lever + lever, R=place.R @ turned.as_matrix(), axes=axes
    )
    away, turns = x.away + change, slice(channels + 3, channels + 6)
    away[turns] = (Rotation.from_rotvec(x.away[turns]) * turned).as_rotvec()
    return replace(
        x, place=place, bias=x.bias + bias, delay=x.delay + float(late[0]), away=away
    )


def handed_on(
    x: Mounted, taken: Index, covariance: Array, *, forget: float = 1.5
) -> Mounted:
    """What the next stretch is to assume; `covariance` (m, m) is of the constants `taken` (m,)."""
    own: Array = np.asarray(np.linalg.inv(x.precision), dtype=np.float64)
    own[taken], own[:, taken] = 0.0, 0.0
    own[np.ix_(taken, taken)] = covariance
    channels = x.place.channels
    rates = channels - len(x.place.positions)
    drift = np.zeros(len(own))
    drift[:channels] = np.repeat(
        [BIAS_DRIFT, GYRO_BIAS_DRIFT], [channels - rates, rates]
    )
    drift[channels + 6] = 0.1 * DELAY_DRIFT_S
    precision = np.linalg.inv(forget * own + np.diag(0.1 * drift**2))
    return replace(
        x, away=np.zeros(len(x.away)), precision=0.5 * (precision + precision.T)
    )
