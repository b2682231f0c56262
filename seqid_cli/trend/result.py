"""From series to the document: what changed, by robot, joint, quantity and date."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

from seqid_cli.params.document import now, tool
from seqid_cli.params.files import replacing, writing
from seqid_cli.params.results.prediction import FileId
from seqid_cli.params.results.trend import TREND_SCHEMA, ChangeEntry, SeriesEntry, TrendFile
from seqid_cli.params.schema import ParameterFile
from seqid_cli.trend.changes import Change, best_change, limit_of, scatter_of
from seqid_cli.trend.options import TrendOptions
from seqid_cli.trend.series import Dated, Series, robots_of, series_of


def trend_file(
    models: Sequence[tuple[str, ParameterFile]], ids: list[FileId], options: TrendOptions
) -> TrendFile:
    """Judge the files of all robots together."""
    robots = robots_of([Dated.of(name, file) for name, file in models], options.by)
    series = [own for name, files in robots.items() for own in series_of(name, files)]
    scatters = {
        stage: scatter_of(own for own in series if own.quantity.stage == stage)
        for stage in dict.fromkeys(own.quantity.stage for own in series)
    }
    limit = limit_of(series, scatters.values(), options.alpha)
    sizes = _sizes(series)
    changes = []
    for own in series:
        change = best_change(own, scatters[own.quantity.stage].inflation)
        relative = change.relative(sizes[_group(own)])
        if change.sigmas > limit and abs(relative) > options.rtol:
            changes.append(_entry(change, relative))
    changes += [entry for name, files in robots.items() for entry in _effects(name, files)]
    changes.sort(key=lambda entry: -(entry.sigmas or np.inf))
    return TrendFile(
        schema=TREND_SCHEMA,
        created=now(),
        tool=tool(),
        files=ids,
        robots=list(robots),
        alarm=bool(changes),
        limit=limit,
        inflation={stage: scatter.inflation for stage, scatter in scatters.items()},
        changes=changes,
        series=[_listed(own) for own in series],
        notes=list(_notes(robots)),
    )


def _group(series: Series) -> tuple[str, str, str]:
    return series.robot, series.quantity.stage, series.quantity.unit


def _sizes(
    series: Sequence[Series], *, least_size: float = 0.001
) -> Mapping[tuple[str, str, str], float]:
    """Least size of quantities, by robot, stage and unit."""
    found: dict[tuple[str, str, str], float] = {}
    for own in series:
        size = least_size * float(np.abs(own.values).max())
        found[_group(own)] = max(found.get(_group(own), 0.0), size)
    return found


def _entry(change: Change, relative: float) -> ChangeEntry:
    own = change.series
    return ChangeEntry(
        robot=own.robot,
        **asdict(own.quantity),
        kind=change.kind,
        since=own.files[change.at].date,
        before=change.before,
        after=change.after,
        change=change.change,
        std_error=change.std_error,
        sigmas=change.sigmas if np.isfinite(change.sigmas) else None,
        relative=relative,
    )


def _effects(robot: str, files: Sequence[Dated]) -> Iterator[ChangeEntry]:
    """Effects that a robot's first file does not hold and the last one does, or the other way."""
    refined = [dated for dated in files if dated.file.stages.effects is not None]
    held = [{(e.effect, e.joint or "") for e in d.file.stages.effects or []} for d in refined]
    if len(held) < 2:
        return
    for kind, some, others in (("appeared", held[-1], held[0]), ("gone", held[0], held[-1])):
        for effect, joint in sorted(some - others):
            now_there = [((effect, joint) in own) == (kind == "appeared") for own in held]
            last = max(k for k, there in enumerate(now_there) if not there)
            yield ChangeEntry(
                robot=robot,
                stage="effects",
                joint=joint,
                name=effect,
                unit="",
                kind=kind,
                since=refined[last + 1].date,
            )


def _listed(series: Series) -> SeriesEntry:
    warmth = series.temperatures
    return SeriesEntry(
        robot=series.robot,
        **asdict(series.quantity),
        dates=[dated.date for dated in series.files],
        values=series.values.tolist(),
        std_errors=series.errors.tolist(),
        temperatures=warmth.tolist() if np.isfinite(warmth).all() else [],
    )


def _notes(robots: Mapping[str, Sequence[Dated]]) -> Iterator[str]:
    single = [name for name, files in robots.items() if len(files) < 2]
    if single:
        yield f"one file each, nothing to compare: {', '.join(single)}"
    for name, files in robots.items():
        if len({dated.file.robot.sha256 for dated in files}) > 1:
            yield f"{name}: the robot files differ: geometry, limits or drives may have changed"


def write_table(path: Path, found: TrendFile) -> None:
    """Write every quantity at every date as one row of a Parquet file."""
    names = ("robot", "stage", "joint", "name", "unit")
    rows = [
        {
            **{key: getattr(own, key) for key in names},
            "date": date,
            "value": value,
            "std_error": error,
        }
        for own in found.series
        for date, value, error in zip(own.dates, own.values, own.std_errors, strict=True)
    ]
    with replacing(path) as partial, writing(path):
        pq.write_table(pa.Table.from_pylist(rows), partial)
