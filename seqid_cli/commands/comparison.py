"""The commands that hold results against each other: compare and trend."""

from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Literal

import typer

from seqid_cli import shares
from seqid_cli.commands.command_run import EXIT_DONE, EXIT_UNTRUSTED, CommandRun
from seqid_cli.commands.options import (
    DebugOption,
    JsonOption,
    NoColorOption,
    OutputOption,
    QuietOption,
    VerboseOption,
    command_app,
    examples,
    number_check,
)
from seqid_cli.commands.screen.render import Screen
from seqid_cli.params.files import By
from seqid_cli.params.results import tables
from seqid_cli.params.results.comparison import ComparisonFile, Difference
from seqid_cli.params.results.trend import ChangeEntry, TrendFile

_SHOWN_UNCHANGED = 8  # numbers that the screen shows without -v
_TWO = "sample_logs/two_joint"
_limit_check = number_check(lambda x: x >= 0.0, "a number from 0 on")
_share_check = number_check(lambda x: 0.0 < x < 1.0, "between 0 and 1")

app = command_app()


@app.command(
    "compare",
    epilog=examples(
        f"seqid compare {_TWO}/golden.json inertia.json",
        f"seqid compare {_TWO}/golden.json inertia.json --sigma 3 --rtol 0.02 --json",
        f"seqid compare {_TWO}/golden.json inertia.json --format github",
    ),
)
def compare(
    *,
    first: Annotated[
        Path, typer.Argument(metavar="A.json", help="What was, or what should be.")
    ],
    second: Annotated[Path, typer.Argument(metavar="B.json", help="What is now.")],
    rtol: Annotated[
        float | None,
        typer.Option(
            "--rtol",
            metavar="X",
            callback=_limit_check,
            help=(
                "Share of a number's size beyond which it has changed; alone it"
                " decides."
            ),
        ),
    ] = None,
    sigma: Annotated[
        float | None,
        typer.Option(
            "--sigma",
            metavar="S",
            callback=_limit_check,
            help=(
                "Combined standard errors beyond which it has changed; alone it"
                " decides."
            ),
        ),
    ] = None,
    form: Annotated[
        Literal["text", "json", "github"],
        typer.Option(
            "--format", help="A table, JSON, or annotations of GitHub Actions."
        ),
    ] = "text",
    quiet: QuietOption = False,
    verbose: VerboseOption = False,
    json: JsonOption = False,
    no_color: NoColorOption = False,
    debug: DebugOption = False,
) -> int:
    """Compare two parameter, prediction or diagnosis files of one robot.

    A number has changed when it moved by more than --sigma combined standard errors (4)
    and by more than the share --rtol of its size (0.01). Exits with 1 when any has.
    """
    from seqid_cli.compare import compare as compare_files

    with CommandRun(
        "compare",
        quiet=quiet,
        verbose=verbose,
        json=json or form == "json",
        no_color=no_color,
    ) as run:
        file = compare_files(first, second, rtol=rtol, sigma=sigma)
    run.screen.document(file)
    summary = _summary(file)
    if form == "github":
        for item in file.differences:
            if item.different:
                run.screen.result(_annotation(item, file.b))
        run.screen.result(f"::notice title=seqid compare::{_escaped(summary)}")
    else:
        _show_comparison(run.screen, file)
        run.screen.result(summary)
    for note in file.notes:
        run.screen.note(f"note: {note}")
    return EXIT_UNTRUSTED if file.changed else EXIT_DONE


def _summary(file: ComparisonFile) -> str:
    """Return how many numbers changed, and by which rule, in one line."""
    limit = f"{100.0 * file.rule.rtol:g} % of its size"
    if file.rule.sigma is not None:
        limit = f"{file.rule.sigma:g} standard errors and {limit}"
    return f"{file.changed} of {file.compared} numbers changed (by more than {limit})"


def _show_comparison(screen: Screen, file: ComparisonFile) -> None:
    """Print the changed numbers, and the most different of the unchanged ones."""
    changed = [item for item in file.differences if item.different]
    unchanged = [item for item in file.differences if not item.different]
    unchanged.sort(key=lambda item: -abs(item.relative or 0.0))
    listed = unchanged if screen.verbose else unchanged[:_SHOWN_UNCHANGED]

    rows = []
    for item in (*changed, *listed):
        verdict = "changed" if item.different else "same"
        if item.different and item.remark:
            verdict = f"changed: {item.remark}"
        row = (
            item.stage,
            item.name,
            item.joint or None,
            item.a,
            item.b,
            item.sigmas,
            item.relative,
            verdict,
        )
        rows.append(row)
    titles = "stage | number | joint | first | second | std errors | relative | verdict"
    kinds = "text text text number5 number5 number share_change text"
    screen.values(tables.values(titles, kinds, rows))
    hidden_count = len(unchanged) - len(listed)
    if hidden_count:
        screen.note(f"{hidden_count} more are unchanged (-v shows them)")


