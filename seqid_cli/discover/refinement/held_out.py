"""Errors on samples that were not fitted, block by block, and how sure a gain is.

A model is judged where joints slide: on the logs that it was fitted to, where its
stages are to be identified anew, and on the held-out logs, where the result is told.
With squared errors o_b before and n_b after in block b (Cochran, "Sampling Techniques",
1977, section 6),

    gain = 1 - r,   r = sum n / sum o,
    se^2 = B / (B - 1) sum (n_b - r o_b)^2 / (sum o)^2.

Neighbouring blocks may share their error: they are joined two by two, as long as enough
are left, and the largest interval counts (Flyvbjerg and Petersen, J. Chem. Phys. 91,
1989).

An effect is judged where the file's friction was identified. Beyond, friction is only
held or bent, and what that misses would hide what an effect gains, or pass for it. What
is gained there is told apart.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Literal, NamedTuple, cast

import numpy as np
from scipy.special import stdtrit

from seqid_cli.discover.select.rows import doubt_of
from seqid_cli.discover.survey.repeats import BLOCK_S
from seqid_cli.discover.survey.rows import MOST_OUTSIDE
from seqid_cli.effects.fitted import fitted_effects
from seqid_cli.identify.options import InertiaOptions
from seqid_cli.identify.prediction.predict import local_effects, predict
from seqid_cli.identify.regression.equations import streams
from seqid_cli.inspect.screening import read_screened, screened_long
from seqid_cli.logs.log_file import likely_rows
from seqid_cli.logs.long import LONG, LongLog, open_if_long
from seqid_cli.logs.reading import HEADER_STAMPS, Reading
from seqid_cli.logs.recording import Recording
from seqid_cli.logs.storage.remote import local_copy
from seqid_cli.model.torque import TorqueModel
from seqid_cli.motion.torque_noise import LEVEL
from seqid_cli.params.schema import JointRmse, Stages
from seqid_cli.robot.types import Robot
from seqid_cli.typing import Array, Index, Mask

FEWEST_BLOCKS = 8  # of joined blocks: with fewer their spread tells little
MOST_BLOCKS = 1000  # of a log that comes in parts
# Samples that count: where the identified friction decides, or beyond it.
Part = Literal["deciding", "beyond"]
# of a sum of squares: what rounding leaves of a difference of two sums is nothing
ROUNDING = 1e-12


class BlockErrors(NamedTuple):
    """Squared errors of a model, block by block, where a joint certainly slides.

    At rest the model says an interval: a wider one always fits better, and nothing is
    gained by it.

    Attributes
    ----------
    squares : (B, n) array
        Sum of the squared error of every block [(N m)^2; N^2 where prismatic].
    samples : (B, n) array
        Number of its samples.
    outside : (B, n) array
        The part of `squares` that lies beyond the friction that the file came in with.
    outside_samples : (B, n) array
        Number of its samples.
    """

    squares: Array
    samples: Array
    outside: Array
    outside_samples: Array

    @classmethod
    def zeros(cls, blocks: int, joints: int) -> BlockErrors:
        """Return sums of nothing yet, each (blocks, joints)."""
        return cls(
            squares=np.zeros((blocks, joints)),
            samples=np.zeros((blocks, joints)),
            outside=np.zeros((blocks, joints)),
            outside_samples=np.zeros((blocks, joints)),
        )

    @property
    def is_identified(self) -> Mask:
        """Joints (n,) that the samples within the identified friction decide on.

        A joint that is hardly ever within has none that do, as in the rows of the
        selection.
        """
        samples = self.samples.sum(axis=0)
        is_within = self.outside_samples.sum(axis=0) <= MOST_OUTSIDE * samples
        return np.asarray(is_within & (samples > 0))

    def rmse(self) -> Array:
        """Return the RMS error (n,) N m as `predict` does; NaN where none slides."""
        return _rms(self.squares, self.samples)

    def by_joint(self, names: Sequence[str]) -> dict[str, JointRmse]:
        """Return the errors of the joints that slide, by name.

        They are also told apart within and beyond the identified friction.
        """
        rmse = self.rmse()
        inside = _rms(self.squares - self.outside, self.samples - self.outside_samples)
        outside = _rms(self.outside, self.outside_samples)
        samples = np.maximum(self.samples.sum(axis=0), 1.0)
        share_outside = self.outside_samples.sum(axis=0) / samples

        def finite(value: float) -> float | None:
            return float(value) if np.isfinite(value) else None

        return {
            name: JointRmse(
                rmse=float(rmse[joint]),
                rmse_inside=finite(inside[joint]),
                rmse_outside=finite(outside[joint]),
                share_outside=float(share_outside[joint]),
            )
            for joint, name in enumerate(names)
            if np.isfinite(rmse[joint])
        }


def _rms(squares: Array, samples: Array) -> Array:
    """Return the RMS (n,) over all blocks (B, n); NaN of nothing."""
    count = samples.sum(axis=0)
    mean_square = np.maximum(squares.sum(axis=0), 0.0) / np.maximum(count, 1.0)
    return np.where(count > 0, np.sqrt(mean_square), np.nan)


@dataclass(frozen=True)
class Gain:
    """1 - after / before of the squared error, with its 95 % interval."""

    value: float
    low: float
    high: float

    @property
    def certain(self) -> bool:
        """Whether something is gained, and not by chance."""
        return self.low > 0.0

    @property
    def limits(self) -> list[float]:
        """The interval as documents have it: empty where one block gives none."""
        return [self.low, self.high] if np.isfinite(self.high - self.low) else []

    @property
    def loses(self) -> bool:
        """Whether something is lost, and not by chance."""
        return self.high < 0.0


def held_out_error(
    logs: Iterable[Recording | LongLog],
    robot: Robot,
    stages: Stages,
    options: InertiaOptions,
) -> BlockErrors:
    """Predict logs and add up the squared errors, block by block of time.

    Parameters
    ----------
    logs : iterable of Recording or LongLog
        Long logs are passed over in parts; the result is the same.
    robot : Robot
        The arm.
    stages : Stages
        The model. Its smooth terms count as well.
    options : InertiaOptions
        Where joint motion comes from.

    Returns
    -------
    BlockErrors
        Blocks of about two seconds of each log, at least `FEWEST_BLOCKS` of them, at
        most `MOST_BLOCKS`. Only samples count at which the joint certainly slides.
    """
    parts = predict(
        cast("Iterable[Recording]", logs),
        robot,
        stages,
        options=options,
        unexplained=True,
        sliding_only=True,
    )
    errors: list[BlockErrors] = []
    samples_of_log = 0
    first_sample = 0
    for part in parts:
        # A log's first part tells how long it is, and so how many blocks it has.
        if part.part == 0:
            duration_s = float(part.t[-1] - part.t[0])
            if not part.last:
                duration_s *= part.samples / len(part.t)
            n_blocks = round(duration_s / BLOCK_S)
            n_blocks = int(np.clip(n_blocks, FEWEST_BLOCKS, MOST_BLOCKS))
            errors.append(BlockErrors.zeros(n_blocks, robot.n))
            samples_of_log = part.samples
            first_sample = 0

        error = errors[-1]
        n_blocks = len(error.squares)
        sample = np.arange(first_sample, first_sample + len(part.t))
        block = np.minimum(sample * n_blocks // samples_of_log, n_blocks - 1)
        first_sample += len(part.t)

        square = part.residual**2
        extrapolated = part.sliding & part.outside
        _add_by_block(error.squares, block, np.where(part.sliding, square, 0.0))
        _add_by_block(error.samples, block, part.sliding)
        _add_by_block(error.outside, block, np.where(extrapolated, square, 0.0))
        _add_by_block(error.outside_samples, block, extrapolated)
    return joined(errors)


def _add_by_block(totals: Array, block: Index, values: Array | Mask) -> None:
    """Add values (N, n) to the totals (B, n) of the block of each sample (N,)."""
    for joint in range(totals.shape[1]):
        totals[:, joint] += np.bincount(
            block, weights=values[:, joint], minlength=len(totals)
        )


def joined(errors: Iterable[BlockErrors]) -> BlockErrors:
    """Return the blocks of all logs."""
    of_logs = list(errors)
    return BlockErrors(
        squares=np.vstack([error.squares for error in of_logs]),
        samples=np.vstack([error.samples for error in of_logs]),
        outside=np.vstack([error.outside for error in of_logs]),
        outside_samples=np.vstack([error.outside_samples for error in of_logs]),
    )


@dataclass(frozen=True)
class WholeLogs:
    """Held-out logs that are too long to be held, to be passed over from end to end."""

    paths: tuple[Path, ...]
    robot: Robot
    reading: Reading = HEADER_STAMPS

    def errors(
        self, models: Sequence[Stages], options: InertiaOptions
    ) -> list[BlockErrors]:
        """Return the errors of models on all samples.

        There are none where one of the models cannot be predicted part by part.

        Parameters
        ----------
        models : sequence of Stages
            The models.
        options : InertiaOptions
            Where joint motion comes from.
        """
        errors = []
        for stages in models:
            error = self._error(stages, options)
            if error is not None:
                errors.append(error)
        return errors if len(errors) == len(models) else []

    def _error(self, stages: Stages, options: InertiaOptions) -> BlockErrors | None:
        """Return one model's error; None where it must hold a log to predict it."""
        model = TorqueModel.from_stages(stages, self.robot)
        effects = fitted_effects(stages, self.robot, unexplained=True)
        if not (streams(stages, options) and local_effects(model, effects)):
            return None
        errors: list[BlockErrors] = []
        for path in self.paths:
            with local_copy(path) as local:
                log = self._opened(Path(local))
                if log is None:
                    return None
                errors.append(held_out_error([log], self.robot, stages, options))
        return joined(errors)

    def _opened(self, file: Path) -> Recording | LongLog | None:
        """Open a log to pass over it, or read a short one; None if neither can be."""
        n_rows = likely_rows(file)
        if n_rows >= LONG:
            opened = open_if_long(file, self.robot, reading=self.reading, least=1)
            return None if opened is None else screened_long(opened, self.robot)[0]
        if n_rows:
            screened = read_screened(file, self.robot, reading=self.reading)
            return screened.recording
        return None


