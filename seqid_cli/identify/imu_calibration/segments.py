"""What the IMU calibration takes from a log: readings, and encoders with all their uncertainty.

Readings and encoders pass the same zero-phase low-pass and are kept on nodes a few to a period of
its cut-off. A moving joint's position at the nodes is an unknown of the fit, which the encoder
measures: a fine one by its low-passed codes, a coarse one by the edges that it crosses, and a code
that lasts counts once however many samples repeat it. A locked joint keeps the mean of its codes
up to an unknown constant within the encoder's step.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from seqid_cli.identify.imu_calibration.readings import Readings, readings_of
from seqid_cli.logs.recording import Recording
from seqid_cli.motion.filters.bandwidth import encoder_step
from seqid_cli.motion.filters.butterworth import Lowpass
from seqid_cli.motion.filters.differentiation import differentiate, runs, shrink
from seqid_cli.motion.motion import Motion, encoder_resolution
from seqid_cli.motion.smoother.encoder import EncoderView, encoder_view
from seqid_cli.robot.types import Imu, Robot
from seqid_cli.typing import Array, Index, Mask

REACH = 4  # nodes that a derivative reaches to each side
HIGHEST_HZ = 20.0
NODES_PER_CUTOFF = 6.0
LONGEST_S, SHORTEST_S = 20.0, 0.3
MOST_NODES = 60_000
LOCKED_NOISE = 0.01  # rad/s^2 that a locked joint's encoder may add
LEAST_HZ = 3.0  # below which a locked joint's encoder is not followed
LEAST_OFFSET = 1e-4  # rad, of a locked joint, that is worth an unknown
JERK_SLACK = 3.0
REPEATED = 2.0  # swings that repeat themselves repeat their quantisation errors


@dataclass(frozen=True)
class EncoderRows:
    """Measurements of one joint: at node `at` + 0..3 with `weights` (M, 4), `value` rad, 1/rad^2.

    Only rows with information are kept.
    """

    at: Index
    weights: Array
    value: Array
    information: Array


@dataclass(frozen=True)
class Segment:
    """A stretch of one log on nodes `t` (N,) s; arrays of moving joints have REACH nodes more.

    `q`, `dq`, `ddq` (N, n) are of all joints, those of `moving` to be replaced by the unknowns,
    which start at `start` (N + 2 REACH, m). `locked` joints are those at rest whose encoder leaves
    their position open by `offset_sigma` rad.
    """

    log: int
    name: str
    t: Array
    spacing: float
    q: Array
    dq: Array
    ddq: Array
    moving: tuple[int, ...]
    start: Array
    encoders: tuple[EncoderRows, ...]
    jerk: Array  # (m,) rad/s^3
    locked: tuple[int, ...]
    offset_sigma: Array
    readings: Readings
    share: float  # raw samples per node
    cutoff_hz: float
    encoder_hz: float  # below which the differentiated encoder is trusted

    @property
    def samples(self) -> int:
        """Number of nodes with readings."""
        return len(self.t)

    @property
    def channels(self) -> int:
        """Number of channels."""
        return int(self.readings.values.shape[1])


def thinned(segments: list[Segment]) -> list[Segment]:
    """Segments that a fit can hold at once, evenly chosen where there are too many."""
    total = sum(segment.samples for segment in segments)
    every = int(np.ceil(total / MOST_NODES))
    return segments[::every]


def calibration_cutoff(motion: Motion, chosen_hz: float | None) -> float:
    """Cut-off [Hz] for readings and encoders: far above the motion, far below the rate."""
    if chosen_hz is not None:
        return min(chosen_hz, motion.rate_hz / NODES_PER_CUTOFF)
    return min(HIGHEST_HZ, motion.rate_hz / NODES_PER_CUTOFF)


def segments_of(
    recording: Recording, robot: Robot, imu: Imu, motion: Motion, *, log: int, cutoff_hz: float
) -> list[Segment]:
    """Cut one log into stretches of the calibration.

    Parameters
    ----------
    motion : Motion
        Of the same recording, for what moves and how fast.
    log : int
        Number of the log among those of the calibration.
    cutoff_hz : float
        Of the low-pass on readings and encoders.

    Returns
    -------
    list of Segment
        Empty where nothing before the IMU moves long enough.
    """
    lowpass = Lowpass(cutoff_hz, recording.rate_hz)
    steps = encoder_resolution(robot)
    smooth = lowpass(recording.q, recording.valid)
    source = _Source(
        recording=recording,
        motion=motion,
        link=imu.after_joint,
        smooth=smooth,
        speed=differentiate(smooth, recording.rate_hz, recording.valid)[0],
        steps=np.where(steps > 0, steps, encoder_step(recording.q)),
        readings=readings_of(recording, imu, lowpass),
        lowpass=lowpass,
        log=log,
    )
    # Ends that feel the filter's own ends are not used.
    usable = shrink(recording.valid, lowpass.settling // 2)
    pieces = [_segment(source, own) for own in _pieces(usable, recording.rate_hz)]
    return [piece for piece in pieces if piece is not None]


@dataclass(frozen=True)
class _Source:
    """A log and what is computed from it once."""

    recording: Recording
    motion: Motion
    link: int
    smooth: Array
    speed: Array
    steps: Array
    readings: Readings
    lowpass: Lowpass
    log: int


def _pieces(usable: Mask, rate_hz: float) -> Iterator[slice]:
    for start, stop in runs(usable, len(usable)):
        count = max(1, int(np.ceil((stop - start) / (LONGEST_S * rate_hz))))
        edges = np.linspace(start, stop, count + 1).astype(int)
        for a, b in pairwise(edges):
            if b - a > SHORTEST_S * rate_hz:
                yield slice(int(a), int(b))


def _segment(source: _Source, own: slice) -> Segment | None:
    recording, rate = source.recording, source.recording.rate_hz
    every = max(1, int(rate / (NODES_PER_CUTOFF * source.lowpass.cutoff_hz)))
    nodes = np.arange(own.start + REACH * every, own.stop - REACH * every, every)
    if len(nodes) < 4 * REACH:
        return None
    chain = range(source.link + 1)
    wide = np.arange(nodes[0] - REACH * every, nodes[-1] + REACH * every + 1, every)
    views = {j: encoder_view(recording.q[:, j], float(source.steps[j])) for j in chain}
    moves: Mask = np.any(source.motion.moving[own], axis=0)
    moving = tuple(j for j in chain if moves[j] or _hunts(source, j, views[j], own))
    resting = tuple(j for j in chain if j not in moving)
    q = source.smooth[nodes].copy()
    dq, ddq = np.zeros_like(q), np.zeros_like(q)
    for j in resting:
        still = _locked_motion(recording.q[:, j], recording, views[j])
        q[:, j], dq[:, j], ddq[:, j] = (x[nodes] for x in still)
    off = {j: float(np.sqrt(views[j].step ** 2 / 12 + views[j].white)) for j in resting}
    locked = tuple(j for j in resting if off[j] > LEAST_OFFSET)
    return Segment(
        log=source.log,
        name=recording.path.name,
        t=recording.t[nodes],
        spacing=every / rate,
        q=q,
        dq=dq,
        ddq=ddq,
        moving=moving,
        start=source.smooth[wide][:, list(moving)],
        encoders=tuple(_encoder_rows(source, j, views[j], wide, own) for j in moving),
        jerk=np.full(len(moving), _jerk(source.motion.ddq[own], rate)),
        locked=locked,
        offset_sigma=np.array([off[j] for j in locked]),
        readings=source.readings,
        share=float(every),
        cutoff_hz=source.lowpass.cutoff_hz,
        encoder_hz=source.motion.cutoff.hz,
    )


def _jerk(ddq: Array, rate_hz: float) -> float:
    """Standard deviation that moving joints' jerks are given, rad/s^3.

    Joints push each other: one that hunts within a few counts jerks as the others do, whatever its
    encoder shows of it.
    """
    rms = np.sqrt(np.mean((np.diff(ddq, axis=0) * rate_hz) ** 2, axis=0))
    return max(JERK_SLACK * float(np.max(rms)), 1.0)


def _hunts(source: _Source, j: int, view: EncoderView, own: slice) -> bool:
    """Whether a joint leaves a code of an encoder that is too coarse to show how."""
    codes = view.q[own]
    return _still_hz(view, source.recording.rate_hz) < LEAST_HZ and bool(np.ptp(codes) > 0.0)


def _still_hz(view: EncoderView, rate_hz: float) -> float:
    """Cut-off up to which an encoder shows a locked joint's acceleration to LOCKED_NOISE."""
    density = (view.step**2 / 12 + view.white) * 2 / rate_hz
    return float((5 * LOCKED_NOISE**2 / (max(density, 1e-24) * (2 * np.pi) ** 4)) ** 0.2)


