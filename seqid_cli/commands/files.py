"""The commands that read results alone: report, export, compare and trend."""

from pathlib import Path
from typing import Literal

import typer

from seqid_cli.commands.job import EXIT_DONE, EXIT_UNTRUSTED, called
from seqid_cli.commands.options import OUTPUT, SIX, command, only, option
from seqid_cli.commands.screen.render import Screen, number, percent
from seqid_cli.errors import UsageError
from seqid_cli.export.formats import BY_TARGET, BY_TITLE, FORMATS
from seqid_cli.params.files import By
from seqid_cli.params.results import tables
from seqid_cli.params.results.comparison import ComparisonFile, Difference
from seqid_cli.params.results.export import ExportFile
from seqid_cli.params.results.report import TITLES
from seqid_cli.params.results.trend import ChangeEntry

# Identified base parameters that no body has within so many standard errors are not
# noise.
MAX_STD_ERRORS = 4.0
_SHOWN = 8  # unchanged numbers that the screen shows without -v
_TWO = "sample_logs/two_joint"
_SUFFIXES = ", ".join(
    dict.fromkeys(f"{suffix} {name}" for suffix, name in FORMATS.items())
)
_limit = only("a number from 0 on", lambda x: x >= 0.0)
_share = only("between 0 and 1", lambda x: 0.0 < x < 1.0)


@command(
    "files output torques title by strict",
    "seqid report inertia.json prediction.json diagnosis.json -o report.html",
    "seqid report cell_*/inertia.json cell_*/prediction.json --by folder -o fleet.html",
    "seqid report refined.json prediction.json --torques torques.parquet -o report.html"
    " --json",
)
def report(
    context: typer.Context,
    files: list[Path] = typer.Argument(
        ...,
        metavar="FILE...",
        help="JSON files that seqid wrote, and the torques of seqid predict.",
    ),
    output: Path = option(..., "-o --output FILE", "Where the page goes, as HTML."),
    torques: Path | None = option(
        None,
        "--torques FILE",
        "What seqid predict wrote with --torques; found beside the prediction if left"
        " out.",
    ),
    title: str = option("", "--title TEXT", "Title, instead of the robot's name."),
    by: By | None = option(
        None,
        "--by",
        "A page about many robots, told apart by their names or by folders.",
    ),
) -> int:
    """Write one self-contained HTML page about a robot's model: the verdict first.

    Several models stand side by side; their torques lie in one plot. With --by it is a
    page about many robots.

    It opens offline and loads nothing. With --strict the exit code is 1 unless the
    verdict is good.
    """
    told, made = called(context, "report.report")
    screen = told.screen
    screen.result(f"{TITLES[made.verdict]}. {made.sentence}")
    for point in made.points:
        screen.result(f"- {point.text}")
    if lacking := [section.id for section in made.sections if not section.complete]:
        screen.note(
            f"sections that say which command gives their data: {', '.join(lacking)}"
        )
    screen.note(f"written: {made.output}")
    return told.ended(untrusted=made.verdict != "good")


@command(
    "parameters robot output target replay no_replay strict",
    "seqid export inertia.json -r sample_logs/six_joint/robot.toml -o six_joint.urdf",
    f"seqid export inertia.json -r {_TWO}/robot.toml -o two_joint.xml",
    f"seqid export refined.json -r {_TWO}/robot.toml -o two_joint.h --strict",
    f"seqid export refined.json -r {SIX}/robot.toml --target ur-friction -o"
    " friction.json",
)
def export(
    context: typer.Context,
    parameters: list[Path] = typer.Argument(
        ..., metavar="FILE...", help="Parameter file; several are joined."
    ),
    output: Path = option(
        ..., "-o --output FILE", f"Where it goes; by suffix: {_SUFFIXES}."
    ),
    target: str | None = option(
        None, "--target NAME", f"The form, whatever the suffix: {', '.join(BY_TARGET)}."
    ),
    replay: list[Path] = option(
        [],
        "--replay LOG",
        "Log to run what was written over, once per file, folder or glob; by default"
        " the held-out ones of the file.",
    ),
    no_replay: bool = option(
        False, "--no-replay", "Do not run what was written over logs."
    ),
) -> int:
    """Write an identified arm as URDF, MJCF, ROS 2 parameters, C, or what a controller takes.

    Links get inertial parameters that a body can have, with the identified torque, as
    near as possible to those of the URDF. A form that cannot hold the whole model gets
    the links and the Coulomb and viscous friction that lose least of its torque, and
    says how much that is. What was written is run over held-out logs: exits with 1
    where it is worse than it states.
    """
    if replay and no_replay:
        raise UsageError(
            "--replay and --no-replay exclude each other", hint="Give one of them."
        )
    told, file = called(context, "export.export")
    if not file.joints:
        _show_end(told.screen, file, output)
        return told.ended()
    screen, rows = told.screen, []
    for name, link in file.joints.items():
        center, fit = " ".join(number(x) for x in link.center_of_mass), link.friction
        friction: tuple[float | None, ...] = (None, None, None)
        if fit is not None:
            share = fit.rms_misfit / fit.rms if fit.rms > 0.0 else 0.0
            friction = (fit.coulomb, fit.viscous, share)
        loss = (file.loss.get(name),) if file.loss else ()
        rows.append((name, link.mass, center, link.armature, *friction, *loss))
    titles = (
        "joint | mass [kg] | centre of mass [m] | armature | Coulomb | viscous | misfit"
    )
    kinds = "text number4 text number number number share"
    if file.loss:
        titles, kinds = f"{titles} | loss [N m]", f"{kinds} number"
    screen.values(tables.values(titles, kinds, rows))
    if file.loss:
        screen.note("loss: RMS of the file's torque that this form does not have")
    if BY_TITLE[file.format].extent == "whole":
        screen.result(
            "the torque is exactly that of the file, with or without bodies that"
            " have it"
        )
    elif file.exact:
        screen.result(
            "the identified base parameters are met exactly by bodies that can exist"
        )
    else:
        _show_deviations(screen, file)
    failed = _show_replay(screen, file)
    _show_end(screen, file, output)
    code = told.ended(untrusted=file.largest_deviation > MAX_STD_ERRORS)
    return EXIT_UNTRUSTED if failed else code


