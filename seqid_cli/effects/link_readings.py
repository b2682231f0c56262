"""What an IMU reads of its link beyond what the encoders say that the link does.

Encoders stand on the motors, IMUs on the links. With h(q, dq, ddq) the readings that
the calibration of the file gives to a motion, and q_m that of the encoders,

    r = y - h(q_m, dq_m, ddq_m) = (dh/dq, dh/ddq, ...) (x, x', x'') + e,

x the angles by which links are ahead of their encoders, e noise and what the
calibration errs. Where a gear twists or has play, neither sensor is the other's truth:
r is the twist itself. A gyro takes part by the derivative of its readings.
"""

from dataclasses import dataclass, replace

import numpy as np

from seqid_cli.imu.sensor import Mounting, link_state
from seqid_cli.imu.smoother.chunk import Mounted
from seqid_cli.imu.smoother.imus import mounted_imus
from seqid_cli.logs.recording import Recording
from seqid_cli.motion.filters.butterworth import Lowpass
from seqid_cli.motion.filters.differentiation import differentiate
from seqid_cli.params.schema import ImuStage
from seqid_cli.robot.types import Robot
from seqid_cli.typing import Array


@dataclass(frozen=True, kw_only=True)
class LinkReadings:
    """One IMU along one log, low-passed like the motion.

    It has C channels: k accelerometers, and the derivatives of its gyro's.

    Attributes
    ----------
    place : Mounting
        As the file's calibration has it.
    motion : Array
        q, dq, ddq (3, n, N) by the encoders alone.
    residual : Array
        r (N, C) [m/s^2; rad/s^2 of the gyro].
    rate : Array
        Derivative (N, C) over time of the readings that the encoders' motion gives.
    turning : Array
        (N, 3) rad/s^2, derivative of the link's angular velocity in its own frame.
    noise : Array
        (C,), of a low-passed reading.
    precision : Array
        (g,) of what the calibration leaves open: the constants of `imu.sensor.Places`,
        then the axes (3 C).
    from_middle : Array
        (N,) s, from the instant at which the clock's offset is meant.
    """

    place: Mounting
    motion: Array
    residual: Array
    rate: Array
    turning: Array
    noise: Array
    precision: Array
    from_middle: Array

    def every(self, stride: int) -> "LinkReadings":
        """Return every so many samples."""
        return replace(
            self,
            motion=self.motion[:, :, ::stride],
            residual=self.residual[::stride],
            rate=self.rate[::stride],
            turning=self.turning[::stride],
            from_middle=self.from_middle[::stride],
        )


def link_readings(
    recording: Recording, robot: Robot, stage: ImuStage | None, lowpass: Lowpass
) -> tuple[LinkReadings, ...]:
    """Compare the IMUs of a log with its encoders, at the log's own rate.

    Parameters
    ----------
    recording : Recording
    robot : Robot
    stage : ImuStage, optional
        The file's calibrations.
    lowpass : Lowpass
        That of the motion, at the log's rate.

    Returns
    -------
    tuple of LinkReadings
        One for each IMU that is calibrated and recorded.
    """
    mounted = mounted_imus(recording, robot, stage)
    if not mounted:
        return ()
    rate_hz = recording.rate_hz
    valid = recording.valid
    q = lowpass(recording.q, valid)
    dq, ddq = differentiate(q, rate_hz, valid)
    motion = np.stack([q.T, dq.T, ddq.T])
    return tuple(_compared(imu, recording, robot, motion, lowpass) for imu in mounted)


def _compared(
    imu: Mounted, recording: Recording, robot: Robot, motion: Array, lowpass: Lowpass
) -> LinkReadings:
    """Compare one IMU with the encoders' motion (3, n, N)."""
    rate_hz = recording.rate_hz
    valid = recording.valid
    place = imu.place
    k = len(place.positions)

    # What was felt at t has a stamp that is later by the offset of the IMU's clock.
    from_middle = recording.t + recording.offset - imu.middle_s
    stamps = recording.t + imu.delay + imu.rate * from_middle
    readings = [recording.accelerometers[imu.name]]
    late_s = np.zeros(place.channels)
    if place.channels > k:
        readings.append(recording.gyros[imu.name])
        late_s[k:] = imu.gyro_delay
    on_clock = [
        np.interp(stamps + late, recording.t[valid], channel[valid])
        for channel, late in zip(np.hstack(readings).T, late_s, strict=True)
    ]
    low = lowpass(np.column_stack(on_clock) - imu.bias, valid)

    x = link_state(robot, place.link, motion)
    expected = x @ place.matrix.T
    turning, _ = differentiate(x[:, 12:], rate_hz, valid)
    residual = low - expected
    residual[:, k:], _ = differentiate(residual[:, k:], rate_hz, valid)
    expected[:, k:], _ = differentiate(expected[:, k:], rate_hz, valid)
    rate, _ = differentiate(expected, rate_hz, valid)

    # White noise of a sample, low-passed; that of a derivative grows with frequency.
    noise = imu.noise * np.sqrt(2.0 * lowpass.cutoff_hz / rate_hz)
    noise[k:] *= 2.0 * np.pi * lowpass.cutoff_hz / np.sqrt(3.0)
    return LinkReadings(
        place=place,
        motion=motion,
        residual=residual,
        rate=rate,
        turning=turning,
        noise=noise,
        precision=np.diag(imu.precision).copy(),
        from_middle=from_middle,
    )
