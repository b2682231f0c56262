"""Results as one self-contained HTML page."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from seqid_cli.errors import UsageError
from seqid_cli.logs.given import PathLike, Paths, listed, warn
from seqid_cli.params.files import By, by_robot, check_output, write_text_atomic
from seqid_cli.params.io import OF_PAGE, Document, Source, read_any, read_trend
from seqid_cli.params.results.report import ReportFile, ReportPoint, ReportSection
from seqid_cli.params.schema import ParameterFile
from seqid_cli.report.plots import plot_evidence, plot_friction, plot_torques

if TYPE_CHECKING:
    from seqid_cli.report.views import Page

# Endings that promise something else than a page.
_OTHER_FORMS = frozenset({".pdf", ".docx", ".md", ".tex", ".json", ".svg", ".png"})

__all__ = ["plot_evidence", "plot_friction", "plot_torques", "report"]


def report(
    files: Paths,
    output: PathLike,
    *,
    torques: PathLike | None = None,
    title: str = "",
    by: By | None = None,
    figures: PathLike | None = None,
) -> ReportFile:
    """Write one self-contained HTML page about a robot's model: the verdict first.

    Parameters
    ----------
    files : path or sequence of paths
        Parameter, prediction, diagnosis, payload and plan files of one robot, of one
        model or several; torque files may be among them. Or one trend, which is a page
        of its own.
    output : path
        Where the page goes.
    torques : path, optional
        What `predict` wrote with `torques`; found beside each prediction if left out.
    title : str
        Instead of the robot's name.
    by : {"name", "folder"}, optional
        A page about many robots, told apart by their names or by the folders of their
        files.
    figures : path, optional
        A folder for the figures, each a file that stands alone (SVG, and PDF where
        `seqid[figures]` is installed), and for the parameters as a LaTeX table.

    Returns
    -------
    ReportFile
        The verdict with its points, and the files that the page was made of.

    Raises
    ------
    SeqidError
        Where the command would exit with 2.
    """
    target = Path(output)
    inputs = [Path(path) for path in listed(files)]
    if torques:
        inputs.append(Path(torques))
    tables = list(dict.fromkeys(path for path in inputs if path.suffix == ".parquet"))
    documents = [path for path in inputs if path not in tables]
    if not documents:
        raise UsageError(
            "no JSON file given", hint="Name the files that the stages wrote."
        )
    check_output(target, inputs)
    if target.suffix.lower() in _OTHER_FORMS:
        raise UsageError(
            f"the report is a web page, no {target.suffix} file",
            hint="Name it report.html, open it and print it: on paper it has sheets of"
            " its own. Figures for a paper: --figures FOLDER.",
            where=str(target),
        )

    trend = read_trend(documents[0]) if len(documents) == 1 else None
    sources = [] if trend is not None else read_any(documents, OF_PAGE)
    if trend is not None:
        from seqid_cli.report.trend import trend_page

        page = trend_page(trend, str(documents[0]), title=title)
    else:
        page = _page(sources, tables, title, by)
    html = page.html
    write_text_atomic(target, html, inputs=inputs)
    for warning in page.warnings:
        warn(warning)
    alone = [] if figures is None else _written_alone(page, sources, Path(figures))

    judgement = page.judgement
    return ReportFile(
        output=str(target),
        robot=page.robot,
        verdict=judgement.level,
        sentence=judgement.sentence,
        points=[
            ReportPoint(weight=point.weight, text=point.text, where=point.where)
            for point in judgement.points
        ],
        sections=[
            ReportSection(id=section.id, complete=section.complete)
            for section in page.sections
        ],
        files=list(page.files),
        torques=", ".join(page.torques) or None,
        bytes=len(html.encode()),
        figures=[str(path) for path in alone],
    )


def _written_alone(
    page: Page, sources: Sequence[Source[Document]], folder: Path
) -> list[Path]:
    """Write figures and tables that stand alone; return their paths."""
    from seqid_cli.report.latex import parameter_table
    from seqid_cli.report.standalone import write_figures

    paths = write_figures(page, folder)
    contents = [source.content for source in sources]
    models = [model for model in contents if isinstance(model, ParameterFile)]
    for number, model in enumerate(models, start=1):
        name = "parameters.tex" if len(models) == 1 else f"parameters-{number}.tex"
        write_text_atomic(folder / name, parameter_table(model))
        paths.append(folder / name)
    return paths


def _page(
    sources: Sequence[Source[Document]],
    torques: Sequence[Path],
    title: str,
    by: By | None,
) -> Page:
    """Return a page about one robot, or about many."""
    if by is None:
        from seqid_cli.report.make import make_report

        return make_report(sources, torques=torques, title=title)

    if torques:
        hint = "Leave the torque files out, or make a page for each robot."
        message = "torques over time are drawn on the page of one robot"
        raise UsageError(message, hint=hint, where=str(torques[0]))
    from seqid_cli.report.fleet import fleet_page

    named = [(source.path, source.content.robot.name, source) for source in sources]
    return fleet_page(by_robot(named, by), title=title)