def _show_end(screen: Screen, file: ExportFile, output: Path) -> None:
    for note in file.notes:
        screen.note(f"note: {note}")
    screen.note(f"written: {output} ({file.format})")


def _show_replay(screen: Screen, file: ExportFile) -> bool:
    """Show what the written file makes of logs; return whether it is worse than it states."""
    if file.replay is None:
        return False
    rows = [
        (name, joint.file_rmse, joint.export_rmse, joint.loss, joint.samples)
        for name, joint in file.replay.joints.items()
    ]
    if rows:
        count = len(file.replay.logs)
        screen.result(
            f"replayed over {count} log{'s' if count > 1 else ''}, RMS errors in N m:"
        )
        titles = "joint | parameter file | written file | loss there | samples"
        screen.values(tables.values(titles, "text number number number count", rows))
    for text in file.replay.failures:
        screen.warn(text)
    if file.replay.failures:
        screen.note(
            "do: export again and do not edit what was written; where a form loses too"
            " much for its use, export to C or numpy, which hold the whole model"
        )
    return not file.replay.passed


def _show_deviations(screen: Screen, file: ExportFile) -> None:
    far = [d for d in file.base_parameters if abs(d.std_errors or 0.0) >= 0.01]
    rows = [
        (d.name, d.identified, d.exported, f"{d.std_errors:+.2f}", d.unit) for d in far
    ]
    screen.result(
        "no body has the identified base parameters; the nearest ones are exported:"
    )
    titles = "parameter | identified | exported | std errors | unit"
    screen.values(tables.values(titles, "text number5 number5 text text", rows))
    if file.largest_deviation > MAX_STD_ERRORS:
        screen.warn(
            f"an exported base parameter is {file.largest_deviation:.1f} standard"
            " errors away from what was identified: geometry, gravity or torque scale"
            " of the robot file may be wrong"
        )


@command(
    "first second rtol sigma form",
    f"seqid compare {_TWO}/golden.json inertia.json",
    f"seqid compare {_TWO}/golden.json inertia.json --sigma 3 --rtol 0.02 --json",
    f"seqid compare {_TWO}/golden.json inertia.json --format github",
)
def compare(
    context: typer.Context,
    first: Path = typer.Argument(
        ..., metavar="A.json", help="What was, or what should be."
    ),
    second: Path = typer.Argument(..., metavar="B.json", help="What is now."),
    rtol: float | None = option(
        None,
        "--rtol X",
        "Share of a number's size beyond which it has changed; alone it decides.",
        _limit,
    ),
    sigma: float | None = option(
        None,
        "--sigma S",
        "Combined standard errors beyond which it has changed; alone it decides.",
        _limit,
    ),
    form: Literal["text", "json", "github"] = option(
        "text", "--format", "A table, JSON, or annotations of GitHub Actions."
    ),
) -> int:
    """Compare two parameter, prediction or diagnosis files of one robot.

    A number has changed when it moved by more than --sigma combined standard errors (4)
    and by more than the share --rtol of its size (0.01). Exits with 1 when any has.
    """
    context.params["json"] |= form == "json"
    told, found = called(context, "compare.compare")
    limit = (
        "" if found.rule.sigma is None else f"{found.rule.sigma:g} standard errors and "
    )
    limit += f"{100.0 * found.rule.rtol:g} % of its size"
    summary = (
        f"{found.changed} of {found.compared} numbers changed (by more than {limit})"
    )
    if form == "github":
        for item in found.differences:
            if item.different:
                told.screen.result(_annotation(item, found.b))
        told.screen.result(f"::notice title=seqid compare::{_escaped(summary)}")
    else:
        _show_comparison(told.screen, found)
        told.screen.result(summary)
    for note in found.notes:
        told.screen.note(f"note: {note}")
    return EXIT_UNTRUSTED if found.changed else EXIT_DONE