def _annotation(item: Difference, path: str) -> str:
    """Return a workflow command, which GitHub shows beside the file."""
    where = f" of {item.joint}" if item.joint else ""
    title = f"seqid: {item.stage} {item.name}{where} changed"
    text = item.remark
    if item.a is not None and item.b is not None:
        text = f"{item.a:.6g} became {item.b:.6g} {item.unit}".rstrip()
        if item.sigmas is not None:
            text += f", {item.sigmas:.1f} standard errors"
        text += f", {shares.change_in_percent(item.relative)}"
        if item.remark:
            text += f" ({item.remark})"
    file = _escaped(path, ":,")
    return f"::error file={file},title={_escaped(title, ':,')}::{_escaped(text)}"


def _escaped(text: str, further_signs: str = "") -> str:
    """Return a text for a workflow command, in which these signs would end a part."""
    # The percent sign comes first: the others become codes that begin with it.
    for sign in f"%\r\n{further_signs}":
        text = text.replace(sign, f"%{ord(sign):02X}")
    return text


@app.command(
    "trend",
    epilog=examples(
        f"seqid trend {_TWO}/golden.json inertia.json -o trend.json",
        "seqid trend sample_logs/*_joint/golden.json cell_*/*.json --by folder --table"
        " trend.parquet",
    ),
)
def trend(
    *,
    parameters: Annotated[
        list[Path],
        typer.Argument(
            metavar="PARAMS.json...", help="Parameter files of several dates."
        ),
    ],
    output: OutputOption = None,
    table: Annotated[
        Path | None,
        typer.Option(
            "--table", metavar="FILE", help="Where all values go, as Parquet."
        ),
    ] = None,
    by: Annotated[
        By,
        typer.Option(
            "--by", help="What tells robots apart: the name in their files, or folders."
        ),
    ] = "name",
    alpha: Annotated[
        float,
        typer.Option(
            "--alpha",
            metavar="P",
            callback=_share_check,
            help="Probability that anything of healthy robots is said to change.",
        ),
    ] = 0.01,
    rtol: Annotated[
        float,
        typer.Option(
            "--rtol",
            metavar="X",
            callback=_share_check,
            help="Least change of a quantity, as a share of its size.",
        ),
    ] = 0.01,
    quiet: QuietOption = False,
    verbose: VerboseOption = False,
    json: JsonOption = False,
    no_color: NoColorOption = False,
    debug: DebugOption = False,
) -> int:
    """Find out what changed on one or more robots over time, beyond its error.

    The date of a file is that of its newest log. Steps and drifts of friction,
    parameters and effects are named with robot, joint and date. Exits with 1 when
    anything changed.
    """
    from seqid_cli.trend import TrendOptions
    from seqid_cli.trend import trend as find_changes

    with CommandRun(
        "trend", quiet=quiet, verbose=verbose, json=json, no_color=no_color
    ) as run:
        options = TrendOptions(alpha=alpha, rtol=rtol, by=by)
        file = find_changes(parameters, options, output=output, table=table)
    run.screen.document(file)
    _show_trend(run.screen, file)
    for path in (output, table):
        if path is not None:
            run.screen.note(f"written: {path}")
    return EXIT_UNTRUSTED if file.alarm else EXIT_DONE


def _show_trend(screen: Screen, file: TrendFile) -> None:
    """Print the changes, of each joint and stage the clearest, and the robots."""
    listed = file.changes if screen.verbose else _clearest(file.changes)
    screen.values(tables.changes(listed))
    hidden_count = len(file.changes) - len(listed)
    if hidden_count:
        screen.note(f"{hidden_count} more of the same joint and stage (-v shows them)")

    robots = ", ".join(dict.fromkeys(change.robot for change in file.changes))
    what_changed = f"changed: {robots}" if robots else "nothing changed"
    screen.result(
        f"{what_changed} ({len(file.files)} files of {len(file.robots)} robots,"
        f" {len(file.series)} series; limit {file.limit:.3g} standard errors)"
    )
    screen.remark(*file.notes)


def _clearest(changes: Sequence[ChangeEntry]) -> list[ChangeEntry]:
    """Return one change of each robot, joint and stage, and of each effect."""
    clearest: dict[tuple[str, str, str], ChangeEntry] = {}
    for change in changes:  # the clearest first
        effect = change.name if change.stage == "effects" else ""
        place = (change.robot, change.joint, change.stage + effect)
        clearest.setdefault(place, change)
    return list(clearest.values())
