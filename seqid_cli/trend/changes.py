"""Whether a quantity changed: steps between two dates, and drifts, against their errors.

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
the one that is told.
"""

from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
from scipy import stats

from seqid_cli.params.dates import created_from
from seqid_cli.params.document import head
from seqid_cli.params.files import replacing, writing
from seqid_cli.params.results import trend
from seqid_cli.params.results.prediction import FileId
from seqid_cli.params.schema import ParameterFile
from seqid_cli.robot.types import Array
from seqid_cli.robust import gaussian_spread
from seqid_cli.trend.options import TrendOptions
from seqid_cli.trend.series import Named, days_of, robots_of, series_of


def trend_file(
    models: Sequence[Named],
    ids: list[FileId],
    options: TrendOptions,
    *,
    least_size: float = 0.001,
) -> trend.TrendFile:
    """Judge the files of all robots together.

    `least_size`: of a quantity, as a share of the robot's largest of the same stage and
    unit.
    """
    robots = robots_of(models, options.by)
    series = [own for name, files in robots.items() for own in series_of(name, files)]
    stages = {own.stage: [x for x in series if x.stage == own.stage] for own in series}
    scatters = {stage: scatter_of(own) for stage, own in stages.items()}
    limit = _limit(
        series, [count for _, count in scatters.values() if count], options.alpha
    )
    changes, sizes = [], dict[tuple[str, str, str], float]()
    for own in series:
        kind, size = (
            (own.robot, own.stage, own.unit),
            least_size * float(np.abs(own.values).max()),
        )
        sizes[kind] = max(sizes.get(kind, 0.0), size)
    for own in series:
        least = sizes[own.robot, own.stage, own.unit]
        sigmas, change = best_change(own, scatters[own.stage][0], least)
        if sigmas > limit and abs(change.relative or 0.0) > options.rtol:
            changes.append(change)
    changes += [
        entry for name, files in robots.items() for entry in _effects(name, files)
    ]
    changes.sort(key=lambda entry: -(entry.sigmas or np.inf))
    return trend.TrendFile(
        **head(trend.TREND_SCHEMA, created_from(file for _, file in models)),
        files=ids,
        robots=list(robots),
        alarm=bool(changes),
        limit=limit,
        inflation={stage: inflation for stage, (inflation, _) in scatters.items()},
        changes=changes,
        series=series,
        notes=list(_notes(robots)),
    )


def _limit(
    series: Sequence[trend.SeriesEntry], differences: Sequence[int], alpha: float
) -> float:
    """The |z| that any hypothesis on healthy robots exceeds with the probability `alpha`."""
    # a step between any two dates, and a line
    hypotheses = sum(len(own.values) for own in series)
    share = alpha / (2 * max(hypotheses, 1))
    return float(
        stats.t.isf(share, min(differences) / 2)
        if differences
        else stats.norm.isf(share)
    )


def _notes(robots: Mapping[str, Sequence[ParameterFile]]) -> Iterator[str]:
    if single := [name for name, files in robots.items() if len(files) < 2]:
        yield f"one file each, nothing to compare: {', '.join(single)}"
    for name, files in robots.items():
        if len({file.robot.sha256 for file in files}) > 1:
            yield (
                f"{name}: the robot files differ: geometry, limits or drives may have"
                " changed"
            )


def scatter_of(
    series: Sequence[trend.SeriesEntry], *, enough: int = 30
) -> tuple[float, int]:
    """Inflation of the standard errors of one stage, and how many differences say so (0: none)."""
    known = [
        (x.values, np.array(x.std_errors)) for x in series if min(x.std_errors) > 0.0
    ]
    ratios = [
        np.diff(values) / np.hypot(errors[1:], errors[:-1]) for values, errors in known
    ]
    every = np.concatenate([np.zeros(0), *ratios])
    if len(every) < enough:
        return 1.0, 0
    return max(float(gaussian_spread(every)), 1.0), len(every)


