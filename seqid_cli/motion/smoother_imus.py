"""IMUs for the motion smoother: their readings, where they sit, and whether to believe them."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import uniform_filter1d
from scipy.spatial.transform import Rotation

from seqid_cli.logs.recording import Recording
from seqid_cli.motion.smoother_system import Chunk, Mounted, jacobians, predicted, state_of
from seqid_cli.params.schema import ImuCalibration, ImuStage
from seqid_cli.robot.types import Imu, Robot

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

BIAS, GYRO_BIAS, LEVER = 0.3, 0.05, 1.0  # m/s^2, rad/s, m: prior standard deviations
TURN_DEG = (0.03, 10.0)  # limits of a calibration's standard error as a prior
LEAST_NOISE = 1e-3  # m/s^2 or rad/s
DISAGREEMENT = 0.5  # share of the expected reading's changes, beyond which an IMU is not believed
LARGEST_OFFSET = 2.0  # m/s^2 or rad/s, of a mean reading
LEAST_SEEN = 0.3  # share of the samples
COMPARE_S = 0.1
SILENT = 25  # samples alike in all channels


def mounted_imus(
    recording: Recording, robot: Robot, stage: ImuStage | None, every: int
) -> tuple[list[Mounted], list[str]]:
    """IMUs with calibration and readings, at the recording's full length."""
    found, notes = [], []
    calibrations = stage.imus if stage else {}
    for imu in robot.imus:
        calibration = calibrations.get(imu.name)
        values = recording.accelerometers.get(imu.name)
        if calibration is None or values is None:
            notes.append(f"{imu.name}: not calibrated or not recorded")
            continue
        gyro = recording.gyros.get(imu.name) if imu.gyro else None
        raw = values if gyro is None else np.hstack([values, gyro])
        found.append(_mounted(imu, calibration, raw, recording.valid, every, gyro is not None))
    return found, notes


def _mounted(
    imu: Imu, calibration: ImuCalibration, raw: Array, valid: Mask, every: int, gyro: bool
) -> Mounted:
    live = np.isfinite(raw).all(axis=1) & valid
    # A sensor that fell silent repeats its last reading in all channels.
    same = np.append(False, (np.diff(raw, axis=0) == 0).all(axis=1))
    live &= uniform_filter1d(same.astype(float), SILENT) < 0.9
    raw = np.where(live[:, None], raw, 0.0)
    pad = -len(raw) % every
    y = np.pad(raw, [(0, pad), (0, 0)]).reshape(-1, every, raw.shape[1]).mean(axis=1)
    seen: Mask = np.asarray(np.pad(live, (0, pad)).reshape(-1, every).all(axis=1))
    # Fourth differences keep the noise (times sqrt 70) and drop the motion.
    whole = uniform_filter1d(live.astype(float), 5)[2:-2] > 0.99
    rough = np.abs(np.diff(raw, 4, axis=0))[whole] if whole.any() else np.ones_like(raw[:1])
    noise = np.maximum(np.median(rough, axis=0) / 0.6745 / np.sqrt(70.0), LEAST_NOISE)
    errors = calibration.std_errors_deg or [calibration.std_error_deg]
    turn = np.radians(np.clip(np.max(errors), *TURN_DEG))
    biases = np.repeat([BIAS, GYRO_BIAS], [len(imu.axes), raw.shape[1] - len(imu.axes)])
    prior = np.concatenate([biases, np.full(3, LEVER), np.full(3, turn)])
    R = np.array(calibration.rotation)
    zero = np.zeros(3)
    noise = noise / np.sqrt(every)
    return Mounted(imu, y, seen, noise, R, zero, np.zeros_like(biases), zero, prior, gyro)


def believed(chunk: Chunk, c: Array) -> tuple[Chunk, list[str]]:
    """Place the IMUs on the encoders' motion `c`; those that contradict it are left out."""
    if not chunk.imus:
        return chunk, []
    state = state_of(chunk, c)
    cells, told = jacobians(chunk, c), predicted(chunk, state)
    placed = [
        _placed(x, y, rows[1] * x.noise[:, None], cells.size)
        for x, y, rows in zip(chunk.imus, told, cells.rows, strict=True)
    ]
    chunk = replace(chunk, imus=tuple(placed))
    kept, notes = [], []
    for x, expected in zip(chunk.imus, predicted(chunk, state), strict=True):
        reason = _contradiction(x, expected, chunk)
        if reason:
            notes.append(f"{x.imu.name} is left out: {reason}")
        else:
            kept.append(x)
    return replace(chunk, imus=tuple(kept)), notes


def _placed(x: Mounted, told: Array, G: Array, size: int) -> Mounted:
    """Least squares for an IMU's constants on a motion that is taken as given."""
    cells = np.arange(0, len(x.y), size)
    count = np.maximum(np.add.reduceat(x.seen.astype(float), cells), 1e-9)[:, None]
    r = np.add.reduceat((x.y - told) * x.seen[:, None], cells, axis=0) / count
    G = G * (count > 0.5)[:, :, None]
    noise = np.maximum(x.noise, 1.4826 * np.median(np.abs(r), axis=0))
    G = G / noise[:, None]
    information = np.tensordot(G, G, ([0, 1], [0, 1])) + np.diag(x.prior**-2.0)
    gradient = np.tensordot(r / noise, G, 2) - x.constants / x.prior**2
    return moved(x, np.asarray(np.linalg.solve(information, gradient), dtype=np.float64))


def _contradiction(x: Mounted, expected: Array, chunk: Chunk) -> str:
    """Why an IMU cannot be right, or nothing."""
    share = float(x.seen.mean()) * chunk.views[0].stride
    if share < LEAST_SEEN:
        return f"it reads in {100 * share:.0f} % of the samples"
    width = max(3, int(COMPARE_S / (chunk.dt * chunk.every)))
    weight = np.maximum(uniform_filter1d(x.seen.astype(float), width), 1e-9)[:, None]
    seen, told = (
        (uniform_filter1d(v * x.seen[:, None], width, axis=0) / weight)[x.seen]
        for v in (x.y, expected)
    )
    off = np.abs((seen - told).mean(axis=0)).max()
    if not off < LARGEST_OFFSET:
        return f"its mean reading is off by {off:.3g} (limit {LARGEST_OFFSET:g})"
    error, size = (float(np.sqrt(np.mean(np.var(v, axis=0)))) for v in (seen - told, told))
    limit = DISAGREEMENT * size + 3 * float(np.sqrt(np.mean(x.noise**2)))
    if not error < limit:
        return f"it differs from the encoders by {error:.3g} (limit {limit:.3g})"
    return ""


def moved(x: Mounted, change: Array) -> Mounted:
    """Renew an IMU's constants."""
    channels = len(x.noise)
    turn = change[channels + 3 :]
    return replace(
        x,
        bias=x.bias + change[:channels],
        lever=x.lever + change[channels : channels + 3],
        turn=x.turn + turn,
        R=x.R @ Rotation.from_rotvec(turn).as_matrix(),
    )
