"""What the IMU calibration takes from a log: readings, and encoders with all their uncertainty.

Readings and encoders pass the same zero-phase low-pass and are kept on nodes a few to a period of
its cut-off. A moving joint's position at the nodes is an unknown of the fit, which the encoder
measures: a fine one by its low-passed codes, a coarse one by the edges that it crosses, and a code
that lasts counts once however many samples repeat it. A locked joint keeps the mean of its codes
up to an unknown constant within the encoder's step.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from seqid_cli.identify.imu_calibration.readings import Readings, readings_of
from seqid_cli.logs.recording import Recording
from seqid_cli.motion.filters.bandwidth import encoder_step
from seqid_cli.motion.filters.butterworth import Lowpass
from seqid_cli.motion.filters.differentiation import SIDE, differentiate, runs, shrink
from seqid_cli.motion.motion import Motion, encoder_resolution
from seqid_cli.motion.smoother.encoder import EncoderView, encoder_view
from seqid_cli.robot.types import Imu, Robot
from seqid_cli.typing import Array, Index, Mask

REACH = SIDE  # nodes that a derivative takes
NODES_PER_CUTOFF = 6.0


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
    their position open by `offset_sigma` rad. `share` raw samples make a node; the differentiated
    encoder is trusted below `encoder_hz`.
    """

    log: int
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
    share: float
    cutoff_hz: float
    encoder_hz: float

    @property
    def samples(self) -> int:
        """Number of nodes with readings."""
        return len(self.t)

    @property
    def channels(self) -> int:
        """Number of channels."""
        return int(self.readings.values.shape[1])


def thinned(segments: list[Segment], *, max_nodes: int = 60_000) -> list[Segment]:
    """Segments that a fit can hold at once, evenly chosen where there are too many."""
    total = sum(segment.samples for segment in segments)
    return segments[:: int(np.ceil(total / max_nodes))]


def calibration_cutoff(motion: Motion, chosen_hz: float | None, *, highest_hz: float = 20) -> float:
    """Cut-off [Hz] for readings and encoders: far above the motion, far below the rate."""
    wanted = highest_hz if chosen_hz is None else chosen_hz
    return min(wanted, motion.rate_hz / NODES_PER_CUTOFF)


