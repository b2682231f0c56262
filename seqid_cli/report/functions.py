"""Writing a report as a function: documents in, one page out."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from seqid_cli.errors import UsageError
from seqid_cli.logs.given import PathLike, Paths, listed, optional, warn
from seqid_cli.params.files import By, check_output, robot_names, write_text_atomic
from seqid_cli.params.io import Source, read_any, read_trend
from seqid_cli.params.results.report import ReportFile, ReportPoint, ReportSection

if TYPE_CHECKING:
    from seqid_cli.report.judgement import Judgement
    from seqid_cli.report.views import Section

_MAGIC = b"PAR1"


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
        Parameter, prediction, diagnosis, payload and plan files of one robot, of one model or
        several; torque files may be among them. Or one trend, which is a page of its own.
    output : path
        Where the page goes.
    torques : path, optional
        What `predict` wrote with `torques`; found beside each prediction if left out.
    title : str
        Instead of the robot's name.
    by : {"name", "folder"}, optional
        A page about many robots, told apart by their names or by the folders of their files.
    """
    target = Path(output)
    documents, tables = _sorted([Path(path) for path in listed(files)], optional(torques))
    inputs = [*documents, *tables]
    check_output(target, inputs)
    if len(documents) == 1 and (found := read_trend(documents[0])) is not None:
        from seqid_cli.report.trend import trend_page

        page = trend_page(found, title=title)
        return _page_of_many(page, ", ".join(found.robots), documents, target)
    sources = read_any(documents)
    if by is not None:
        robots = _by_robot(sources, tables, by)
        from seqid_cli.report.fleet import fleet_page

        return _page_of_many(fleet_page(robots, title=title), ", ".join(robots), documents, target)
    from seqid_cli.report.make import make_report

    made = make_report(sources, torques=tables, title=title)
    write_text_atomic(target, made.html, inputs=inputs)
    for warning in made.collection.warnings:
        warn(warning)
    judgement = made.judgement
    return ReportFile(
        output=str(target),
        robot=made.collection.robot.name,
        verdict=judgement.level,
        sentence=judgement.sentence,
        points=_points(judgement),
        sections=[ReportSection(id=name, complete=all_) for name, all_ in made.sections.items()],
        files=[item.path for item in made.collection.sources],
        torques=", ".join(made.torques) or None,
        bytes=len(made.html.encode()),
    )


def _by_robot(
    sources: Sequence[Source], torques: Sequence[Path], by: By
) -> dict[str, list[Source]]:
    if torques:
        hint = "Leave the torque files out, or make a page for each robot."
        message = "torques over time are drawn on the page of one robot"
        raise UsageError(message, hint=hint, where=str(torques[0]))
    robots: dict[str, list[Source]] = {}
    names = robot_names([(item.path, item.content.robot.name) for item in sources], by)
    for name, item in zip(names, sources, strict=True):
        robots.setdefault(name, []).append(item)
    return robots


def _page_of_many(
    page: tuple[str, Judgement, list[Section]], robots: str, files: Sequence[Path], target: Path
) -> ReportFile:
    """Write a page about many robots or dates."""
    html, judgement, sections = page
    write_text_atomic(target, html, inputs=files)
    return ReportFile(
        output=str(target),
        robot=robots,
        verdict=judgement.level,
        sentence=judgement.sentence,
        points=_points(judgement),
        sections=[ReportSection(id=section.id, complete=True) for section in sections],
        files=list(map(str, files)),
        torques=None,
        bytes=len(html.encode()),
    )


def _points(judgement: Judgement) -> list[ReportPoint]:
    return [ReportPoint(weight=p.weight, text=p.text, where=p.where) for p in judgement.points]


def _sorted(files: Sequence[Path], torques: Path | None) -> tuple[list[Path], list[Path]]:
    """Separate the torque tables from the documents, by their first bytes or names."""
    tables = [path for path in files if path.suffix == ".parquet" or _is_parquet(path)]
    documents = [path for path in files if path not in tables]
    given = list(dict.fromkeys([*tables, *([torques] if torques else [])]))
    if not documents:
        raise UsageError("no JSON file given", hint="Name the files that the stages wrote.")
    return documents, given


def _is_parquet(path: Path) -> bool:
    try:
        with path.open("rb") as file:
            return file.read(len(_MAGIC)) == _MAGIC
    except (OSError, ValueError):
        return False  # whoever reads it says what is wrong with it
