"""IMUs for the motion smoother: what calibration knows of them, and their readings.

The letters are those of `chunk`.
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from seqid_cli.imu.array import entries
from seqid_cli.imu.sensor import Mounting
from seqid_cli.imu.smoother.chunk import Mounted
from seqid_cli.logs.recording import Recording
from seqid_cli.params.schema import ImuCalibration, ImuStage
from seqid_cli.robot.kinematics import one_turn, turned_by
from seqid_cli.robot.types import Imu, Robot
from seqid_cli.robust import white_noise
from seqid_cli.running import running_max, running_mean
from seqid_cli.typing import Array, Index, Mask

# Standard deviations of what changes since a calibration was made.
BIAS_DRIFT = 0.05  # m/s^2
GYRO_BIAS_DRIFT = 0.005  # rad/s
DELAY_DRIFT_S = 0.001
RATE_DRIFT = 1e-5  # s/s
LEAST_NOISE = 1e-3  # m/s^2 or rad/s


def mounted_imus(
    recording: Recording, robot: Robot, stage: ImuStage | None
) -> list[Mounted]:
    """Return the IMUs that are calibrated and recorded, without their readings."""
    calibrations = stage.imus if stage else {}
    return [
        _mounted(imu, calibrations[imu.name], recording)
        for imu in robot.imus
        if imu.name in calibrations and imu.name in recording.accelerometers
    ]


def _mounted(imu: Imu, calibration: ImuCalibration, recording: Recording) -> Mounted:
    """Return an IMU as its calibration has it."""
    count = len(imu.axes)
    rates = 3 if imu.gyro and imu.name in recording.gyros else 0

    def of_channels(
        accelerometers: Sequence[float | None],
        gyro: Sequence[float | None],
        default: float,
    ) -> Array:
        """Return entries (L,) of all channels."""
        of_accelerometers = entries(accelerometers, count, default)
        return np.concatenate([of_accelerometers, entries(gyro, rates, default)])

    bias = of_channels(calibration.accelerometer_bias, calibration.gyro_bias, 0.0)
    density = of_channels(calibration.accelerometer_noise, calibration.gyro_noise, 0.0)
    gains = of_channels(calibration.accelerometer_scale, calibration.gyro_scale, 1.0)

    axes = imu.axes
    if len(calibration.accelerometer_axes) == count:
        axes = np.array(calibration.accelerometer_axes)
    if rates:
        axes = np.vstack([axes, calibration.gyro_axes or np.eye(3)])

    prior = _prior(calibration, count, rates)
    away = np.zeros(len(prior))
    has_offset = calibration.time_offset_std_error_s is not None
    nothing = np.zeros((0, count + rates))
    log_begins = Mounted(
        name=imu.name,
        place=Mounting(
            link=imu.after_joint,
            positions=imu.positions,
            axes=axes * gains[:, None],
            R=np.array(calibration.rotation),
            lever=entries(calibration.lever, 3, 0.0),
        ),
        raw=nothing,
        live=nothing > 0,
        noise=np.maximum(density * np.sqrt(recording.rate_hz / 2), LEAST_NOISE),
        bias=bias,
        delay=calibration.time_offset_s if has_offset else 0.0,
        rate=calibration.time_rate,
        middle_s=0.0,
        gyro_delay=calibration.gyro_delay_s if rates else 0.0,
        away=away,
        precision=np.diag(prior**-2.0),
        y=nothing,
        seen=nothing > 0,
        fraction=nothing[:, 0],
    )
    return with_middle(log_begins, 0.5 * float(recording.t[-1]) + recording.offset)


def _prior(
    calibration: ImuCalibration,
    count: int,
    rates: int,
    *,
    delay_s: float = 0.02,
    rate: float = 1e-3,
    lever_drift: float = 0.0002,
    gain_drift: float = 0.001,
    turn_deg: tuple[float, float] = (0.03, 10.0),
    bias_prior: float = 0.3,
    gyro_bias_prior: float = 0.05,
    lever_prior: float = 1.0,
    gain_prior: float = 0.01,
) -> Array:
    """Return standard deviations (g,) of an IMU's constants.

    They are those of its calibration, with what drifts since; `..._prior` where no
    calibration says better. `count` and `rates` are its numbers of accelerometers and
    of gyro channels.
    """

    def drifted(
        std_errors: Sequence[float | None], size: int, default: float, drift: float
    ) -> Array:
        return np.hypot(entries(std_errors, size, default), drift)

    bias = drifted(
        calibration.accelerometer_bias_std_errors, count, bias_prior, BIAS_DRIFT
    )
    gyro_bias = drifted(
        calibration.gyro_bias_std_errors, rates, gyro_bias_prior, GYRO_BIAS_DRIFT
    )
    lever = drifted(calibration.lever_std_errors, 3, lever_prior, lever_drift)
    gain = drifted(
        calibration.accelerometer_scale_std_errors, count, gain_prior, gain_drift
    )
    gyro_gain = drifted(
        calibration.gyro_scale_std_errors, rates, gain_prior, gain_drift
    )

    # An axis errs along itself by its gain, and across by its tilt.
    usual_tilt = np.degrees(gain_prior)
    tilts = np.append(
        entries(calibration.accelerometer_tilt_std_errors_deg, count, usual_tilt),
        entries(calibration.gyro_tilt_std_errors_deg, rates, usual_tilt),
    )
    axes = np.maximum(np.concatenate([gain, gyro_gain]), np.radians(tilts))

    late = delay_s
    if calibration.time_offset_std_error_s is not None:
        late = float(np.hypot(calibration.time_offset_std_error_s, DELAY_DRIFT_S))
    gains_on = rate
    if calibration.time_rate_std_error is not None:
        gains_on = float(np.hypot(calibration.time_rate_std_error, RATE_DRIFT))
    largest_turn = np.max(calibration.std_errors_deg or [calibration.std_error_deg])
    turn = np.full(3, np.radians(np.clip(largest_turn, *turn_deg)))
    return np.concatenate(
        [turn, lever, [late, gains_on], bias, gyro_bias, np.repeat(axes, 3)]
    )


def with_middle(x: Mounted, middle_s: float) -> Mounted:
    """Return an IMU with its clock as it is about another instant of the log."""
    # The offset there is a sum of two constants: offset + rate (middle - earlier one).
    delay = x.places.delay
    rate = x.places.rate
    later_s = middle_s - x.middle_s
    back = np.eye(len(x.away))
    back[delay, rate] = -later_s
    away = x.away.copy()
    away[delay] += later_s * away[rate]
    return replace(
        x,
        middle_s=middle_s,
        delay=x.delay + later_s * x.rate,
        away=away,
        precision=back.T @ x.precision @ back,
    )


def read(x: Mounted, recording: Recording, own: slice) -> Mounted:
    """Return an IMU with its readings of the samples `own` of a log."""
    n_samples = own.indices(len(recording.t))
    first_s = float(recording.t[n_samples[0]]) + recording.offset
    length_s = (n_samples[1] - n_samples[0]) / recording.rate_hz
    x = with_middle(x, first_s + 0.5 * length_s)
    channels = [recording.accelerometers[x.name][own]]
    has_gyro = x.place.channels > len(x.place.positions)
    if has_gyro:
        channels.append(recording.gyros[x.name][own])
    raw = np.hstack(channels)

    live: Mask = np.isfinite(raw) & recording.valid[own, None]
    raw = np.where(live, raw, 0.0)
    live &= ~_silent(raw, recording.rate_hz)
    white = white_noise(raw, np.asarray(live.all(axis=1)))
    noise = np.maximum(white, 0.5 * x.noise)
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
    """Find where (N, L) a sensor repeats its last reading.

    It does so in all channels, for `min_alike` samples, or in one for `stuck_s` while
    the others change.
    """
    values = np.ascontiguousarray(raw.T)
    repeats = np.zeros(values.shape, dtype=bool)
    np.equal(values[:, 1:], values[:, :-1], out=repeats[:, 1:])

    all_repeat = repeats.all(axis=0).astype(float)
    silent = running_mean(all_repeat, min_alike) > 0.9
    # The window's whole width is as silent as its middle.
    silent = running_max(silent, min_alike + 2)

    width = max(min_alike, int(stuck_s * rate_hz))
    stuck = np.zeros_like(repeats)
    share = np.count_nonzero(repeats, axis=1) / len(raw)
    for k in np.flatnonzero(share > min(width, len(raw)) / (2 * len(raw))):
        others = np.delete(repeats, k, axis=0).mean(axis=0)
        repeats_alone = repeats[k] & (others < 0.5)
        alone = running_mean(repeats_alone.astype(float), width) > 0.9
        stuck[k] = running_max(alone, width)
    return np.asarray((stuck | silent).T)


def clipped(
    raw: Array,
    live: Mask,
    noise: Array,
    *,
    clipped_noise: float = 20.0,
    min_clipped: int = 3,
) -> Mask:
    """Find where channels stay at their own limits, with the samples beside.

    Parameters
    ----------
    raw, live : Array, Mask
        Readings (N, L), and which of them count.
    noise : Array
        (L,) of single readings.
    clipped_noise : float
        Times the noise that a limit is away from the middle at least.
    min_clipped : int
        Samples in a row.

    Returns
    -------
    Mask
        (N, L).
    """
    at_limits = np.zeros_like(live)
    for k in np.flatnonzero(live.any(axis=0)):
        channel = np.ascontiguousarray(raw[:, k])
        values = channel[live[:, k]]
        middle = float(np.median(values))
        for limit in (values.min(), values.max()):
            at_limit = channel == limit
            is_near = abs(limit - middle) < clipped_noise * noise[k]
            if is_near or at_limit.sum() < min_clipped:
                continue
            in_row = np.convolve(at_limit.astype(float), np.ones(min_clipped), "same")
            is_run = in_row > min_clipped - 0.5
            around = np.convolve(is_run, np.ones(min_clipped + 2), "same")
            at_limits[:, k] |= around > 0.5
    return at_limits


def moved(x: Mounted, change: Array) -> Mounted:
    """Return an IMU whose constants have changed by `change` (g,)."""
    places = x.places
    place = replace(
        x.place,
        lever=x.place.lever + change[places.lever],
        R=turned_by(change[places.turn]) @ x.place.R,
        axes=x.place.axes + change[places.head :].reshape(-1, 3),
    )

    # Turns do not add up: they follow one another.
    away = x.away + change
    away[places.turn] = one_turn(x.away[places.turn], change[places.turn])
    return replace(
        x,
        place=place,
        bias=x.bias + change[places.bias],
        delay=x.delay + float(change[places.delay]),
        rate=x.rate + float(change[places.rate]),
        away=away,
    )


def handed_on(
    x: Mounted, taken: Index, covariance: Array, *, forget: float = 1.5
) -> Mounted:
    """Return an IMU as the next stretch is to assume it.

    Parameters
    ----------
    x : Mounted
    taken : Index
        Numbers of the constants that were estimated.
    covariance : Array
        Of these constants.
    forget : float
        Factor on all variances.
    """
    variances: Array = np.asarray(np.linalg.inv(x.precision), dtype=np.float64)
    variances[taken] = 0.0
    variances[:, taken] = 0.0
    variances[np.ix_(taken, taken)] = covariance

    places = x.places
    n_accelerometers = len(x.place.positions)
    drift = np.zeros(len(variances))
    bias_drift = drift[places.bias]
    bias_drift[:n_accelerometers] = BIAS_DRIFT
    bias_drift[n_accelerometers:] = GYRO_BIAS_DRIFT
    drift[places.delay] = 0.1 * DELAY_DRIFT_S
    drift[places.rate] = RATE_DRIFT

    precision = np.linalg.inv(forget * variances + np.diag(0.1 * drift**2))
    symmetric = 0.5 * (precision + precision.T)
    return replace(x, away=np.zeros(len(x.away)), precision=symmetric)