def segments_of(
    recording: Recording, robot: Robot, imu: Imu, motion: Motion, *, log: int, cutoff_hz: float
) -> list[Segment]:
    """Cut one log into stretches of the calibration.

    `motion`: of the same recording, for what moves and how fast. `log`: number of the log among
    those of the calibration. `cutoff_hz`: of the low-pass on readings and encoders. Returns: empty
    where nothing before the IMU moves long enough.
    """
    lowpass = Lowpass(cutoff_hz, recording.rate_hz)
    steps = encoder_resolution(robot)
    steps = np.where(steps > 0, steps, encoder_step(recording.q))
    joints = range(imu.after_joint + 1)
    views = [encoder_view(recording.q[:, j], float(steps[j])) for j in joints]
    smooth = lowpass(recording.q, recording.valid)
    source = _Source(
        recording=recording,
        motion=motion,
        smooth=smooth,
        speed=differentiate(smooth, recording.rate_hz, recording.valid)[0],
        views=views,
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
    """A log and what is computed from it once; a view for each joint before the IMU."""

    recording: Recording
    motion: Motion
    smooth: Array
    speed: Array
    views: list[EncoderView]
    readings: Readings
    lowpass: Lowpass
    log: int


def _pieces(
    usable: Mask, rate_hz: float, *, longest_s: float = 20.0, shortest_s: float = 0.3
) -> Iterator[slice]:
    for start, stop in runs(usable, len(usable)):
        count = max(1, int(np.ceil((stop - start) / (longest_s * rate_hz))))
        edges = np.linspace(start, stop, count + 1).astype(int)
        for a, b in pairwise(edges):
            if b - a > shortest_s * rate_hz:
                yield slice(int(a), int(b))


def _segment(source: _Source, own: slice, *, min_offset: float = 1e-4) -> Segment | None:
    """One stretch; offsets of locked joints below `min_offset` rad are worth no unknown."""
    recording, rate, views = source.recording, source.recording.rate_hz, source.views
    every = max(1, int(rate / (NODES_PER_CUTOFF * source.lowpass.cutoff_hz)))
    nodes = np.arange(own.start + REACH * every, own.stop - REACH * every, every)
    if len(nodes) < 4 * REACH:
        return None
    wide = np.arange(nodes[0] - REACH * every, nodes[-1] + REACH * every + 1, every)
    moves: Mask = np.any(source.motion.moving[own], axis=0)
    moving = tuple(j for j, view in enumerate(views) if moves[j] or _hunts(view, rate, own))
    resting = tuple(j for j in range(len(views)) if j not in moving)
    q = source.smooth[nodes].copy()
    dq, ddq = np.zeros_like(q), np.zeros_like(q)
    for j in resting:
        still = _locked_motion(recording.q[:, j], recording, views[j])
        q[:, j], dq[:, j], ddq[:, j] = (x[nodes] for x in still)
    off = {j: float(np.sqrt(views[j].step ** 2 / 12 + views[j].white)) for j in resting}
    locked = tuple(j for j in resting if off[j] > min_offset)
    return Segment(
        log=source.log,
        t=recording.t[nodes],
        spacing=every / rate,
        q=q,
        dq=dq,
        ddq=ddq,
        moving=moving,
        start=source.smooth[wide][:, list(moving)],
        encoders=tuple(_encoder_rows(source, j, wide, own) for j in moving),
        jerk=np.full(len(moving), _jerk(source.motion.ddq[own], rate)),
        locked=locked,
        offset_sigma=np.array([off[j] for j in locked]),
        readings=source.readings,
        share=float(every),
        cutoff_hz=source.lowpass.cutoff_hz,
        encoder_hz=source.motion.cutoff.hz,
    )


def _jerk(ddq: Array, rate_hz: float, *, slack: float = 3.0) -> float:
    """Standard deviation that moving joints' jerks are given, rad/s^3."""
    # Joints push each other: one that hunts within a few counts jerks as the others do, whatever
    # its encoder shows of it.
    rms = np.sqrt(np.mean((np.diff(ddq, axis=0) * rate_hz) ** 2, axis=0))
    return max(slack * float(np.max(rms)), 1.0)


def _hunts(view: EncoderView, rate_hz: float, own: slice) -> bool:
    """Whether a joint leaves a code of an encoder that is too coarse to show how."""
    return _still_hz(view, rate_hz) == 0.0 and bool(np.ptp(view.q[own]) > 0.0)


def _still_hz(
    view: EncoderView, rate_hz: float, *, noise: float = 0.01, lowest_hz: float = 3.0
) -> float:
    """Cut-off up to which an encoder shows a locked joint's acceleration to `noise` rad/s^2."""
    # Zero below `lowest_hz`, where it is not followed.
    density = (view.step**2 / 12 + view.white) * 2 / rate_hz
    hz = float((5 * noise**2 / (max(density, 1e-24) * (2 * np.pi) ** 4)) ** 0.2)
    return hz if hz >= lowest_hz else 0.0


def _locked_motion(q: Array, recording: Recording, view: EncoderView) -> tuple[Array, ...]:
    """What a locked joint does: no more than its encoder shows of it without its noise."""
    rate = recording.rate_hz
    hz = min(_still_hz(view, rate), rate / NODES_PER_CUTOFF)
    lowpass = Lowpass(hz or 1.0, rate)
    if not hz or len(q) <= 4 * lowpass.settling:
        mean = np.full(len(q), float(np.mean(q[recording.valid])))
        return mean, np.zeros(len(q)), np.zeros(len(q))
    smooth = lowpass(q, recording.valid)
    return smooth, *differentiate(smooth, rate, recording.valid)


def _encoder_rows(
    source: _Source, j: int, wide: Index, own: slice, *, repeated: float = 2.0
) -> EncoderRows:
    """Rows of one moving joint; a coarse encoder by its edges, a fine one by what is low-passed."""
    # Swings that repeat themselves repeat their quantisation errors, so many times.
    rate, view = source.recording.rate_hz, source.views[j]
    strongest = float(np.max(np.abs(source.motion.ddq[own, j])))
    # What the low-pass takes off a jump of the acceleration.
    rounding = strongest / (2 * np.pi * source.lowpass.cutoff_hz) ** 2
    if view.step / np.sqrt(12) < rounding or not np.isfinite(view.edge).any():
        return _fine_rows(source.smooth[wide, j], source.speed[wide, j], view, wide, rate)
    samples, edges = view.weights(source.speed[:, j], 1.0 / rate)
    index = np.arange(len(view.q), dtype=np.float64)
    places = np.concatenate([index, index + 0.5])
    information = np.concatenate([samples, edges]) / repeated
    information = information / (1.0 + information * (0.1 * rounding) ** 2)
    value = np.concatenate([view.q, view.edges])
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
    weights = np.eye(4)[np.arange(count) - at]
    return EncoderRows(at, weights, smooth, every / (variance * alike))


def lagrange(u: Array) -> Array:
    """Weights (M, 4) of a cubic through nodes 0..3 at `u` (M,)."""
    a, b, c, d = u, u - 1, u - 2, u - 3
    return np.column_stack([-b * c * d / 6, a * c * d / 2, -a * b * d / 2, a * b * c / 6])