def _locked_motion(q: Array, recording: Recording, view: EncoderView) -> tuple[Array, ...]:
    """What a locked joint does: no more than its encoder shows of it without its noise."""
    hz = _still_hz(view, recording.rate_hz)
    lowpass = Lowpass(min(hz, recording.rate_hz / NODES_PER_CUTOFF), recording.rate_hz)
    long_enough = len(q) > 4 * lowpass.settling
    if hz < LEAST_HZ or not long_enough:
        mean = np.full(len(q), float(np.mean(q[recording.valid])))
        return mean, np.zeros(len(q)), np.zeros(len(q))
    smooth = lowpass(q, recording.valid)
    dq, ddq = differentiate(smooth, recording.rate_hz, recording.valid)
    return smooth, dq, ddq


def _encoder_rows(
    source: _Source, j: int, view: EncoderView, wide: Index, own: slice
) -> EncoderRows:
    """Rows of one moving joint; a coarse encoder by its edges, a fine one by what is low-passed."""
    rate = source.recording.rate_hz
    strongest = float(np.max(np.abs(source.motion.ddq[own, j])))
    # What the low-pass takes off a jump of the acceleration.
    rounding = strongest / (2 * np.pi * source.lowpass.cutoff_hz) ** 2
    if view.step / np.sqrt(12) < rounding or not np.isfinite(view.edge).any():
        return _fine_rows(source.smooth[wide, j], source.speed[wide, j], view, wide, rate)
    samples, edges = view.weights(source.speed[:, j], 1.0 / rate)
    index = np.arange(len(view.q), dtype=np.float64)
    places = np.concatenate([index, index + 0.5])
    information = np.concatenate([samples, edges]) / REPEATED
    information = information / (1.0 + information * (0.1 * rounding) ** 2)
    value = np.concatenate([view.q, np.nan_to_num(view.edge)])
    kept = (information > 0) & (places >= wide[0]) & (places <= wide[-1])
    u = (places[kept] - wide[0]) / (wide[1] - wide[0])
    at = np.clip(np.floor(u).astype(np.intp) - 1, 0, len(wide) - 4)
    return EncoderRows(at, lagrange(u - at), value[kept], information[kept])


def _fine_rows(
    smooth: Array, speed: Array, view: EncoderView, wide: Index, rate_hz: float
) -> EncoderRows:
    """One row per node, as good as all the samples that it stands for, if their codes differ."""
    every, count = int(wide[1] - wide[0]), len(wide)
    variance = max(view.step**2 / 12 + view.white, 1e-16)
    slow = np.abs(speed) / rate_hz * every < view.step
    alike = np.where(slow, np.maximum(view.dwell[wide], 1.0), 1.0)
    at = np.clip(np.arange(count) - 1, 0, count - 4)
    weights = np.zeros((count, 4))
    weights[np.arange(count), np.arange(count) - at] = 1.0
    return EncoderRows(at, weights, smooth, every / (variance * alike))


def lagrange(u: Array) -> Array:
    """Weights (M, 4) of a cubic through nodes 0..3 at `u` (M,)."""
    a, b, c, d = u, u - 1, u - 2, u - 3
    return np.column_stack([-b * c * d / 6, a * c * d / 2, -a * b * d / 2, a * b * c / 6])
