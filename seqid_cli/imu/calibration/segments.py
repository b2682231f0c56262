"""Data of a log for the IMU calibration: readings, and encoders with their errors.

Readings are cleaned of spikes and saturation. They and the encoders pass the same
zero-phase low-pass and are kept on nodes a few to a period of its cut-off. A moving
joint's position at the nodes is an unknown of the fit, which the encoder measures: a
fine one by its low-passed codes, a coarse one by the edges that it crosses, and a code
that lasts counts once however many samples repeat it. A locked joint keeps the mean of
its codes up to an unknown constant within its step.
"""

from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise

import numpy as np
from scipy.interpolate import BSpline, make_interp_spline
from scipy.sparse import bsr_array, coo_array, csr_array, diags_array, eye_array, kron

from seqid_cli.imu.smoother.chunk import JERK, EncoderView, bridged, encoder_view
from seqid_cli.imu.smoother.imus import clipped
from seqid_cli.logs.recording import Recording
from seqid_cli.motion.filters import differentiation
from seqid_cli.motion.filters.bandwidth import encoder_step
from seqid_cli.motion.filters.butterworth import Lowpass
from seqid_cli.motion.filters.differentiation import FIRST, SECOND, SIDE, differentiate
from seqid_cli.motion.motion import Motion, encoder_resolution
from seqid_cli.robot.types import Imu, Robot
from seqid_cli.robust import DIFFERENCES, gaussian_spread, rough, white_noise
from seqid_cli.running import dilated, median_of_five
from seqid_cli.typing import Array, Index, Mask


@dataclass(frozen=True, kw_only=True)
class Readings:
    """Low-passed readings (N0, C) at the log's own rate, to be read at any time."""

    t: Array
    values: Array
    good: Mask  # (N0, C)
    noise: Array  # (C,) standard deviation of one raw sample
    rough: Array  # (N0, C) of raw readings near the Nyquist rate, NaN where not known
    curve: BSpline

    @property
    def jolts(self) -> float:
        """The variance of all channels together by roughness beyond white noise."""
        # Jolts faster than the log's rate alias: samples do not add up to the motion
        # between them.
        known = self.rough[np.isfinite(self.rough).all(axis=1)]
        if not len(known):
            return 0.0
        excess = np.mean(known**2, axis=0) - gaussian_spread(known) ** 2
        return float(np.sum(np.maximum(excess, 0.0)))

    @property
    def period(self) -> float:
        """The time between samples [s]."""
        return float((self.t[-1] - self.t[0]) / (len(self.t) - 1))

    def at(self, t: Array) -> tuple[Array, Mask]:
        """Return readings (N, C) at times `t` [s] of their stamps, and which count."""
        inside = (t >= self.t[0]) & (t <= self.t[-1])
        values = self.curve(np.clip(t, self.t[0], self.t[-1]))
        return np.asarray(values), self.good[self.near(t)] & inside[:, None]

    def near(self, t: Array) -> Index:
        """Return the numbers (N,) of the samples next to times `t` [s]."""
        return np.clip(
            np.searchsorted(self.t, t - 0.5 * self.period), 0, len(self.t) - 1
        )


def readings_of(recording: Recording, imu: Imu, lowpass: Lowpass) -> Readings:
    """Clean and low-pass one log's channels of an IMU, accelerometers first."""
    raw = recording.accelerometers.get(imu.name, np.zeros((len(recording.t), 0)))
    if imu.gyro and imu.name in recording.gyros:
        raw = np.hstack([raw, recording.gyros[imu.name]])
    values, bad = cleaned(raw, recording.valid)
    reach = max(1, round(0.4 * recording.rate_hz / lowpass.cutoff_hz))
    spread = dilated(bad, reach)
    smooth = lowpass(values, recording.valid)
    curve = make_interp_spline(recording.t, smooth, k=3)
    # Jolts are in most channels at once; what jumps in one by itself is bridged.
    together = (bad.mean(axis=1) > 0.5)[:, None] & np.isfinite(raw)
    roughness = np.full(values.shape, np.nan)
    half = DIFFERENCES // 2
    if len(values) > DIFFERENCES:
        known = np.lib.stride_tricks.sliding_window_view(
            recording.valid, DIFFERENCES + 1
        )
        jolted = rough(np.where(together, raw, values))
        is_valid = np.all(known, axis=1, keepdims=True)
        roughness[half:-half] = np.where(is_valid, jolted, np.nan)
    return Readings(
        t=recording.t,
        values=smooth,
        good=~spread,
        noise=white_noise(values),
        rough=roughness,
        curve=curve,
    )


