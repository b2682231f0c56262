"""Results as one self-contained HTML page."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from seqid_cli.errors import UsageError
from seqid_cli.logs.given import PathLike, Paths, listed, warn
from seqid_cli.params.files import By, by_robot, check_output, write_text_atomic
from seqid_cli.params.io import read_any, read_trend
from seqid_cli.params.results.report import ReportFile, ReportPoint, ReportSection
from seqid_cli.report.plots import plot_evidence, plot_friction, plot_torques

if TYPE_CHECKING:
    from seqid_cli.report.views import Page

__all__ = ["plot_evidence", "plot_friction", "plot_torques", "report"]


def report(
    files: Paths,
    output: PathLike,
    *,
    torques: PathLike | None = None,
    title: str = "",
    by: By | None = None,
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

    page = _page(documents, tables, title, by)
    html = page.html
    write_text_atomic(target, html, inputs=inputs)
    for warning in page.warnings:
        warn(warning)

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
    )


def _page(
    documents: Sequence[Path], torques: Sequence[Path], title: str, by: By | None
) -> Page:
    """Return a page about one robot, many, or what changed over time."""
    if len(documents) == 1:
        trend = read_trend(documents[0])
        if trend is not None:
            from seqid_cli.report.trend import trend_page

            return trend_page(trend, str(documents[0]), title=title)

    sources = read_any(documents)
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
