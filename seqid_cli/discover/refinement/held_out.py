"""Errors on samples that were not fitted, block by block of time, and how sure a gain is.

A model is judged where joints slide: on the logs that it was fitted to, where its
stages are to be identified anew, and on the held-out logs, where the result is told.
With squared errors o_b before and n_b after in block b (Cochran, "Sampling Techniques",
1977, section 6),

    gain = 1 - r,   r = sum n / sum o,   se^2 = B / (B - 1) sum (n_b - r o_b)^2 / (sum o)^2.

Neighbouring blocks may share their error: they are joined two by two, as long as enough
are left, and the largest interval counts (Flyvbjerg and Petersen, J. Chem. Phys. 91,
1989).
"""

from __future__ import annotations

from collections.abc import Collection, Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple, cast

import numpy as np
from scipy.stats import t as student_t

from seqid_cli.discover.select.rows import doubt_of
from seqid_cli.discover.survey.rows import BLOCK_S
from seqid_cli.identify.options import InertiaOptions
from seqid_cli.identify.prediction.predict import local_effects, predict
from seqid_cli.identify.regression.equations import LONG, open_if_long, streams
from seqid_cli.inspect.screening import read_screened, screened_long
from seqid_cli.logs.long import likely_rows
from seqid_cli.logs.raw import TimeSource
from seqid_cli.logs.recording import Recording
from seqid_cli.logs.storage.remote import local_copy
from seqid_cli.model.effects.fitted import fitted_effects
from seqid_cli.model.torque import TorqueModel
from seqid_cli.motion.blocks import SurveyedLog
from seqid_cli.motion.torque_noise import LEVEL
from seqid_cli.params.schema import JointRmse, Stages
from seqid_cli.robot.types import Robot
from seqid_cli.typing import Array

FEWEST_BLOCKS = 8  # of joined blocks: with fewer their spread tells little
MOST_BLOCKS = 1000  # of a log that comes in parts


class HeldOutError(NamedTuple):
    """Squared error (N m)^2 and samples (B, n) of every block, where a joint certainly slides.

    At rest the model says an interval: a wider one always fits better, and nothing is
    gained by it.
    """

    squares: Array
    samples: Array
    outside: Array  # of these beyond the identified friction
    outside_samples: Array

    def rmse(self) -> Array:
        """RMS error (n,) N m as `predict` reports it; NaN for a joint that never slides."""
        return _rms(self.squares, self.samples)

    def by_joint(self, names: Sequence[str]) -> dict[str, JointRmse]:
        """Errors of the joints that slide, also apart within and beyond the identified friction."""
        inside = _rms(self.squares - self.outside, self.samples - self.outside_samples)
        outside = _rms(self.outside, self.outside_samples)
        share = self.outside_samples.sum(axis=0) / np.maximum(
            self.samples.sum(axis=0), 1.0
        )
        every = np.stack([self.rmse(), inside, outside, share], axis=1).tolist()
        return {
            name: JointRmse(
                rmse=whole,
                rmse_inside=within if np.isfinite(within) else None,
                rmse_outside=beyond if np.isfinite(beyond) else None,
                share_outside=part,
            )
            for name, (whole, within, beyond, part) in zip(names, every, strict=True)
            if np.isfinite(whole)
        }


def _rms(squares: Array, samples: Array) -> Array:
    count = samples.sum(axis=0)
    mean = np.maximum(squares.sum(axis=0), 0.0) / np.maximum(count, 1.0)
    return np.where(count > 0, np.sqrt(mean), np.nan)


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
        """The interval as documents have it: empty where one block of time gives none."""
        return [self.low, self.high] if np.isfinite(self.high - self.low) else []

    @property
    def loses(self) -> bool:
        """Whether something is lost, and not by chance."""
        return self.high < 0.0


def held_out_error(
    logs: Iterable[Recording | SurveyedLog],
    robot: Robot,
    stages: Stages,
    options: InertiaOptions,
) -> HeldOutError:
    """Predict logs, smooth terms included, and add up the squared errors, block by block."""
    found, samples, seen = list[HeldOutError](), 0, 0
    # passed over: predicted alike
    given = cast("Iterable[Recording]", logs), robot, stages
    for log in predict(*given, options=options, unexplained=True, sliding_only=True):
        # blocks of a short log are shorter, of one that is not held longer
        if log.part == 0:
            length = float(log.t[-1] - log.t[0])
            length *= 1.0 if log.last else log.samples / len(log.t)
            blocks = int(np.clip(round(length / BLOCK_S), FEWEST_BLOCKS, MOST_BLOCKS))
            found.append(HeldOutError(*np.zeros((4, blocks, robot.n))))
            samples, seen = log.samples, 0
        blocks = len(found[-1].squares)
        block = np.minimum(
            np.arange(seen, seen + len(log.t)) * blocks // samples, blocks - 1
        )
        seen += len(log.t)
        square, counts, beyond = log.residual**2, log.sliding, log.sliding & log.outside
        values = (
            np.where(counts, square, 0.0),
            counts,
            np.where(beyond, square, 0.0),
            beyond,
        )
        for total, of_joints in zip(found[-1], values, strict=True):
            for own, value in zip(total.T, of_joints.T, strict=True):
                own += np.bincount(block, weights=value, minlength=blocks)
    return joined(found)