def cleaned(
    values: Array, valid: Mask, *, min_spike: float = 8.0
) -> tuple[Array, Mask]:
    """Return readings (N, C) with bad ones bridged, and where these were.

    Bad are spikes, saturation and missing values.
    """
    # A spike stands out of the median of its neighbours by `min_spike` times the noise.
    finite = np.isfinite(values)
    values = np.where(finite, values, 0.0)
    bad = ~finite | ~valid[:, None]
    middle = median_of_five(values, beyond="edge")
    off = np.abs(values - middle)
    motion = np.abs(np.gradient(middle, axis=0)) if len(values) > 1 else off
    noise = np.maximum(white_noise(values), 1e-9)
    bad |= off > min_spike * noise + 4.0 * motion
    bad |= clipped(values, ~bad, noise)
    whole = bad.all(axis=0)  # nothing to bridge it with
    mended = [bridged(v, ~b) for v, b in zip(values.T, (bad & ~whole).T, strict=True)]
    return np.column_stack(mended), bad


REACH = SIDE  # nodes that a derivative takes
NODES_PER_CUTOFF = 6.0


@dataclass(frozen=True, kw_only=True)
class Measurements:
    """M measurements of one joint: weighted sums of its positions at four nodes."""

    at: Index  # (M,) first of the four nodes
    weights: Array  # (M, 4)
    value: Array  # (M,) rad, or rad/s^3 of the prior on the jerk
    information: Array  # (M,) inverse variance


@dataclass(frozen=True, kw_only=True)
class _Rows:
    """Measurements of all moving joints as rows times the positions at the nodes."""

    rows: csr_array
    value: Array
    information: Array
    at: Index


@dataclass(frozen=True, kw_only=True)
class Segment:
    """A stretch of one log on nodes `t` (N,) s, which begin `origin_s` into the log.

    `motion` (3, n, N) are q, dq, ddq of all joints; those of the m `moving` ones are to
    be replaced by the unknowns, positions at N + 2 REACH nodes that start at `start`.
    Row by row `rows` times them, node by node, is the measured `value` (M,), by an
    encoder or by a loose prior on the jerk, known to `information` (M,); `at` (M,) is
    the node. `locked` joints are those at rest whose encoder leaves their position open
    by `offset_sigma` rad. `share` raw samples make a node; the differentiated encoder
    is trusted below `encoder_hz`. `by_edges`: an encoder is so coarse that the instants
    at which it crosses its edges are what it tells.
    """

    log: int
    t: Array
    origin_s: float
    spacing: float
    motion: Array
    moving: tuple[int, ...]
    start: Array
    rows: csr_array
    value: Array
    information: Array
    at: Index
    locked: tuple[int, ...]
    offset_sigma: Array
    readings: Readings
    share: float
    cutoff_hz: float
    encoder_hz: float
    by_edges: bool

    @property
    def samples(self) -> int:
        """The number of nodes with readings."""
        return len(self.t)

    @property
    def elapsed(self) -> Array:
        """The nodes' seconds (N,) since the log began."""
        return self.t + self.origin_s

    @cached_property
    def at_samples(self) -> csr_array:
        """The matrix from positions at the nodes to q, dq, ddq at the samples.

        Its N * 3 * m rows are those of the moving joints.
        """
        size = self.samples
        width = 2 * REACH + 1
        spacing = self.spacing
        weights = np.stack([np.eye(width)[REACH], FIRST / spacing, SECOND / spacing**2])
        rows = np.repeat(np.arange(3 * size), width)
        columns = np.arange(size)[:, None, None] + np.tile(np.arange(width), (3, 1))
        place = (np.tile(weights, (size, 1, 1)).ravel(), (rows, columns.ravel()))
        joint_matrix = coo_array(place, shape=(3 * size, size + 2 * REACH))
        return csr_array(kron(joint_matrix, eye_array(len(self.moving))))

    @cached_property
    def normal(self) -> csr_array:
        """The information of the rows on positions at the nodes, joints interleaved."""
        return csr_array(self.rows.T @ diags_array(self.information) @ self.rows)

    def band(self, blocks: Array) -> Array:
        """Return the lower band of the information on the positions at the nodes.

        `blocks` (N, 3 m, 3 m) are the information of the samples on q, dq, ddq.
        """
        count = np.arange(len(blocks) + 1)
        inner = bsr_array((blocks, count[:-1], count)).tocsr()
        information = (
            self.normal + self.at_samples.T @ inner @ self.at_samples
        ).tocoo()
        below = information.row >= information.col
        row = information.row[below]
        column = information.col[below]
        band = np.zeros(((2 * REACH + 1) * len(self.moving), information.shape[0]))
        band[row - column, column] = information.data[below]
        return band


