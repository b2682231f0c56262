"""The low-pass cut-off by the posterior: it has the least error of predicted torque.

Every cut-off keeps the equation exact and another share of its information. A low one
throws away what quick motion says, and the samples around every reversal; a high one
lets the noise of a differentiated encoder into the regressor, and what the model lacks.
With C(f) the covariance of the parameters below a cut-off f, by the jackknife over the
log's own blocks and by friction's errors, and W the mean of H' D H over the logs'
motion (D: one over the torque's noise, squared) below one fixed cut-off, the same for
all, of the nuisance terms nothing,

    E(f) = tr(W C(f))

is the mean square of the predicted torque's error in units of its noise, as a plan
minimises it (`plan.stages.goal`). A jackknife does not see a bias that is the same in
all blocks. Hence a cut-off is *admissible* only where

- the excited directions are as many as anywhere, and below the start independent
  samples are several times as many (blocks of a slow signal are not independent: what
  is left out is known from both sides),
- noise makes up a small share N / S of the acceleration of every joint that moves,
- the parameters agree with those at a neighbouring cut-off, by size of effect: what
  their difference d makes of the torque beyond its own noise, d' W d - tr(W V) with V
  the covariance of the difference, is a small share of the torque's mean square. A test
  of significance would be too sharp: with enough samples every model differs somewhere.

Cut-offs are tried an octave apart, from a starting one outward as long as the error
falls, then half an octave to either side of the best. Of those that are nearly the
best, or worse by no more than the scatter over the blocks explains, the one nearest to
the start is taken: few blocks say little of many parameters.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from functools import reduce
from typing import Protocol

import numpy as np

from seqid_cli.errors import InputError
from seqid_cli.identify.options import InertiaOptions
from seqid_cli.identify.regression import equations
from seqid_cli.identify.regression.least_squares import Accumulator, Solution, spread_of
from seqid_cli.identify.rigid.inertia_equations import InertiaEquations
from seqid_cli.identify.rigid.simultaneous_equations import SimultaneousEquations
from seqid_cli.identify.settings import CutoffSettings, InertiaSettings
from seqid_cli.logs.recording import Recording
from seqid_cli.motion.motion import Motion
from seqid_cli.motion.options import MotionOptions
from seqid_cli.params.schema import ImuStage, Stages
from seqid_cli.robot.types import Robot
from seqid_cli.typing import Array, Mask

SAMPLES_PER_CUTOFF = 4.0  # that stay for a choice: twice what the low-pass lets through


@dataclass(frozen=True, kw_only=True)
class Candidate:
    """What some logs tell of p parameters below one cut-off.

    Attributes
    ----------
    theta, determined : Array, shape (p,)
        Estimate, and which parameters the logs tell apart from others.
    covariance : Array, shape (p, p)
        Of the estimate.
    moves : Array, shape (G, p)
        Moves of the estimate without one block of time.
    information : Array, shape (p, p)
        Mean of H' D H over the samples, D one over the torque noise's variance.
    torque_square : float
        Mean square of the joints' torque in units of their noise [-].
    rank : int
        Number of excited directions.
    independent : float
        Samples of the logs that count as independent, whatever number of joints they
        tell of.
    """

    cutoff_hz: float
    theta: Array
    determined: Mask
    covariance: Array
    moves: Array
    information: Array
    torque_square: float
    rank: int
    independent: float


class Trial(Protocol):
    """Whoever identifies: tries a cut-off on some recordings."""

    def __call__(
        self, recordings: Sequence[Recording], cutoff_hz: float
    ) -> Candidate | None:
        """Return the candidate at a cut-off [Hz], None where it is too low."""


@dataclass(frozen=True, kw_only=True)
class CutoffChoice:
    """The chosen cut-off [Hz], the start, and the tried cut-offs in ascending order."""

    cutoff_hz: float
    start_hz: float
    tried: list[Candidate] = field(repr=False)
    errors: Array  # tr(W C) of those tried
    admissible: Mask


def choose_cutoff(
    trial: Callable[[float], Candidate | None],
    start_hz: float,
    *,
    lowest_hz: float,
    highest_hz: float,
    acceleration_noise: Callable[[float], float],
    represented: float = 1.0,
    limits: CutoffSettings = CutoffSettings(),
) -> CutoffChoice:
    """Choose the cut-off with the smallest error of the predicted torque.

    Parameters
    ----------
    trial : callable
        Tries a cut-off [Hz].
    start_hz : float
        Where the search begins, and what is kept where nothing else is clearly better
        [Hz].
    lowest_hz, highest_hz : float
        Range of cut-offs, apart from the start [Hz].
    acceleration_noise : callable
        Share of noise in the acceleration below a cut-off [Hz], of the worst joint.
    represented : float
        Length of all logs over that of the recordings that are tried [-].
    limits : CutoffSettings
        What makes a cut-off admissible.
    """
    tried: dict[float, Candidate] = {}

    def reach(hz: float) -> bool:
        """Try a cut-off; whether going on in this direction may bring something."""
        if not lowest_hz <= hz <= highest_hz or hz in tried:
            return False
        # Noise grows with the fifth power: what is above an inadmissible cut-off is so
        # as well.
        if hz > start_hz and acceleration_noise(hz) > limits.max_acceleration_noise:
            return False
        candidate = trial(hz)
        if candidate is None:
            return False
        tried[hz] = candidate
        errors, _ = _judged(list(tried.values()), start_hz)
        return bool(errors[-1] <= limits.hopeless * errors.min())

    first = trial(start_hz)
    if first is not None:
        tried[start_hz] = first
    for factor in (0.5, 2.0):
        hz = factor * start_hz
        while reach(hz):
            hz *= factor

    def chosen() -> CutoffChoice:
        candidates = sorted(tried.values(), key=lambda candidate: candidate.cutoff_hz)
        return _chosen(candidates, start_hz, acceleration_noise, represented, limits)

    if not tried:
        nothing = np.zeros(0)
        return CutoffChoice(
            cutoff_hz=start_hz,
            start_hz=start_hz,
            tried=[],
            errors=nothing,
            admissible=nothing.astype(bool),
        )
    octaves = chosen()
    best = _best(octaves)
    for factor in (0.5, 2.0):
        if best in tried and _promises(octaves, best, factor):
            reach(float(np.sqrt(factor) * best))
    return chosen()


def _best(choice: CutoffChoice) -> float:
    """Return the admissible cut-off with the least error [Hz], or the start."""
    if not choice.admissible.any():
        return choice.start_hz
    errors = np.where(choice.admissible, choice.errors, np.inf)
    return choice.tried[int(np.argmin(errors))].cutoff_hz


def _promises(choice: CutoffChoice, best_hz: float, factor: float) -> bool:
    """Return whether half an octave beside the best may be better than the best.

    By the parabola of the error's logarithm through the best, the octave beside it
    (`factor` times the best), and the one on its other side or the next one. True where
    these were not tried.
    """
    log_errors = {
        candidate.cutoff_hz: float(np.log(max(error, 1e-300)))
        for candidate, error in zip(choice.tried, choice.errors, strict=True)
    }
    best = log_errors[best_hz]
    beside = log_errors.get(factor * best_hz)
    behind = log_errors.get(best_hz / factor)
    beyond = log_errors.get(factor**2 * best_hz)
    if beside is None:
        return True
    if behind is not None:
        curvature = behind - 2.0 * best + beside
    elif beyond is not None:
        curvature = best - 2.0 * beside + beyond
    else:
        return True
    return (best + beside) / 2.0 - curvature / 8.0 < best


def _chosen(
    tried: list[Candidate],
    start_hz: float,
    acceleration_noise: Callable[[float], float],
    represented: float,
    limits: CutoffSettings,
) -> CutoffChoice:
    """Choose among candidates in ascending order."""
    errors, W = _judged(tried, start_hz)
    highest_rank = max(candidate.rank for candidate in tried)

    def has_enough_samples(candidate: Candidate) -> bool:
        # The start leaves what the arm's parameters need already
        # (`bandwidth.highest_of`).
        independent = represented * candidate.independent
        return (
            candidate.cutoff_hz >= start_hz
            or independent >= limits.min_samples_per_rank * candidate.rank
        )

    admissible = np.array(
        [
            candidate.rank == highest_rank
            and has_enough_samples(candidate)
            and acceleration_noise(candidate.cutoff_hz) <= limits.max_acceleration_noise
            for candidate in tried
        ]
    )
    agrees = _agrees(tried, W, limits.max_disagreement)
    if (admissible & agrees).any():
        admissible &= agrees

    choice = CutoffChoice(
        cutoff_hz=start_hz,
        start_hz=start_hz,
        tried=tried,
        errors=errors,
        admissible=admissible,
    )
    if not admissible.any():
        return choice

    best = int(np.argmin(np.where(admissible, errors, np.inf)))
    good = []
    for k in np.flatnonzero(admissible):
        std_error = _standard_error(tried[k], tried[best], W)
        least_error = errors[best]
        if errors[k] <= max(
            limits.nearly_best * least_error,
            least_error + limits.clear_sigma * std_error,
        ):
            good.append(tried[k].cutoff_hz)
    nearest = min(good, key=lambda hz: abs(np.log(hz / start_hz)))
    return replace(choice, cutoff_hz=nearest)


def _standard_error(first: Candidate, second: Candidate, W: Array) -> float:
    """Return the standard error of two errors' difference, 0 where blocks differ.

    Each block of time adds m' W m to an error, m its move of the estimate. Both
    candidates have the same blocks, so that the scatter of the differences says how
    sure their sum is.
    """
    if first.moves.shape != second.moves.shape or len(first.moves) < 2:
        return 0.0
    parts = [
        np.einsum("gp,pq,gq->g", candidate.moves, W, candidate.moves)
        for candidate in (first, second)
    ]
    differences = parts[0] - parts[1]
    return float(np.sqrt(len(differences)) * differences.std(ddof=1))


def _judged(tried: Sequence[Candidate], start_hz: float) -> tuple[Array, Array]:
    """Return the error tr(W C) of each candidate, and W (p, p).

    W is the information below one cut-off, so that all are measured in one band: the
    one nearest to the start of those that excite most.
    """
    highest_rank = max(candidate.rank for candidate in tried)
    fullest = [candidate for candidate in tried if candidate.rank == highest_rank]
    reference = min(
        fullest, key=lambda candidate: abs(np.log(candidate.cutoff_hz / start_hz))
    )
    W = reference.information
    errors = [float(np.sum(W * candidate.covariance)) for candidate in tried]
    return np.array(errors), W


def _agrees(tried: Sequence[Candidate], W: Array, max_disagreement: float) -> Mask:
    """Return whether each candidate agrees with its next lower or higher one."""
    agrees = np.zeros(len(tried), dtype=bool)
    for k in range(len(tried) - 1):
        if disagreement(tried[k], tried[k + 1], W) <= max_disagreement:
            agrees[k : k + 2] = True
    return agrees if len(tried) > 1 else ~agrees


def disagreement(first: Candidate, second: Candidate, W: Array) -> float:
    """Return the difference of two estimates beyond noise.

    It is a share of the torque's RMS.
    """
    determined = first.determined & second.determined
    difference = np.where(determined, second.theta - first.theta, 0.0)
    if first.moves.shape == second.moves.shape:
        # Estimates of the same blocks share most of their noise.
        V = spread_of(second.moves - first.moves)
    else:
        V = first.covariance + second.covariance
    block = np.ix_(determined, determined)
    noise = np.sum(W[block] * V[block])
    excess = max(float(difference @ W @ difference - noise), 0.0)
    torque = max(first.torque_square, second.torque_square)
    return float(np.sqrt(excess / max(torque, 1e-300)))


def candidate_of(
    cutoff_hz: float,
    solution: Solution,
    covariance: Array,
    joints: Sequence[Accumulator],
    torque_squares: Array,
    independent: float,
    nuisances: slice,
) -> Candidate:
    """Describe a solution.

    Parameters
    ----------
    covariance : Array, shape (p, p)
        Of its parameters.
    joints : sequence of Accumulator
        The rows of each joint.
    torque_squares : Array, shape (n,)
        Sum of the squared torque over these rows [(N m)^2].
    independent : float
        Samples of the logs that count as independent.
    nuisances : slice
        Places of the nuisance terms, whose errors no prediction is judged by.
    """
    size = len(solution.theta)
    information = np.zeros((size, size))
    torque_square = 0.0
    for joint, sigma, square in zip(
        joints, solution.sigma, torque_squares, strict=True
    ):
        if not joint.samples:
            continue
        rows = joint.total[:, :-1] / sigma
        information += rows.T @ rows / joint.samples
        torque_square += float(square) / sigma**2 / joint.samples
    information[nuisances] = 0.0
    information[:, nuisances] = 0.0
    return Candidate(
        cutoff_hz=cutoff_hz,
        theta=solution.theta,
        determined=solution.determined,
        covariance=covariance,
        moves=solution.moves,
        information=information,
        torque_square=torque_square,
        rank=solution.rank,
        independent=independent,
    )


class _TrialEquations(InertiaEquations):
    """Equations whose rotors act on their own joints alone: enough for a trial."""

    def coupling_column(self, motion: Motion) -> Array:
        return np.zeros_like(motion.q)


class InertiaTrial:
    """Trials of cut-offs for the inertia stage."""

    def __init__(
        self,
        robot: Robot,
        stages: Stages,
        source: str,
        settings: InertiaSettings = InertiaSettings(),
    ) -> None:
        self._robot = robot
        self._stages = stages
        self._source = source
        self._settings = settings

    def __call__(
        self, recordings: Sequence[Recording], cutoff_hz: float
    ) -> Candidate | None:
        """Return what recordings tell below a cut-off; see `Trial`."""
        motion = MotionOptions(
            cutoff_hz=cutoff_hz, samples_per_cutoff=SAMPLES_PER_CUTOFF
        )
        options = InertiaOptions(
            motion=motion, source=self._source, settings=self._settings
        )
        trial_equations = _TrialEquations(
            self._robot, self._stages, options, only_compares=True
        )

        parts = []
        for recording in recordings:
            try:
                parts.append(trial_equations.rows_of(recording))
            except InputError:  # too short to be filtered so low
                continue
        if not parts or not any(
            joint.samples for part in parts for joint in part.joints
        ):
            return None

        rows = reduce(lambda a, b: a + b, parts)
        solution, posterior = trial_equations.solved(rows, 0.0, rounds=3)
        return candidate_of(
            cutoff_hz=cutoff_hz,
            solution=solution,
            covariance=posterior.covariance,
            joints=[joint.with_fixed(joint.size - 1, 0.0) for joint in rows.joints],
            torque_squares=rows.torque_squares,
            independent=float(rows.sample_counts[0]),
            nuisances=trial_equations.nuisances.all,
        )


class SimultaneousTrial:
    """Trials of cut-offs for classical least squares with friction's coefficients."""

    def __init__(
        self, robot: Robot, imu: ImuStage | None, source: str, *, offset: bool
    ) -> None:
        self._robot = robot
        self._imu = imu
        self._source = source
        self._offset = offset

    def __call__(
        self, recordings: Sequence[Recording], cutoff_hz: float
    ) -> Candidate | None:
        """Return what recordings tell below a cut-off; see `Trial`."""
        options = MotionOptions(
            cutoff_hz=cutoff_hz, samples_per_cutoff=SAMPLES_PER_CUTOFF
        )

        motions = []
        for recording in recordings:
            try:
                motion = equations.torque_motion(
                    recording, self._robot, options, imu=self._imu, source=self._source
                )
            except InputError:  # too short to be filtered so low
                continue
            motions.append(motion)
        if not motions:
            return None

        rows = SimultaneousEquations(self._robot, motions, offset=self._offset)
        if not any(joint.samples for joint in rows.joints):
            return None
        solution = rows.solved(rows.prior())
        return candidate_of(
            cutoff_hz=cutoff_hz,
            solution=solution,
            covariance=solution.covariance,
            joints=rows.joints,
            torque_squares=rows.torque_squares,
            independent=rows.independent * sum(motion.samples for motion in motions),
            nuisances=rows.nuisances,
        )