def best_change(
    series: trend.SeriesEntry, inflation: float, least: float
) -> tuple[float, trend.ChangeEntry]:
    """The clearest step or drift of a quantity of at least a size, and its standard errors."""
    count, days = len(series.values), days_of(series.dates)
    tried = [
        ("step", k, (np.arange(count) >= k).astype(np.float64)) for k in range(1, count)
    ]
    if count > 2 and days[-1] > 0.0:
        tried.append(("drift", 0, days / days[-1]))
    found = []
    for kind, at, column in tried:
        before, change, error = _fitted(series, inflation, column)
        sigmas = abs(change) / error if error > 0.0 else np.inf
        found.append((sigmas, kind, at, before, change, error))
    sigmas, kind, at, before, change, error = max(found, key=lambda one: one[0])
    size = max(abs(before), abs(before + change), least)
    return sigmas, trend.ChangeEntry(
        **_quantity(series),
        kind=kind,
        since=series.dates[at],
        before=before,
        after=before + change,
        change=change,
        std_error=error,
        sigmas=sigmas if np.isfinite(sigmas) else None,
        relative=change / size if size > 0.0 else 0.0,
    )


def _quantity(entry: trend.QuantityEntry) -> dict[str, str]:
    return {
        name: getattr(entry, name) for name in trend.QuantityEntry.__struct_fields__
    }


def _fitted(
    series: trend.SeriesEntry,
    inflation: float,
    column: Array,
    *,
    per_kelvin: float = 0.02,
) -> tuple[float, float, float]:
    """Generalised least squares for one hypothesis: before, the change and its error."""
    values, errors = np.array(series.values), inflation * np.array(series.std_errors)
    least = 1e-12 * max(float(np.abs(values).max()), 1e-300)
    root = 1.0 / np.maximum(errors, least)
    warmth = np.array(series.temperatures or np.zeros(len(column)))
    A = (
        np.column_stack([np.ones(len(column)), column, warmth - warmth.mean()])
        * root[:, None]
    )
    size = max(float(np.abs(values).mean()), least)
    rows = np.vstack([A, [0.0, 0.0, 1.0 / (per_kelvin * size)]])
    y = np.append(values * root, 0.0)
    covariance = np.linalg.pinv(rows.T @ rows, hermitian=True, rcond=1e-14)
    theta = covariance @ (rows.T @ y)
    return float(theta[0]), float(theta[1]), float(np.sqrt(max(covariance[1, 1], 0.0)))


def _effects(robot: str, files: Sequence[ParameterFile]) -> Iterator[trend.ChangeEntry]:
    """Effects that a robot's first file does not hold and the last one does, or the other way."""
    refined = [file for file in files if file.stages.effects is not None]
    held = [
        {(x.effect, x.joint or "") for x in file.stages.effects or []}
        for file in refined
    ]
    if len(held) < 2:
        return
    for kind, some, others in (
        ("appeared", held[-1], held[0]),
        ("gone", held[0], held[-1]),
    ):
        for effect, joint in sorted(some - others):
            now_there = [
                ((effect, joint) in own) == (kind == "appeared") for own in held
            ]
            last = max(k for k, there in enumerate(now_there) if not there)
            yield trend.ChangeEntry(
                robot=robot,
                stage="effects",
                joint=joint,
                name=effect,
                unit="",
                kind=kind,
                since=refined[last + 1].created,
            )


def write_table(path: Path, found: trend.TrendFile) -> None:
    """Write every quantity at every date as one row of a Parquet file."""
    rows = [
        {**_quantity(own), "date": date, "value": value, "std_error": error}
        for own in found.series
        for date, value, error in zip(
            own.dates, own.values, own.std_errors, strict=True
        )
    ]
    with replacing(path) as partial, writing(path):
        pq.write_table(pa.Table.from_pylist(rows), partial)