def _show_comparison(screen: Screen, found: ComparisonFile) -> None:
    changed, rest = (
        [x for x in found.differences if x.different == y] for y in (True, False)
    )
    rest.sort(key=lambda item: -(item.relative or 0.0))
    shown = rest if screen.verbose else rest[:_SHOWN]
    rows = []
    for x in (*changed, *shown):
        remark = f": {x.remark}" if x.remark else ""
        verdict = f"changed{remark}" if x.different else "same"
        rows.append(
            (x.stage, x.name, x.joint or None, x.a, x.b, x.sigmas, x.relative, verdict)
        )
    titles = "stage | number | joint | first | second | std errors | relative | verdict"
    screen.values(
        tables.values(titles, "text text text number5 number5 number share text", rows)
    )
    if len(shown) < len(rest):
        screen.note(f"{len(rest) - len(shown)} more are unchanged (-v shows them)")


def _annotation(item: Difference, path: str) -> str:
    """Return a workflow command, which GitHub shows beside the file."""
    where = f" of {item.joint}" if item.joint else ""
    title = f"seqid: {item.stage} {item.name}{where} changed"
    text = item.remark
    if item.a is not None and item.b is not None:
        text = f"{item.a:.6g} became {item.b:.6g} {item.unit}".rstrip()
        text += "" if item.sigmas is None else f", {item.sigmas:.1f} standard errors"
        text += f", {percent(item.relative)} of its size"
        text += f" ({item.remark})" if item.remark else ""
    return (
        "::error"
        f" file={_escaped(path, ':,')},title={_escaped(title, ':,')}::{_escaped(text)}"
    )


def _escaped(text: str, more: str = "") -> str:
    for sign in f"%\r\n{more}":
        text = text.replace(sign, f"%{ord(sign):02X}")
    return text


@command(
    "parameters output table by alpha rtol",
    f"seqid trend {_TWO}/golden.json inertia.json -o trend.json",
    "seqid trend sample_logs/*_joint/golden.json cell_*/*.json --by folder --table"
    " trend.parquet",
)
def trend(
    context: typer.Context,
    parameters: list[Path] = typer.Argument(
        ..., metavar="PARAMS.json...", help="Parameter files of several dates."
    ),
    output: Path | None = OUTPUT,
    table: Path | None = option(
        None, "--table FILE", "Where all values go, as Parquet."
    ),
    by: By = option(
        "name", "--by", "What tells robots apart: the name in their files, or folders."
    ),
    alpha: float = option(
        0.01,
        "--alpha P",
        "Probability that anything of healthy robots is said to change.",
        _share,
    ),
    rtol: float = option(
        0.01, "--rtol X", "Least change of a quantity, as a share of its size.", _share
    ),
) -> int:
    """Find out what changed on one or more robots over time, beyond its error.

    Each file is one date, that of its making. Steps and drifts of friction, parameters
    and effects are named with robot, joint and date. Exits with 1 when anything
    changed.
    """
    told, found = called(context, "trend.trend")
    screen = told.screen
    # of each robot, joint and stage
    clearest: dict[tuple[str, str, str], ChangeEntry] = {}
    for entry in found.changes:  # the clearest first
        name = entry.name if entry.stage == "effects" else ""
        clearest.setdefault((entry.robot, entry.joint, entry.stage + name), entry)
    shown = found.changes if screen.verbose else list(clearest.values())
    screen.values(tables.changes(shown))
    if hidden := len(found.changes) - len(shown):
        screen.note(f"{hidden} more of the same joint and stage (-v shows them)")
    robots = ", ".join(dict.fromkeys(entry.robot for entry in found.changes))
    screen.result(
        f"{f'changed: {robots}' if robots else 'nothing changed'} ({len(found.files)}"
        f" files of {len(found.robots)} robots, {len(found.series)} series; limit"
        f" {found.limit:.3g} standard errors)"
    )
    screen.remark(*found.notes)
    for path in (output, table):
        if path is not None:
            screen.note(f"written: {path}")
    return EXIT_UNTRUSTED if found.alarm else EXIT_DONE
