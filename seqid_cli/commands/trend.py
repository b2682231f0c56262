"""`seqid trend`: what changed over time."""

from pathlib import Path
from typing import Annotated

import typer

from seqid_cli.commands.job import EXIT_DONE, EXIT_UNTRUSTED
from seqid_cli.commands.options import Output, only, option
from seqid_cli.commands.screen.render import Screen, screen_of
from seqid_cli.params.files import By
from seqid_cli.params.results import tables
from seqid_cli.params.results.trend import ChangeEntry, TrendFile

EXAMPLES = (
    "seqid trend sample_logs/two_joint/golden.json inertia.json -o trend.json",
    "seqid trend sample_logs/*_joint/golden.json cell_*/*.json --by folder --table trend.parquet",
)
_share = only("between 0 and 1", lambda x: 0.0 < x < 1.0)
Files = Annotated[
    list[Path], typer.Argument(metavar="PARAMS.json...", help="Parameter files of several dates.")
]
Table = Annotated[Path | None, option("--table FILE", "Where all values go, as Parquet.")]
ByOption = Annotated[
    By, option("--by", "What tells robots apart: the name in their files, or folders.")
]
Alpha = Annotated[
    float,
    option("--alpha P", "Probability that anything of healthy robots is said to change.", _share),
]
Relative = Annotated[
    float, option("--rtol X", "Least change of a quantity, as a share of its size.", _share)
]


def run(
    context: typer.Context,
    parameters: Files,
    output: Output = None,
    table: Table = None,
    by: ByOption = "name",
    alpha: Alpha = 0.01,
    rtol: Relative = 0.01,
) -> int:
    """Find out what changed on one or more robots over time, beyond its error.

    Each file is one date, that of its making. Steps and drifts of friction, parameters and effects
    are named with robot, joint and date. Exits with 1 when anything changed.
    """
    screen = screen_of(context)
    from seqid_cli import trend

    options = trend.TrendOptions(alpha=alpha, rtol=rtol, by=by)
    found = trend.trend(parameters, options, output=output, table=table)
    screen.document(found)
    _show(screen, found)
    screen.remark(*found.notes)
    for path in (output, table):
        if path is not None:
            screen.note(f"written: {path}")
    return EXIT_UNTRUSTED if found.alarm else EXIT_DONE


def _show(screen: Screen, found: TrendFile) -> None:
    clearest: dict[tuple[str, str, str], ChangeEntry] = {}  # of each robot, joint and stage
    for entry in found.changes:  # the clearest first
        name = entry.name if entry.stage == "effects" else ""
        clearest.setdefault((entry.robot, entry.joint, entry.stage + name), entry)
    shown = found.changes if screen.verbose else list(clearest.values())
    screen.values(tables.changes(shown))
    hidden = len(found.changes) - len(shown)
    if hidden:
        screen.note(f"{hidden} more of the same joint and stage (-v shows them)")
    robots = dict.fromkeys(entry.robot for entry in found.changes)
    files = f"{len(found.files)} files of {len(found.robots)} robots, {len(found.series)} series"
    limit = f"limit {found.limit:.3g} standard errors"
    if robots:
        screen.result(f"changed: {', '.join(robots)} ({files}; {limit})")
    else:
        screen.result(f"nothing changed ({files}; {limit})")
