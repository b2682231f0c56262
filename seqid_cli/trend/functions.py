"""Trends as a function: parameter files of several dates in, what changed out."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from seqid_cli.errors import UsageError
from seqid_cli.identify.inputs import Model, model_id, read_models
from seqid_cli.logs.given import PathLike, listed, optional
from seqid_cli.params.files import check_output
from seqid_cli.params.io import write_json_atomic
from seqid_cli.params.results.trend import TrendFile
from seqid_cli.params.schema import ParameterFile
from seqid_cli.trend.options import TrendOptions


def trend(
    parameters: Sequence[Model],
    options: TrendOptions = TrendOptions(),
    *,
    output: PathLike | None = None,
    table: PathLike | None = None,
) -> TrendFile:
    """Find out what changed over time beyond its error, robot by robot.

    Parameters
    ----------
    parameters : sequence of path or ParameterFile
        Results of the same stages at several dates, of one or more robots; the date is
        the one that the file says it was created at.
    options : TrendOptions
    output : path, optional
        Where the document goes.
    table : path, optional
        Where every quantity at every date goes, as Parquet.

    Raises
    ------
    SeqidError
        Where the command would exit with 2.
    """
    given = listed(parameters)
    files = [Path(model) for model in given if not isinstance(model, ParameterFile)]
    target, rows = optional(output), optional(table)
    for path in (target, rows):
        if path is not None:
            check_output(path, files)
    if target is not None and rows is not None and target.resolve() == rows.resolve():
        hint = "Give them different names."
        raise UsageError(
            "-o and --table name the same file", where=str(target), hint=hint
        )
    models = read_models(given)
    from seqid_cli.trend.changes import trend_file, write_table

    ids = [model_id(name, file, files) for name, file in models]
    found = trend_file(models, ids, options)
    if rows is not None:
        write_table(rows, found)
    if target is not None:
        write_json_atomic(target, found, inputs=files)
    return found
