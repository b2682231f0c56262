"""`seqid report`: results as one HTML page."""

from pathlib import Path
from typing import Annotated

import typer

from seqid_cli.commands.command_run import CommandRun
from seqid_cli.commands.options import (
    DebugOption,
    JsonOption,
    NoColorOption,
    QuietOption,
    StrictOption,
    VerboseOption,
    command_app,
    examples,
)
from seqid_cli.params.files import By
from seqid_cli.params.results.report import TITLES

app = command_app()


@app.command(
    "report",
    epilog=examples(
        "seqid report inertia.json prediction.json diagnosis.json -o report.html",
        "seqid report cell_*/inertia.json cell_*/prediction.json --by folder -o"
        " fleet.html",
        "seqid report refined.json prediction.json --torques torques.parquet -o"
        " report.html --json",
        "seqid report refined.json diagnosis.json -o report.html --figures figures",
    ),
)
def report(
    *,
    files: Annotated[
        list[Path],
        typer.Argument(
            metavar="FILE...",
            help="JSON files that seqid wrote, and the torques of seqid predict.",
        ),
    ],
    output: Annotated[
        Path,
        typer.Option(
            "-o", "--output", metavar="FILE", help="Where the page goes, as HTML."
        ),
    ],
    torques: Annotated[
        Path | None,
        typer.Option(
            "--torques",
            metavar="FILE",
            help=(
                "What seqid predict wrote with --torques; found beside the prediction"
                " if left out."
            ),
        ),
    ] = None,
    title: Annotated[
        str,
        typer.Option(
            "--title", metavar="TEXT", help="Title, instead of the robot's name."
        ),
    ] = "",
    by: Annotated[
        By | None,
        typer.Option(
            "--by",
            help="A page about many robots, told apart by their names or by folders.",
        ),
    ] = None,
    figures: Annotated[
        Path | None,
        typer.Option(
            "--figures",
            metavar="FOLDER",
            help=(
                "Where the figures go as files that stand alone (SVG; PDF with"
                " seqid[figures]), and the parameters as a LaTeX table."
            ),
        ),
    ] = None,
    strict: StrictOption = False,
    quiet: QuietOption = False,
    verbose: VerboseOption = False,
    json: JsonOption = False,
    no_color: NoColorOption = False,
    debug: DebugOption = False,
) -> int:
    """Write one self-contained HTML page about a robot's model: the verdict first.

    Several models stand side by side; their torques lie in one plot. With --by it is a
    page about many robots.

    It opens offline and loads nothing. With --strict the exit code is 1 unless the
    verdict is good.
    """
    from seqid_cli.report import report as write_report

    with CommandRun(
        "report", quiet=quiet, verbose=verbose, json=json, no_color=no_color
    ) as run:
        file = write_report(
            files, output, torques=torques, title=title, by=by, figures=figures
        )
    run.screen.document(file)
    run.screen.result(f"{TITLES[file.verdict]}. {file.sentence}")
    for point in file.points:
        run.screen.result(f"- {point.text}")
    incomplete = [section.id for section in file.sections if not section.complete]
    if incomplete:
        run.screen.note(
            f"sections that say which command gives their data: {', '.join(incomplete)}"
        )
    run.screen.note(f"written: {file.output}")
    if file.figures:
        run.screen.note(f"{len(file.figures)} figures and tables in {figures}")
    return run.exit_code(strict=strict, is_untrusted=file.verdict != "good")
