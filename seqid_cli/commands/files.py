"""The commands that read results alone: report, export, compare and trend."""

from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Literal

import typer

from seqid_cli.commands.command_run import EXIT_DONE, EXIT_UNTRUSTED, CommandRun
from seqid_cli.commands.options import (
    SIX,
    DebugOption,
    JsonOption,
    NoColorOption,
    OutputOption,
    QuietOption,
    RobotOption,
    StrictOption,
    VerboseOption,
    command_app,
    examples,
    number_check,
)
from seqid_cli.commands.robot_file import found_robot
from seqid_cli.commands.screen.render import Screen, number, percent, screen_for
from seqid_cli.errors import UsageError
from seqid_cli.export.formats import BY_TARGET, BY_TITLE, FORMATS
from seqid_cli.params.files import By
from seqid_cli.params.results import tables
from seqid_cli.params.results.comparison import ComparisonFile, Difference
from seqid_cli.params.results.export import ExportedLink, ExportFile
from seqid_cli.params.results.report import TITLES
from seqid_cli.params.results.trend import ChangeEntry, TrendFile

# A base parameter that the nearest bodies miss by more standard errors than this is
# not missed by noise: the robot file is wrong somewhere.
MAX_STD_ERRORS = 4.0
_SHOWN_UNCHANGED = 8  # numbers that the screen shows without -v
_SHOWN_STD_ERRORS = 0.01  # deviations below this are rounding
_TWO = "sample_logs/two_joint"
_SUFFIXES = ", ".join(
    dict.fromkeys(f"{suffix} {name}" for suffix, name in FORMATS.items())
)
_limit_check = number_check(lambda x: x >= 0.0, "a number from 0 on")
_share_check = number_check(lambda x: 0.0 < x < 1.0, "between 0 and 1")

app = command_app()


