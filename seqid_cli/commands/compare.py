"""`seqid compare`: whether a result changed, beyond its standard errors."""

from dataclasses import replace
from pathlib import Path
from typing import Annotated, Literal

import typer

from seqid_cli.commands.job import EXIT_DONE, EXIT_UNTRUSTED
from seqid_cli.commands.options import only, option
from seqid_cli.commands.screen.render import Screen, percent, screen_of
from seqid_cli.params.results.comparison import ComparisonFile
from seqid_cli.params.results.tables import values

EXAMPLES = (
    "seqid compare sample_logs/two_joint/golden.json inertia.json",
    "seqid compare sample_logs/two_joint/golden.json inertia.json --sigma 3 --rtol 0.02 --json",
    "seqid compare sample_logs/two_joint/golden.json inertia.json --format github",
)
_SHOWN = 8  # unchanged numbers that the screen shows without -v
_limit = only("a number from 0 on", lambda x: x >= 0.0)
First = Annotated[Path, typer.Argument(metavar="A.json", help="What was, or what should be.")]
Second = Annotated[Path, typer.Argument(metavar="B.json", help="What is now.")]
Relative = Annotated[
    float | None,
    option(
        "--rtol X",
        "Share of a number's size beyond which it has changed; alone it decides.",
        _limit,
    ),
]
Sigma = Annotated[
    float | None,
    option(
        "--sigma S",
        "Combined standard errors beyond which it has changed; alone it decides.",
        _limit,
    ),
]
Form = Annotated[
    Literal["text", "json", "github"],
    option("--format", "A table, JSON, or annotations of GitHub Actions."),
]


def run(
    context: typer.Context,
    first: First,
    second: Second,
    rtol: Relative = None,
    sigma: Sigma = None,
    form: Form = "text",
) -> int:
    """Compare two parameter, prediction or diagnosis files of one robot.

    A number has changed when it moved by more than --sigma combined standard errors (4) and by more
    than the share --rtol of its size (0.01). Exits with 1 when any has.
    """
    screen = screen_of(context)
    if form == "json":
        screen = replace(screen, json=True)
    from seqid_cli.compare import compare

    found = compare(first, second, rtol=rtol, sigma=sigma)
    screen.document(found)
    if form == "github":
        _annotate(screen, found)
    else:
        _show(screen, found)
    for note in found.notes:
        screen.note(f"note: {note}")
    return EXIT_UNTRUSTED if found.changed else EXIT_DONE


def _show(screen: Screen, found: ComparisonFile) -> None:
    rest = [item for item in found.differences if not item.different]
    rest.sort(key=lambda item: -(item.relative or 0.0))
    changed = [item for item in found.differences if item.different]
    shown = [*changed, *(rest if screen.verbose else rest[:_SHOWN])]
    rows = []
    for x in shown:
        remark = f": {x.remark}" if x.remark else ""
        verdict = f"changed{remark}" if x.different else "same"
        rows.append((x.stage, x.name, x.joint or None, x.a, x.b, x.sigmas, x.relative, verdict))
    titles = "stage | number | joint | first | second | std errors | relative | verdict"
    screen.values(values(titles, "text text text number5 number5 number share text", rows))
    hidden = len(rest) - (len(shown) - found.changed)
    if hidden:
        screen.note(f"{hidden} more are unchanged (-v shows them)")
    screen.result(_summary(found))


def _summary(found: ComparisonFile) -> str:
    rule = found.rule
    limits = [] if rule.sigma is None else [f"{rule.sigma:g} standard errors"]
    limits.append(f"{100.0 * rule.rtol:g} % of its size")
    count = f"{found.changed} of {found.compared} numbers changed"
    return f"{count} (by more than {' and '.join(limits)})"


def _annotate(screen: Screen, found: ComparisonFile) -> None:
    """Print workflow commands, which GitHub shows beside the file."""
    for item in [item for item in found.differences if item.different]:
        where = f" of {item.joint}" if item.joint else ""
        title = _property(f"seqid: {item.stage} {item.name}{where} changed")
        text = item.remark
        if item.a is not None and item.b is not None:
            text = f"{item.a:.6g} became {item.b:.6g} {item.unit}".rstrip()
            text += "" if item.sigmas is None else f", {item.sigmas:.1f} standard errors"
            text += f", {percent(item.relative)} of its size"
            text += f" ({item.remark})" if item.remark else ""
        screen.result(f"::error file={_property(found.b)},title={title}::{_message(text)}")
    screen.result(f"::notice title=seqid compare::{_message(_summary(found))}")


def _message(text: str) -> str:
    return text.replace("%", "%25").replace("\r", "%0D").replace("\n", "%0A")


def _property(text: str) -> str:
    return _message(text).replace(":", "%3A").replace(",", "%2C")