def gain(
    before: BlockErrors,
    after: BlockErrors,
    joints: Collection[int],
    part: Part = "deciding",
    *,
    level: float = LEVEL,
) -> Gain:
    """Compare two models on the same samples at some joints.

    The samples of a joint are weighed by their mean squared error before, those within
    and those beyond the identified friction each by their own.

    Parameters
    ----------
    before, after : BlockErrors
        Of the two models.
    joints : collection of int
        Those that count.
    part : {"deciding", "beyond"}
        Which samples count: those that decide, which are within the identified friction
        where a joint has enough there; or those beyond that do not decide.
    level : float
        That of the interval.
    """
    squares_before, squares_after = _weighed(before, after, joints, part)
    if not squares_before.any():
        return Gain(value=0.0, low=0.0, high=0.0)
    return gain_of(squares_before, squares_after, level=level)


def likelier(error: BlockErrors, error_of_other: BlockErrors) -> bool:
    """Return whether one model explains the same samples better than another.

    By the likelihood of normal errors of each joint's and model's own size: joints
    count alike.
    """
    log_squares = np.log(np.maximum(error.squares.sum(axis=0), 1e-300))
    log_squares_of_other = np.log(
        np.maximum(error_of_other.squares.sum(axis=0), 1e-300)
    )
    samples = error.samples.sum(axis=0)
    return bool(samples @ (log_squares - log_squares_of_other) < 0.0)


