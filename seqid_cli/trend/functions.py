"""The function `trend`: parameter files of several dates in, what changed out."""

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
        Its docstring says what can be set.
    output : path, optional
        Where the document goes.
    table : path, optional
        Where every quantity at every date goes, as Parquet.

    Returns
    -------
    TrendFile
        Every quantity over time, and the changes, the clearest first.

    Raises
    ------
    SeqidError
        Where the command would exit with 2.
    """
    models = listed(parameters)
    files = [Path(model) for model in models if not isinstance(model, ParameterFile)]
    output_path = optional(output)
    table_path = optional(table)
    _check_outputs(output_path, table_path, files)
    named_models = read_models(models)

    # Imported here because it imports numpy: a wrong path is told first.
    from seqid_cli.trend.changes import trend_file, write_table

    ids = [model_id(name, file, files) for name, file in named_models]
    document = trend_file(named_models, ids, options)
    if table_path is not None:
        write_table(table_path, document)
    if output_path is not None:
        write_json_atomic(output_path, document, inputs=files)
    return document


def _check_outputs(
    output: Path | None, table: Path | None, inputs: Sequence[Path]
) -> None:
    """Raise UsageError where a document or a table cannot be written to its path."""
    for path in (output, table):
        if path is not None:
            check_output(path, inputs)
    if output is None or table is None:
        return
    if output.resolve() == table.resolve():
        raise UsageError(
            "-o and --table name the same file",
            where=str(output),
            hint="Give them different names.",
        )