def joined(errors: Iterable[HeldOutError]) -> HeldOutError:
    """The blocks of all logs."""
    return HeldOutError(*map(np.vstack, zip(*errors, strict=True)))


@dataclass(frozen=True)
class WholeLogs:
    """Held-out logs that are too long to be held, whole, to be passed over."""

    paths: tuple[Path, ...]
    robot: Robot
    time_source: TimeSource = "header"

    def errors(
        self, models: Sequence[Stages], options: InertiaOptions
    ) -> list[HeldOutError]:
        """Errors of models on all samples; none where one cannot be predicted part by part."""
        found = [self._error(stages, options) for stages in models]
        known = [error for error in found if error is not None]
        return known if len(known) == len(models) else []

    def _error(self, stages: Stages, options: InertiaOptions) -> HeldOutError | None:
        model = TorqueModel.from_stages(stages, self.robot)
        effects = fitted_effects(stages, self.robot, unexplained=True)
        if not (streams(stages, options) and local_effects(model, effects)):
            return None
        found: list[HeldOutError] = []
        for path in self.paths:
            with local_copy(path) as local:
                # where a long one must be held
                log: Recording | SurveyedLog | None = None
                file, clock = Path(local), self.time_source
                if likely_rows(file) >= LONG:
                    opened = open_if_long(file, self.robot, time_source=clock, least=1)
                    log = (
                        screened_long(opened, self.robot)[0]
                        if opened is not None
                        else None
                    )
                elif likely_rows(file):
                    log = read_screened(file, self.robot, time_source=clock).recording
                if log is None:
                    return None
                found.append(held_out_error([log], self.robot, stages, options=options))
        return joined(found)


def gain(before: HeldOutError, after: HeldOutError, joints: Collection[int]) -> Gain:
    """Compare two models on the same samples at some joints.

    The samples of a joint within and those beyond the identified friction are each
    weighed by their mean squared error before: what extrapolation misses does not hide
    what an effect gains.
    """
    old, new = _weighed(before, after, joints)
    return gain_of(old, new) if old.any() else Gain(0.0, 0.0, 0.0)


def likelier(one: HeldOutError, other: HeldOutError) -> bool:
    """Whether one model explains the same samples better than another, all joints together.

    By the likelihood of normal errors of each joint's and model's own size: joints
    count alike.
    """
    first, second = (
        np.log(np.maximum(x.squares.sum(axis=0), 1e-300)) for x in (one, other)
    )
    return bool(one.samples.sum(axis=0) @ (first - second) < 0.0)


def doubt(before: HeldOutError, after: HeldOutError, joints: Collection[int]) -> float:
    """Probability that nothing is gained, over drawn weights of the blocks, as selection has it."""
    old, new = _weighed(before, after, joints)
    return doubt_of(old - new)


def _weighed(
    before: HeldOutError, after: HeldOutError, joints: Collection[int]
) -> tuple[Array, Array]:
    """Squared errors (B,) of two models, those within and beyond in units of the mean before."""
    chosen = sorted(joints)
    old, new = (
        _within_and_beyond(x.squares, x.outside, chosen) for x in (before, after)
    )
    counts = _within_and_beyond(before.samples, before.outside_samples, chosen).sum(
        axis=0
    )
    total = old.sum(axis=0)
    weight = np.where(total > 0.0, counts / np.maximum(total, 1e-300), 0.0)
    return old @ weight, new @ weight


def _within_and_beyond(every: Array, beyond: Array, joints: Sequence[int]) -> Array:
    """Sums (B, 2 k) of some joints; what rounding leaves of a difference is nothing."""
    within = every[:, joints] - beyond[:, joints]
    within = np.where(within > 1e-12 * every[:, joints], within, 0.0)
    return np.hstack([within, beyond[:, joints]])


def gain_of(old: Array, new: Array) -> Gain:
    """Gain from squared errors (B,) by block; of a single one the interval is everything."""
    there = (old > 0.0) | (new > 0.0)
    old, new = old[there], new[there]
    total = max(float(old.sum()), 1e-300)
    ratio = float(new.sum()) / total
    left = new - ratio * old
    width = _half_width(left) / total
    while len(left) >= 2 * FEWEST_BLOCKS:
        left = np.add.reduceat(left, np.arange(0, len(left) - 1, 2))
        width = max(width, _half_width(left) / total)
    return Gain(1.0 - ratio, 1.0 - ratio - width, 1.0 - ratio + width)


def _half_width(left: Array) -> float:
    """Half the interval of a sum of independent values (B,) about zero."""
    if (count := len(left)) < 2:
        return float("inf")
    quantile = float(student_t.ppf(0.5 + 0.5 * LEVEL, count - 1))
    return quantile * float(np.sqrt(count / (count - 1) * np.sum(left**2)))
