"""Writing a report as a function: documents in, one page out."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from seqid_cli.errors import UsageError
from seqid_cli.logs.given import PathLike, Paths, listed, optional, warn
from seqid_cli.params.files import check_output, write_text_atomic
from seqid_cli.params.io import read_any, read_trend
from seqid_cli.params.results.report import ReportFile, ReportPoint, ReportSection
from seqid_cli.params.results.trend import TrendFile

_MAGIC = b"PAR1"


def report(
    files: Paths, output: PathLike, *, torques: PathLike | None = None, title: str = ""
) -> ReportFile:
    """Write one self-contained HTML page about a robot's model: the verdict first.

    Parameters
    ----------
    files : path or sequence of paths
        Parameter, prediction, diagnosis, payload and plan files of one robot; a torque file may be
        among them. Or one trend, which is a page of its own.
    output : path
        Where the page goes.
    torques : path, optional
        What `predict` wrote with `torques`; found beside the prediction if left out.
    title : str
        Instead of the robot's name.
    """
    target = Path(output)
    documents, table = _sorted([Path(path) for path in listed(files)], optional(torques))
    inputs = [*documents, *([table] if table else [])]
    check_output(target, inputs)
    if len(documents) == 1 and (found := read_trend(documents[0])) is not None:
        return _trend_report(found, documents[0], target, title)
    sources = read_any(documents)
    from seqid_cli.report.make import make_report

    made = make_report(sources, torques=table, title=title)
    write_text_atomic(target, made.html, inputs=inputs)
    for warning in made.collection.warnings:
        warn(warning)
    judgement = made.judgement
    return ReportFile(
        output=str(target),
        robot=made.collection.robot.name,
        verdict=judgement.level,
        sentence=judgement.sentence,
        points=[ReportPoint(weight=p.weight, text=p.text, where=p.where) for p in judgement.points],
        sections=[ReportSection(id=name, complete=all_) for name, all_ in made.sections.items()],
        files=[item.path for item in made.collection.sources],
        torques=made.torques or None,
        bytes=len(made.html.encode()),
    )


def _trend_report(file: TrendFile, path: Path, target: Path, title: str) -> ReportFile:
    """Write the page of a trend, which is one of its own."""
    from seqid_cli.report.trend import trend_page

    html, judgement, sections = trend_page(file, title=title)
    write_text_atomic(target, html, inputs=[path])
    return ReportFile(
        output=str(target),
        robot=", ".join(file.robots),
        verdict=judgement.level,
        sentence=judgement.sentence,
        points=[],
        sections=[ReportSection(id=section.id, complete=True) for section in sections],
        files=[str(path)],
        torques=None,
        bytes=len(html.encode()),
    )


def _sorted(files: Sequence[Path], torques: Path | None) -> tuple[list[Path], Path | None]:
    """Separate the torque table from the documents, by its first bytes or its name."""
    tables = [path for path in files if path.suffix == ".parquet" or _is_parquet(path)]
    documents = [path for path in files if path not in tables]
    given = list(dict.fromkeys([*tables, *([torques] if torques else [])]))
    if len(given) > 1:
        names = ", ".join(map(str, given))
        message = f"one torque file can be shown, not {len(given)}: {names}"
        raise UsageError(message, hint="Name the one that belongs to the prediction.")
    if not documents:
        raise UsageError("no JSON file given", hint="Name the files that the stages wrote.")
    return documents, given[0] if given else None


def _is_parquet(path: Path) -> bool:
    try:
        with path.open("rb") as file:
            return file.read(len(_MAGIC)) == _MAGIC
    except (OSError, ValueError):
        return False  # whoever reads it says what is wrong with it