def thinned(segments: list[Segment], *, max_nodes: int = 60_000) -> list[Segment]:
    """Return the segments that a fit can hold at once, evenly chosen among all."""
    n_nodes = sum(segment.samples for segment in segments)
    return segments[:: int(np.ceil(n_nodes / max_nodes))]


def calibration_cutoff(
    motion: Motion, chosen_hz: float | None, highest_hz: float
) -> float:
    """Return the cut-off [Hz] for readings and encoders.

    It is far above the motion and far below the rate.
    """
    wanted_hz = highest_hz if chosen_hz is None else chosen_hz
    return min(wanted_hz, motion.rate_hz / NODES_PER_CUTOFF)


def segments_of(
    recording: Recording,
    robot: Robot,
    imu: Imu,
    motion: Motion,
    *,
    log: int,
    cutoff_hz: float,
    longest_s: float = 20.0,
    shortest_s: float = 0.3,
) -> list[Segment]:
    """Cut one log into segments of `shortest_s` to `longest_s` seconds."""
    lowpass = Lowpass(cutoff_hz, recording.rate_hz)
    steps = encoder_resolution(robot)
    steps = np.where(steps > 0, steps, encoder_step(recording.q))
    views = [
        encoder_view(recording.q[:, j], float(steps[j]))
        for j in range(imu.after_joint + 1)
    ]
    source = _Log(
        number=log,
        recording=recording,
        motion=motion,
        lowpass=lowpass,
        views=views,
        readings=readings_of(recording, imu, lowpass),
    )
    # Ends that feel the filter's own ends are not used.
    usable = differentiation.shrink(recording.valid, lowpass.settling // 2)
    segments = []
    for start, stop in differentiation.runs(usable, len(usable)):
        count = max(1, int(np.ceil((stop - start) / (longest_s * recording.rate_hz))))
        for a, b in pairwise(np.linspace(start, stop, count + 1).astype(int).tolist()):
            if not b - a > shortest_s * recording.rate_hz:
                continue
            segment = source.segment(slice(a, b))
            if segment is not None:
                segments.append(segment)
    return segments


@dataclass(frozen=True, kw_only=True)
class _Log:
    """A log and what is computed from it once; a view for each joint before the IMU."""

    number: int
    recording: Recording
    motion: Motion
    lowpass: Lowpass
    views: list[EncoderView]
    readings: Readings

    @cached_property
    def smooth(self) -> Array:
        """The positions (N, n) after the low-pass."""
        return self.lowpass(self.recording.q, self.recording.valid)

    @cached_property
    def speed(self) -> Array:
        """The rate of change (N, n) of these positions."""
        return differentiate(self.smooth, self.recording.rate_hz, self.recording.valid)[
            0
        ]

    def segment(
        self, stretch: slice, *, min_offset: float = 1e-4, slack: float = 3
    ) -> Segment | None:
        """Return one segment, or None where it has too few nodes.

        Offsets of locked joints below `min_offset` rad are no unknowns.
        """
        # Moving joints are given jerks of `slack` times the largest RMS, all alike:
        # joints push each other, and one that hunts within a few counts jerks whatever
        # its encoder shows of it.
        rate = self.recording.rate_hz
        views = self.views
        stride = max(1, int(rate / (NODES_PER_CUTOFF * self.lowpass.cutoff_hz)))
        nodes = np.arange(
            stretch.start + REACH * stride, stretch.stop - REACH * stride, stride
        )
        if len(nodes) < 4 * REACH:
            return None
        wide = np.arange(
            nodes[0] - REACH * stride, nodes[-1] + REACH * stride + 1, stride
        )

        moves: Mask = np.any(self.motion.moving[stretch], axis=0)
        # A joint that leaves a code of an encoder too coarse to show how counts as
        # moving.
        hunts = [
            _still_hz(v, rate) == 0.0 and bool(np.ptp(v.q[stretch]) > 0.0)
            for v in views
        ]
        moving = [j for j in range(len(views)) if moves[j] or hunts[j]]
        resting = [j for j in range(len(views)) if j not in moving]

        motion = np.zeros((3, self.smooth.shape[1], len(nodes)))
        motion[0] = self.smooth[nodes].T
        for j in resting:
            motion[:, j] = self._at_rest(j)[:, nodes]
        off = {
            j: float(np.sqrt(views[j].step ** 2 / 12 + views[j].white)) for j in resting
        }
        locked = tuple(j for j in resting if off[j] > min_offset)

        jerks = np.sqrt(
            np.mean((np.diff(self.motion.ddq[stretch], axis=0) * rate) ** 2, axis=0)
        )
        jerk = max(slack * float(np.max(jerks)), 1.0)
        third = JERK * (rate / stride) ** 3
        at = np.arange(len(wide) - 3)
        smooth = Measurements(
            at=at,
            weights=np.tile(third, (len(at), 1)),
            value=np.zeros(len(at)),
            information=np.full(len(at), jerk**-2),
        )
        parts: list[Measurements] = []
        for j in moving:
            parts.append(self._measured(j, wide, stretch))
            parts.append(smooth)
        stacked = _stacked(parts, len(wide), len(moving))

        return Segment(
            log=self.number,
            t=self.recording.t[nodes],
            origin_s=self.recording.offset,
            spacing=stride / rate,
            motion=motion,
            moving=tuple(moving),
            start=self.smooth[wide][:, moving],
            rows=stacked.rows,
            value=stacked.value,
            information=stacked.information,
            at=stacked.at,
            locked=locked,
            offset_sigma=np.array([off[j] for j in locked]),
            readings=self.readings,
            share=float(stride),
            cutoff_hz=self.lowpass.cutoff_hz,
            encoder_hz=self.motion.cutoff.hz,
            by_edges=any(self._by_edges(j, stretch) for j in moving),
        )

    def _rounding(self, j: int, stretch: slice) -> float:
        """Return how far the low-pass rounds off a jump of the acceleration [rad]."""
        strongest = float(np.max(np.abs(self.motion.ddq[stretch, j])))
        return strongest / (2 * np.pi * self.lowpass.cutoff_hz) ** 2

    def _by_edges(self, j: int, stretch: slice) -> bool:
        """Return whether only the edges of a joint's encoder tell its position."""
        view = self.views[j]
        fine = view.step / np.sqrt(12) < self._rounding(j, stretch)
        return not fine and bool(np.isfinite(view.edge).any())

    def _at_rest(self, j: int) -> Array:
        """Return q, dq, ddq (3, N) of a locked joint, as its encoder shows them."""
        rate = self.recording.rate_hz
        q = self.recording.q[:, j]
        valid = self.recording.valid
        hz = min(_still_hz(self.views[j], rate), rate / NODES_PER_CUTOFF)
        lowpass = Lowpass(hz or 1.0, rate)
        if not hz or len(q) <= 4 * lowpass.settling:
            return np.outer([1.0, 0.0, 0.0], np.full(len(q), np.mean(q[valid])))
        smooth = lowpass(q, valid)
        return np.stack([smooth, *differentiate(smooth, rate, valid)])

    def _measured(
        self, j: int, wide: Index, stretch: slice, *, repeated: float = 2.0
    ) -> Measurements:
        """Return the rows of a moving joint.

        A coarse encoder measures by its edges, a fine one by its low-passed codes.
        """
        # Swings that repeat themselves repeat their quantisation errors, so many times.
        rate = self.recording.rate_hz
        view = self.views[j]
        stride = int(wide[1] - wide[0])
        count = len(wide)
        if not self._by_edges(j, stretch):
            # One row per node, as good as all the samples it stands for, if their codes
            # differ.
            variance = max(view.step**2 / 12 + view.white, 1e-16)
            slow = np.abs(self.speed[wide, j]) / rate * stride < view.step
            n_alike = np.where(slow, np.maximum(view.dwell[wide], 1.0), 1.0)
            at = np.clip(np.arange(count) - 1, 0, count - 4)
            weights = np.eye(4)[np.arange(count) - at]
            return Measurements(
                at=at,
                weights=weights,
                value=self.smooth[wide, j],
                information=stride / (variance * n_alike),
            )

        samples, edges = view.weights(self.speed[:, j], 1.0 / rate)
        index = np.arange(len(view.q), dtype=np.float64)
        places = np.concatenate([index, index + 0.5])
        information = np.concatenate([samples, edges]) / repeated
        information = information / (
            1.0 + information * (0.1 * self._rounding(j, stretch)) ** 2
        )
        value = np.concatenate([view.q, np.nan_to_num(view.edge)])
        is_inside = (places >= wide[0]) & (places <= wide[-1])
        is_used = (information > 0) & is_inside
        u = (places[is_used] - wide[0]) / stride
        at = np.clip(np.floor(u).astype(np.intp) - 1, 0, count - 4)
        cubic = np.vander(u - at, 4) @ np.linalg.inv(np.vander(np.arange(4.0), 4))
        return Measurements(
            at=at,
            weights=cubic,
            value=value[is_used],
            information=information[is_used],
        )


def _stacked(parts: list[Measurements], nodes: int, m: int) -> _Rows:
    """Return the rows of two parts for each of m moving joints."""
    # Nothing can be concatenated where no joint moves.
    nothing = Measurements(
        at=np.zeros(0, dtype=np.intp),
        weights=np.zeros((0, 4)),
        value=np.zeros(0),
        information=np.zeros(0),
    )
    joint = np.repeat(np.arange(len(parts)) // 2, [len(part.at) for part in parts])
    parts = [nothing, *parts]
    at = np.concatenate([part.at for part in parts])
    weights = np.concatenate([part.weights for part in parts])

    columns = (at[:, None] + np.arange(4)) * m + joint[:, None]
    place = np.repeat(np.arange(len(at)), 4), columns.ravel()
    rows = csr_array(coo_array((weights.ravel(), place), shape=(len(at), nodes * m)))
    return _Rows(
        rows=rows,
        value=np.concatenate([part.value for part in parts]),
        information=np.concatenate([part.information for part in parts]),
        at=np.clip(at + 1 - REACH, 0, nodes - 2 * REACH - 1),
    )


def _still_hz(
    view: EncoderView, rate_hz: float, *, noise: float = 0.01, lowest_hz: float = 3.0
) -> float:
    """Return the cut-off [Hz] up to which a locked joint's encoder is followed.

    Up to it the encoder shows the acceleration to `noise` rad/s^2. It is zero where it
    would be below `lowest_hz`.
    """
    density = (view.step**2 / 12 + view.white) * 2 / rate_hz
    hz = float((5 * noise**2 / (max(density, 1e-24) * (2 * np.pi) ** 4)) ** 0.2)
    return hz if hz >= lowest_hz else 0.0
