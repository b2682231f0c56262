"""`seqid report`: results as one HTML page."""

from pathlib import Path
from typing import Annotated

import typer

from seqid_cli.commands.job import listening
from seqid_cli.commands.options import Strict, option
from seqid_cli.commands.screen.render import Screen
from seqid_cli.params.files import By
from seqid_cli.params.results.report import TITLES, ReportFile

EXAMPLES = (
    "seqid report inertia.json prediction.json diagnosis.json -o report.html",
    "seqid report cell_*/inertia.json cell_*/prediction.json --by folder -o fleet.html",
    "seqid report refined.json prediction.json --torques torques.parquet -o report.html --json",
)

Files = Annotated[
    list[Path],
    typer.Argument(
        metavar="FILE...", help="JSON files that seqid wrote, and the torques of seqid predict."
    ),
]
Page = Annotated[Path, option("-o --output FILE", "Where the page goes, as HTML.")]
Torques = Annotated[
    Path | None,
    option(
        "--torques FILE",
        "What seqid predict wrote with --torques; found beside the prediction if left out.",
    ),
]
Title = Annotated[str, option("--title TEXT", "Title, instead of the robot's name.")]


ByOption = Annotated[
    By | None, option("--by", "A page about many robots, told apart by their names or by folders.")
]


def run(
    context: typer.Context,
    files: Files,
    output: Page,
    torques: Torques = None,
    title: Title = "",
    by: ByOption = None,
    strict: Strict = False,
) -> int:
    """Write one self-contained HTML page about a robot's model: the verdict first.

    Several models stand side by side; their torques lie in one plot. With --by it is a page about
    many robots.

    It opens offline and loads nothing. With --strict the exit code is 1 unless the verdict is good.
    """
    with listening(context) as told:
        from seqid_cli.report import report

        made = report(files, output, torques=torques, title=title, by=by)
    told.screen.document(made)
    _show(told.screen, made)
    return told.ended(untrusted=made.verdict != "good")


def _show(screen: Screen, report: ReportFile) -> None:
    screen.result(f"{TITLES[report.verdict]}. {report.sentence}")
    for point in report.points:
        screen.result(f"- {point.text}")
    lacking = [section.id for section in report.sections if not section.complete]
    if lacking:
        screen.note(f"sections that say which command gives their data: {', '.join(lacking)}")
    screen.note(f"written: {report.output}")
