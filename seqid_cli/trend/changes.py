"""Changes of quantities over time: steps between two dates, and drifts.

The values x_t of one quantity, with standard errors s_t at times t, are

    x_t = m + b (T_t - T) + d c_t + c s_t e_t,

T_t the temperature where it is known, b known to be about zero within `per_kelvin` of
m, and c_t either a step between two dates or a line over time. Results of separate
recordings scatter more than their standard errors say, by what is the same within a
recording; the inflation c >= 1 is the median of the differences of neighbouring dates
over their errors, of all robots and quantities of one stage together: few that change
do not move it. With less than `enough` differences the standard errors are taken as
they are.

The z-score of d is held against Student's distribution, all steps and lines of all
quantities counted (Bonferroni). The hypothesis with the largest |z| of a quantity is
the one that is reported.
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
from scipy import stats

from seqid_cli import shares
from seqid_cli.params.dates import created_from, recorded_date
from seqid_cli.params.document import head
from seqid_cli.params.files import replacing, writing
from seqid_cli.params.results.prediction import FileId
from seqid_cli.params.results.trend import (
    TREND_SCHEMA,
    ChangeEntry,
    QuantityEntry,
    SeriesEntry,
    TrendFile,
)
from seqid_cli.params.schema import ParameterFile
from seqid_cli.robot.types import Array
from seqid_cli.robust import gaussian_spread
from seqid_cli.trend.options import TrendOptions
from seqid_cli.trend.series import Named, days_of, robots_of, series_of


@dataclass(frozen=True)
class Scatter:
    """Inflation of the standard errors of a stage, and the differences that show it.

    `n_differences` is 0 where there are too few to tell.
    """

    inflation: float
    n_differences: int


@dataclass(frozen=True, kw_only=True)
class _Hypothesis:
    """A change of a quantity from the date `since` on, as a column c_t (T,)."""

    kind: str
    since: int
    column: Array


@dataclass(frozen=True, kw_only=True)
class _FittedChange:
    """A hypothesis with its least squares: the value before it, and the change."""

    hypothesis: _Hypothesis
    first_value: float
    change: float
    std_error: float

    @property
    def sigmas(self) -> float:
        """The size of the change in standard errors."""
        return abs(self.change) / self.std_error if self.std_error > 0.0 else np.inf


def trend_file(
    models: Sequence[Named],
    ids: list[FileId],
    options: TrendOptions,
    *,
    least_size: float = 0.001,
) -> TrendFile:
    """Judge the files of all robots together.

    Parameters
    ----------
    models : sequence of (path, ParameterFile)
        Files of several dates, of one or more robots.
    ids : list of FileId
        The same files as documents name them.
    options : TrendOptions
        Limits of a change.
    least_size : float
        Size that a quantity has at least, as a share of the robot's largest of the same
        stage and unit.
    """
    robots = robots_of(models, options.by)
    series: list[SeriesEntry] = []
    for name, files in robots.items():
        series += series_of(name, files)

    # Scatter is of the stage, not of the robot: few robots have enough dates.
    by_stage: dict[str, list[SeriesEntry]] = {}
    for quantity in series:
        by_stage.setdefault(quantity.stage, []).append(quantity)
    scatters = {stage: scatter_of(group) for stage, group in by_stage.items()}
    n_differences = [x.n_differences for x in scatters.values() if x.n_differences]
    limit = _limit(series, n_differences, options.alpha)

    changes = []
    least_sizes = _least_sizes(series, least_size)
    for quantity in series:
        inflation = scatters[quantity.stage].inflation
        least = least_sizes[quantity.robot, quantity.stage, quantity.unit]
        sigmas, change = best_change(quantity, inflation, least)
        if sigmas > limit and abs(change.relative or 0.0) > options.rtol:
            changes.append(change)
    for name, files in robots.items():
        changes += _effect_changes(name, files)
    changes.sort(key=lambda change: -(change.sigmas or np.inf))

    return TrendFile(
        **head(TREND_SCHEMA, created_from(file for _, file in models)),
        files=ids,
        robots=list(robots),
        alarm=bool(changes),
        limit=limit,
        inflation={stage: scatter.inflation for stage, scatter in scatters.items()},
        changes=changes,
        series=series,
        notes=list(_notes(robots)),
    )


def _least_sizes(
    series: Sequence[SeriesEntry], share: float
) -> dict[tuple[str, str, str], float]:
    """Return `share` of the largest value by robot, stage and unit."""
    sizes: dict[tuple[str, str, str], float] = {}
    for quantity in series:
        key = (quantity.robot, quantity.stage, quantity.unit)
        size = share * float(np.abs(quantity.values).max())
        sizes[key] = max(sizes.get(key, 0.0), size)
    return sizes


def _limit(
    series: Sequence[SeriesEntry], n_differences: Sequence[int], alpha: float
) -> float:
    """Return the |z| that a healthy robot exceeds with the probability `alpha`."""
    # Of each quantity: a step between any two dates, and a line.
    n_hypotheses = sum(len(quantity.values) for quantity in series)
    tail = alpha / (2 * max(n_hypotheses, 1))
    if not n_differences:
        return float(stats.norm.isf(tail))
    # The inflation is uncertain itself: a median of n differences has some n / 2
    # degrees of freedom.
    return float(stats.t.isf(tail, min(n_differences) / 2))


def _notes(robots: Mapping[str, Sequence[ParameterFile]]) -> Iterator[str]:
    """Yield what a reader of the changes must know besides."""
    single = [name for name, files in robots.items() if len(files) < 2]
    if single:
        yield f"one file each, nothing to compare: {', '.join(single)}"
    for name, files in robots.items():
        if len({file.robot.sha256 for file in files}) > 1:
            yield (
                f"{name}: the robot files differ: geometry, limits or drives may have"
                " changed"
            )


def scatter_of(series: Sequence[SeriesEntry], *, enough: int = 30) -> Scatter:
    """Return by how much the quantities of one stage scatter beyond their errors."""
    ratios = [np.zeros(0)]
    for quantity in series:
        std_errors = np.array(quantity.std_errors)
        if std_errors.min() > 0.0:
            of_difference = np.hypot(std_errors[1:], std_errors[:-1])
            ratios.append(np.diff(quantity.values) / of_difference)
    all_ratios = np.concatenate(ratios)
    if len(all_ratios) < enough:
        return Scatter(inflation=1.0, n_differences=0)
    inflation = max(float(gaussian_spread(all_ratios)), 1.0)
    return Scatter(inflation=inflation, n_differences=len(all_ratios))


def best_change(
    series: SeriesEntry, inflation: float, least: float
) -> tuple[float, ChangeEntry]:
    """Return the clearest step or drift of a quantity.

    Parameters
    ----------
    series : SeriesEntry
        The quantity over T dates.
    inflation : float
        Factor of its standard errors.
    least : float
        Size that it has at least, in its own unit.

    Returns
    -------
    sigmas : float
        Standard errors of the change, infinite where it has none.
    change : ChangeEntry
        The change itself.
    """
    fits = [
        _fitted(series, inflation, hypothesis) for hypothesis in _hypotheses(series)
    ]
    best = max(fits, key=lambda fit: fit.sigmas)
    last_value = best.first_value + best.change
    change = ChangeEntry(
        **_quantity(series),
        kind=best.hypothesis.kind,
        since=series.dates[best.hypothesis.since],
        before=best.first_value,
        after=last_value,
        change=best.change,
        std_error=best.std_error,
        sigmas=best.sigmas if np.isfinite(best.sigmas) else None,
        relative=shares.change(best.first_value, last_value, least),
    )
    return best.sigmas, change


def _hypotheses(series: SeriesEntry) -> Iterator[_Hypothesis]:
    """Yield a step at each date but the first, and a drift over all of them."""
    count = len(series.values)
    for k in range(1, count):
        step = (np.arange(count) >= k).astype(np.float64)
        yield _Hypothesis(kind="step", since=k, column=step)
    # Of two dates a drift is the step between them.
    days = days_of(series.dates)
    if count > 2 and days[-1] > 0.0:
        yield _Hypothesis(kind="drift", since=0, column=days / days[-1])


def _quantity(entry: QuantityEntry) -> dict[str, str]:
    """Return the fields that name a quantity."""
    return {name: getattr(entry, name) for name in QuantityEntry.__struct_fields__}


def _fitted(
    series: SeriesEntry,
    inflation: float,
    hypothesis: _Hypothesis,
    *,
    per_kelvin: float = 0.02,
) -> _FittedChange:
    """Fit one hypothesis by generalised least squares, the temperature beside it."""
    values = np.array(series.values)
    std_errors = inflation * np.array(series.std_errors)
    smallest = 1e-12 * max(float(np.abs(values).max()), 1e-300)
    weights = 1.0 / np.maximum(std_errors, smallest)

    temperatures = np.array(series.temperatures or np.zeros(len(values)))
    warmth = temperatures - temperatures.mean()
    columns = np.column_stack([np.ones(len(values)), hypothesis.column, warmth])

    # The last row holds the slope over temperature near zero.
    size = max(float(np.abs(values).mean()), smallest)
    prior_row = [0.0, 0.0, 1.0 / (per_kelvin * size)]
    rows = np.vstack([columns * weights[:, None], prior_row])
    right_side = np.append(values * weights, 0.0)
    covariance = np.linalg.pinv(rows.T @ rows, hermitian=True, rcond=1e-14)
    theta = covariance @ (rows.T @ right_side)
    return _FittedChange(
        hypothesis=hypothesis,
        first_value=float(theta[0]),
        change=float(theta[1]),
        std_error=float(np.sqrt(max(covariance[1, 1], 0.0))),
    )


def _effect_changes(
    robot: str, files: Sequence[ParameterFile]
) -> Iterator[ChangeEntry]:
    """Yield effects that appeared or are gone from a robot's first to its last file.

    A file that was not refined may lack an effect that the arm had: what the first
    refined file after it holds was added, not more.
    """
    refined = [file for file in files if file.stages.effects is not None]
    if not refined:
        return
    effects = [
        {(entry.effect, entry.joint or "") for entry in file.stages.effects or []}
        for file in refined
    ]
    if files[0].stages.effects is None:
        for effect in sorted(effects[0]):
            yield _effect_change(robot, effect, "added", refined[0])
    for effect in sorted(effects[-1] - effects[0]):
        last_without = max(k for k, held in enumerate(effects) if effect not in held)
        yield _effect_change(robot, effect, "appeared", refined[last_without + 1])
    for effect in sorted(effects[0] - effects[-1]):
        last_with = max(k for k, held in enumerate(effects) if effect in held)
        yield _effect_change(robot, effect, "gone", refined[last_with + 1])


def _effect_change(
    robot: str, effect: tuple[str, str], kind: str, first: ParameterFile
) -> ChangeEntry:
    """Return that an effect at a joint is in `first` and later, or no more."""
    name, joint = effect
    return ChangeEntry(
        robot=robot,
        stage="effects",
        joint=joint,
        name=name,
        unit="",
        kind=kind,
        since=recorded_date(first),
    )


def write_table(path: Path, document: TrendFile) -> None:
    """Write every quantity at every date as one row of a Parquet file."""
    rows = []
    for series in document.series:
        dated = zip(series.dates, series.values, series.std_errors, strict=True)
        for date, value, std_error in dated:
            row = {"date": date, "value": value, "std_error": std_error}
            rows.append({**_quantity(series), **row})
    with replacing(path) as partial, writing(path):
        pq.write_table(pa.Table.from_pylist(rows), partial)
