"""`seqid report`: the results of one robot as one HTML page."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from seqid_cli.commands.job import exit_code
from seqid_cli.commands.options import Strict
from seqid_cli.commands.render import Screen, screen_of
from seqid_cli.errors import UsageError
from seqid_cli.params.files import check_output, write_text_atomic
from seqid_cli.params.read_any import read_any

if TYPE_CHECKING:
    from seqid_cli.report.make import Report

EXAMPLES = (
    "seqid report inertia.json prediction.json diagnosis.json -o report.html",
    "seqid report refined.json prediction.json --torques torques.parquet -o report.html --json",
)
_MAGIC = b"PAR1"

Files = Annotated[
    list[Path],
    typer.Argument(
        metavar="FILE...", help="JSON files that seqid wrote, and the torques of seqid predict."
    ),
]
Page = Annotated[
    Path,
    typer.Option("-o", "--output", metavar="FILE", help="Where the page goes, as HTML."),
]
Torques = Annotated[
    Path | None,
    typer.Option(
        metavar="FILE",
        help="What seqid predict wrote with --torques; found beside the prediction if left out.",
    ),
]
Title = Annotated[str, typer.Option(metavar="TEXT", help="Title, instead of the robot's name.")]


def run(
    context: typer.Context,
    files: Files,
    output: Page,
    torques: Torques = None,
    title: Title = "",
    strict: Strict = False,
) -> int:
    """Write one self-contained HTML page about a robot's model: the verdict first.

    It opens offline and loads nothing. With --strict the exit code is 1 unless the verdict is good.
    """
    screen = screen_of(context)
    documents, table = _sorted(files, torques)
    check_output(output, [*documents, *([table] if table else [])])
    sources = read_any(documents)

    from seqid_cli.report.make import build_report

    report = build_report(sources, torques=table, title=title)
    write_text_atomic(output, report.html, inputs=[*documents, *([table] if table else [])])
    screen.document(_summary(report, output))
    _show(screen, report, output)
    return exit_code(untrusted=strict and report.judgement.level != "good", partial=())


def _sorted(files: Sequence[Path], torques: Path | None) -> tuple[list[Path], Path | None]:
    """Tell the torque table from the documents, by its first bytes or its name."""
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


def _summary(report: Report, output: Path) -> dict[str, object]:
    judgement = report.judgement
    return {
        "output": str(output),
        "robot": report.collection.robot.name,
        "verdict": judgement.level,
        "sentence": judgement.sentence,
        "points": [
            {"weight": p.weight, "text": p.text, "where": p.where} for p in judgement.points
        ],
        "sections": [{"id": name, "complete": whole} for name, whole in report.sections.items()],
        "files": [item.path for item in report.collection.sources],
        "torques": report.torques or None,
        "bytes": len(report.html.encode()),
    }


def _show(screen: Screen, report: Report, output: Path) -> None:
    judgement = report.judgement
    screen.result(f"{judgement.title}. {judgement.sentence}")
    for point in judgement.points:
        screen.result(f"- {point.text}")
    for warning in report.collection.warnings:
        screen.warn(warning)
    lacking = [name for name, whole in report.sections.items() if not whole]
    if lacking:
        screen.note(f"sections that say which command gives their data: {', '.join(lacking)}")
    screen.note(f"written: {output}")