def doubt(before: BlockErrors, after: BlockErrors, joints: Collection[int]) -> float:
    """Return the probability that nothing is gained, over drawn weights of the blocks.

    It is the doubt that the selection goes by.

    Parameters
    ----------
    before, after : BlockErrors
        Of two models on the same samples.
    joints : collection of int
        Those that count.
    """
    squares_before, squares_after = _weighed(before, after, joints, "deciding")
    return doubt_of(squares_before - squares_after)


def _weighed(
    before: BlockErrors, after: BlockErrors, joints: Collection[int], part: Part
) -> tuple[Array, Array]:
    """Return the squared errors (B,) of two models, in units of the mean before.

    Each joint has two such means: within and beyond the identified friction. One of a
    part that does not count has no weight.
    """
    chosen = sorted(joints)
    of_before = _within_and_beyond(before.squares, before.outside, chosen)
    of_after = _within_and_beyond(after.squares, after.outside, chosen)
    samples = _within_and_beyond(before.samples, before.outside_samples, chosen)
    total = of_before.sum(axis=0)
    inverse_mean = samples.sum(axis=0) / np.maximum(total, 1e-300)
    weight = np.where(total > 0.0, inverse_mean, 0.0)

    is_identified = before.is_identified[chosen]
    every = np.ones_like(is_identified)
    counts: dict[Part, list[Mask]] = {
        "deciding": [every, ~is_identified],
        "beyond": [~every, is_identified],
    }
    weight = weight * np.concatenate(counts[part])
    return of_before @ weight, of_after @ weight


def _within_and_beyond(total: Array, beyond: Array, joints: Sequence[int]) -> Array:
    """Return sums (B, 2 k) of k joints: within the identified friction, then beyond."""
    within = total[:, joints] - beyond[:, joints]
    within = np.where(within > ROUNDING * total[:, joints], within, 0.0)
    return np.hstack([within, beyond[:, joints]])


def gain_of(
    squares_before: Array, squares_after: Array, *, level: float = LEVEL
) -> Gain:
    """Return the share of the squared error that a model takes away.

    Of a single block the interval is everything.

    Parameters
    ----------
    squares_before, squares_after : (B,) arrays
        Squared errors of two models on the same blocks, in any unit.
    level : float
        That of the interval.
    """
    is_used = (squares_before > 0.0) | (squares_after > 0.0)
    before = squares_before[is_used]
    after = squares_after[is_used]
    total = max(float(before.sum()), 1e-300)
    ratio = float(after.sum()) / total

    # Blocks are joined while enough are left, and the widest interval counts.
    difference = after - ratio * before
    half_width = _half_width(difference, level) / total
    while len(difference) >= 2 * FEWEST_BLOCKS:
        pair_starts = np.arange(0, len(difference) - 1, 2)
        difference = np.add.reduceat(difference, pair_starts)
        half_width = max(half_width, _half_width(difference, level) / total)

    value = 1.0 - ratio
    return Gain(value=value, low=value - half_width, high=value + half_width)


def _half_width(difference: Array, level: float) -> float:
    """Return half the interval of a sum of independent values (B,) about zero."""
    count = len(difference)
    if count < 2:
        return float("inf")
    quantile = float(stdtrit(count - 1, 0.5 + 0.5 * level))
    variance = count / (count - 1) * np.sum(difference**2)
    return quantile * float(np.sqrt(variance))