@app.command(
    "report",
    epilog=examples(
        "seqid report inertia.json prediction.json diagnosis.json -o report.html",
        "seqid report cell_*/inertia.json cell_*/prediction.json --by folder -o"
        " fleet.html",
        "seqid report refined.json prediction.json --torques torques.parquet -o"
        " report.html --json",
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

    screen = screen_for(
        "report", quiet=quiet, verbose=verbose, json=json, no_color=no_color
    )
    with CommandRun(screen) as run:
        file = write_report(files, output, torques=torques, title=title, by=by)
    screen.document(file)
    screen.result(f"{TITLES[file.verdict]}. {file.sentence}")
    for point in file.points:
        screen.result(f"- {point.text}")
    incomplete = [section.id for section in file.sections if not section.complete]
    if incomplete:
        screen.note(
            f"sections that say which command gives their data: {', '.join(incomplete)}"
        )
    screen.note(f"written: {file.output}")
    return run.exit_code(strict=strict, is_untrusted=file.verdict != "good")


@app.command(
    "export",
    epilog=examples(
        "seqid export inertia.json -r sample_logs/six_joint/robot.toml -o"
        " six_joint.urdf",
        f"seqid export inertia.json -r {_TWO}/robot.toml -o two_joint.xml",
        f"seqid export refined.json -r {_TWO}/robot.toml -o two_joint.h --strict",
        f"seqid export refined.json -r {SIX}/robot.toml --target ur-friction -o"
        " friction.json",
    ),
)
def export(
    *,
    parameters: Annotated[
        list[Path],
        typer.Argument(metavar="FILE...", help="Parameter file; several are joined."),
    ],
    robot: RobotOption = None,
    output: Annotated[
        Path,
        typer.Option(
            "-o",
            "--output",
            metavar="FILE",
            help=f"Where it goes; by suffix: {_SUFFIXES}.",
        ),
    ],
    target: Annotated[
        str | None,
        typer.Option(
            "--target",
            metavar="NAME",
            help=f"The form, whatever the suffix: {', '.join(BY_TARGET)}.",
        ),
    ] = None,
    replay: Annotated[
        list[Path] | None,
        typer.Option(
            "--replay",
            metavar="LOG",
            help=(
                "Log to run what was written over, once per file, folder or glob; by"
                " default the held-out ones of the file."
            ),
        ),
    ] = None,
    no_replay: Annotated[
        bool,
        typer.Option("--no-replay", help="Do not run what was written over logs."),
    ] = False,
    strict: StrictOption = False,
    quiet: QuietOption = False,
    verbose: VerboseOption = False,
    json: JsonOption = False,
    no_color: NoColorOption = False,
    debug: DebugOption = False,
) -> int:
    """Write an identified arm as URDF, MJCF, ROS 2 parameters, C, or \
what a controller takes.

    Links get inertial parameters that a body can have, with the identified torque, as
    near as possible to those of the URDF. A form that cannot hold the whole model gets
    the links and the Coulomb and viscous friction that lose least of its torque, and
    says how much that is. What was written is run over held-out logs: exits with 1
    where it is worse than it states.
    """  # noqa: D205
    from seqid_cli.export import export as write_export

    screen = screen_for(
        "export", quiet=quiet, verbose=verbose, json=json, no_color=no_color
    )
    robot = robot or found_robot(screen, [])
    if replay and no_replay:
        raise UsageError(
            "--replay and --no-replay exclude each other", hint="Give one of them."
        )
    with CommandRun(screen) as run:
        file = write_export(
            parameters,
            robot,
            output,
            target=target,
            replay=replay or (),
            no_replay=no_replay,
        )
    screen.document(file)
    has_failed = False
    if file.joints:
        _show_links(screen, file)
        _show_fidelity(screen, file)
        has_failed = _show_replay(screen, file)
    for note in file.notes:
        screen.note(f"note: {note}")
    screen.note(f"written: {output} ({file.format})")

    is_far = bool(file.joints) and file.largest_deviation > MAX_STD_ERRORS
    code = run.exit_code(strict=strict, is_untrusted=is_far)
    return EXIT_UNTRUSTED if has_failed else code


def _show_links(screen: Screen, file: ExportFile) -> None:
    """Print a row per joint: its link, its friction, and the torque that is lost."""
    titles = (
        "joint | mass [kg] | centre of mass [m] | armature | Coulomb | viscous | misfit"
    )
    kinds = "text number4 text number number number share"
    if file.loss:
        titles = f"{titles} | loss [N m]"
        kinds = f"{kinds} number"

    rows = []
    for name, link in file.joints.items():
        center = " ".join(number(x) for x in link.center_of_mass)
        row = [name, link.mass, center, link.armature, *_friction_cells(link)]
        if file.loss:
            row.append(file.loss.get(name))
        rows.append(row)
    screen.values(tables.values(titles, kinds, rows))
    if file.loss:
        screen.note("loss: RMS of the file's torque that this form does not have")


def _friction_cells(link: ExportedLink) -> list[float | None]:
    """Return Coulomb and viscous friction, and the share that they do not describe."""
    fit = link.friction
    if fit is None:
        return [None, None, None]
    misfit_share = fit.rms_misfit / fit.rms if fit.rms > 0.0 else 0.0
    return [fit.coulomb, fit.viscous, misfit_share]


def _show_fidelity(screen: Screen, file: ExportFile) -> None:
    """Say how near what is written is to what was identified."""
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


def _show_deviations(screen: Screen, file: ExportFile) -> None:
    """Print the base parameters that the nearest bodies do not have."""
    rows = [
        (x.name, x.identified, x.exported, f"{x.std_errors:+.2f}", x.unit)
        for x in file.base_parameters
        if abs(x.std_errors or 0.0) >= _SHOWN_STD_ERRORS
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


def _show_replay(screen: Screen, file: ExportFile) -> bool:
    """Show the replay of the written file; return whether it is worse than stated."""
    if file.replay is None:
        return False
    rows = [
        (name, joint.file_rmse, joint.export_rmse, joint.loss, joint.samples)
        for name, joint in file.replay.joints.items()
    ]
    if rows:
        count = len(file.replay.logs)
        logs = "1 log" if count == 1 else f"{count} logs"
        screen.result(f"replayed over {logs}, RMS errors in N m:")
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

    screen = screen_for(
        "compare",
        quiet=quiet,
        verbose=verbose,
        json=json or form == "json",
        no_color=no_color,
    )
    with CommandRun(screen):
        file = compare_files(first, second, rtol=rtol, sigma=sigma)
    screen.document(file)
    summary = _summary(file)
    if form == "github":
        for item in file.differences:
            if item.different:
                screen.result(_annotation(item, file.b))
        screen.result(f"::notice title=seqid compare::{_escaped(summary)}")
    else:
        _show_comparison(screen, file)
        screen.result(summary)
    for note in file.notes:
        screen.note(f"note: {note}")
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
    unchanged.sort(key=lambda item: -(item.relative or 0.0))
    shown = unchanged if screen.verbose else unchanged[:_SHOWN_UNCHANGED]

    rows = []
    for item in (*changed, *shown):
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
    kinds = "text text text number5 number5 number share text"
    screen.values(tables.values(titles, kinds, rows))
    hidden_count = len(unchanged) - len(shown)
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
        text += f", {percent(item.relative)} of its size"
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

    Each file is one date, that of its making. Steps and drifts of friction, parameters
    and effects are named with robot, joint and date. Exits with 1 when anything
    changed.
    """
    from seqid_cli.trend import TrendOptions
    from seqid_cli.trend import trend as find_changes

    screen = screen_for(
        "trend", quiet=quiet, verbose=verbose, json=json, no_color=no_color
    )
    options = TrendOptions(alpha=alpha, rtol=rtol, by=by)
    with CommandRun(screen):
        file = find_changes(parameters, options, output=output, table=table)
    screen.document(file)
    _show_trend(screen, file)
    for path in (output, table):
        if path is not None:
            screen.note(f"written: {path}")
    return EXIT_UNTRUSTED if file.alarm else EXIT_DONE


def _show_trend(screen: Screen, file: TrendFile) -> None:
    """Print the changes, of each joint and stage the clearest, and the robots."""
    shown = file.changes if screen.verbose else _clearest(file.changes)
    screen.values(tables.changes(shown))
    hidden_count = len(file.changes) - len(shown)
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
