"""The commands that look at logs before anything is identified: init and inspect."""

import os
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import typer

from seqid_cli.commands.command_run import (
    EXIT_DONE,
    EXIT_PARTIAL,
    EXIT_UNTRUSTED,
    CommandRun,
    quoted,
)
from seqid_cli.commands.found_urdf import FoundUrdf, found_urdf
from seqid_cli.commands.options import (
    SIX,
    DebugOption,
    ExcludeOption,
    FromOption,
    JsonOption,
    LogsArgument,
    NoColorOption,
    OutputOption,
    QuietOption,
    SetOption,
    ShowSettingsOption,
    TimeOption,
    ToOption,
    VerboseOption,
    command_app,
    examples,
    is_positive,
    number_check,
)
from seqid_cli.commands.robot_file import found_robot_if_any
from seqid_cli.commands.screen.render import Screen, screen_for
from seqid_cli.commands.screen.show_inspection import show_inspection
from seqid_cli.errors import UsageError
from seqid_cli.logs.reading import LogPart, Reading
from seqid_cli.logs.storage.files import check_log, expand
from seqid_cli.params.files import check_output, write_text_atomic
from seqid_cli.params.results.inspection import InspectionFile
from seqid_cli.robot.urdf import read_urdf_text

if TYPE_CHECKING:
    from collections.abc import Sequence

    from seqid_cli.inspect.propose import Proposal

EXIT_UNREADABLE = 2

app = command_app()


@app.command(
    "inspect",
    epilog=examples(
        f"seqid inspect {SIX}/friction -r {SIX}/robot.toml",
        "seqid inspect sample_logs/two_joint/imu --json",
    ),
)
def inspect(
    *,
    logs: LogsArgument,
    robot: Annotated[
        Path | None,
        typer.Option(
            "-r",
            "--robot",
            metavar="FILE",
            help=(
                "Robot file; ./robot.toml or one beside the logs when left out, else"
                " joints are guessed."
            ),
        ),
    ] = None,
    plan: Annotated[
        Path | None,
        typer.Option(
            "--plan",
            metavar="FILE",
            help="A plan: say which of its moves these logs hold.",
        ),
    ] = None,
    output: OutputOption = None,
    time_source: TimeOption = "header",
    start: FromOption = None,
    stop: ToOption = None,
    exclude: ExcludeOption = None,
    strict: Annotated[
        bool,
        typer.Option(
            "--strict", help="Exit with 1 on warnings and unrecorded moves as well."
        ),
    ] = False,
    set_values: SetOption = None,
    show_settings: ShowSettingsOption = False,
    quiet: QuietOption = False,
    verbose: VerboseOption = False,
    json: JsonOption = False,
    no_color: NoColorOption = False,
    debug: DebugOption = False,
) -> int:
    """Look through logs: channels, rates, clocks, units, joints that move, \
and what is wrong.

    With a robot file, torque and IMUs are compared with its geometry as well. The exit
    code is 1 when an error is found, 2 when a log cannot be read, 3 when one was read
    in part.
    """  # noqa: D205
    from seqid_cli.inspect import InspectSettings
    from seqid_cli.inspect import inspect as inspect_logs

    with CommandRun(
        "inspect", quiet=quiet, verbose=verbose, json=json, no_color=no_color
    ) as run:
        robot = robot or found_robot_if_any(run.screen, logs)
        settings = run.settings(InspectSettings(), set_values)
        file = inspect_logs(
            logs,
            robot,
            settings=settings,
            time_source=time_source,
            part=LogPart.of(start, stop, exclude),
            plan=plan,
            output=output,
            on_progress=run.on_progress,
        )
    run.screen.document(file)
    show_inspection(run.screen, file)
    if output is not None:
        run.screen.note(f"written: {output}")
    return _exit_code(run.screen, file, strict=strict)


def _exit_code(screen: Screen, file: InspectionFile, *, strict: bool) -> int:
    """Return the exit code of an inspection; a log that cannot be read is an error."""
    for finding in file.findings:
        if finding.code == "unreadable":
            screen.error(f"{finding.log}: {finding.message}", hint=finding.remedy)
            return EXIT_UNREADABLE

    grave = ("error", "warning") if strict else ("error",)
    if any(finding.severity in grave for finding in file.findings):
        return EXIT_UNTRUSTED
    if strict and any(move.status != "recorded" for move in file.planned):
        return EXIT_UNTRUSTED
    return EXIT_PARTIAL if any(log.partial for log in file.logs) else EXIT_DONE


@app.command(
    "init",
    epilog=examples(
        f"seqid init {SIX}/friction --urdf {SIX}/six_joint.urdf -o robot.toml",
        "seqid init sample_logs/two_joint/imu/joint_2.mcap --name two_joint",
    ),
)
def init(
    *,
    logs: LogsArgument,
    urdf: Annotated[
        Path | None,
        typer.Option(
            "--urdf",
            metavar="FILE",
            help=(
                "URDF of the robot; without it the one on /robot_description of a"
                " bag is written beside the robot file, or else a DH stub is made."
            ),
        ),
    ] = None,
    output: Annotated[
        Path | None,
        typer.Option(
            "-o",
            "--output",
            metavar="FILE",
            help="Where the robot file goes; else printed.",
        ),
    ] = None,
    name: Annotated[
        str | None,
        typer.Option(
            "--name", metavar="NAME", help="The robot's name; else the URDF's."
        ),
    ] = None,
    torque_constant: Annotated[
        str | None,
        typer.Option(
            "--torque-constant",
            metavar="K[,K...]",
            help="N m/A, motor side: one for all joints, or one for each.",
        ),
    ] = None,
    gear_ratio: Annotated[
        str | None,
        typer.Option(
            "--gear-ratio",
            metavar="N[,N...]",
            help="Motor turns per joint turn: one for all joints, or one for each.",
        ),
    ] = None,
    unit: Annotated[
        Literal["rad", "deg", "percent"] | None,
        typer.Option(
            "--unit",
            help=(
                "Unit of positions, where names and values do not tell it; percent is"
                " of the joints' limits."
            ),
        ),
    ] = None,
    rate: Annotated[
        float | None,
        typer.Option(
            "--rate",
            metavar="HZ",
            callback=number_check(is_positive, "a positive number"),
            help="Samples per second of tables without a column of time.",
        ),
    ] = None,
    start: FromOption = None,
    stop: ToOption = None,
    exclude: ExcludeOption = None,
    force: Annotated[
        bool, typer.Option("--force", help="Overwrite a robot file that exists.")
    ] = False,
    quiet: QuietOption = False,
    verbose: VerboseOption = False,
    json: JsonOption = False,
    no_color: NoColorOption = False,
    debug: DebugOption = False,
) -> int:
    """Write a commented robot file: joints, limits, encoder steps, channels, \
IMUs as far as known.

    What nobody can read off a log stands in it as a TODO.
    """  # noqa: D205
    screen = screen_for(
        "init", quiet=quiet, verbose=verbose, json=json, no_color=no_color
    )
    reading = Reading(part=LogPart.of(start, stop, exclude))
    drives = {}
    if torque_constant:
        drives["torque_constant"] = _numbers("--torque-constant", torque_constant)
    if gear_ratio:
        drives["gear_ratio"] = _numbers("--gear-ratio", gear_ratio)

    # The first log decides on the channels, so it stays the first.
    files = list(dict.fromkeys([*expand(logs[:1]), *expand(logs)]))
    for file in files:
        check_log(file)
    urdf_text = read_urdf_text(urdf) if urdf is not None else None
    if output is not None:
        check_output(output, files if urdf is None else [*files, urdf])
        if output.exists() and not force:
            raise UsageError(
                "exists already",
                where=str(output),
                hint="Give another name, or --force.",
            )

    from seqid_cli.inspect.propose import propose
    from seqid_cli.robot.template import robot_toml

    found = None
    if urdf_text is None:
        target = output.with_suffix(".urdf") if output is not None else None
        found = found_urdf(screen, files, target)
    if found is not None:
        urdf = found.urdf.path
        urdf_text = found.urdf
        _check_urdf_target(found, force=force)

    urdf_name = urdf_text.root.get("name") if urdf_text else None
    proposal = propose(
        files,
        urdf=urdf_text,
        urdf_path=_path_from_robot_file(urdf, output),
        drives=drives,
        unit=unit,
        rate=rate,
        name=name or urdf_name or "robot",
        reading=reading,
    )
    content = robot_toml(proposal.template)
    if found is not None:
        write_text_atomic(found.urdf.path, found.urdf.raw.decode(), inputs=files)
        screen.note(f"written: {found.urdf.path}, of {found.topic} in {found.log}")
    if output is not None:
        content = _write_robot_file(screen, content, output, files, reading)
    _show_proposal(screen, proposal, content, output)
    if output is not None:
        screen.note(f"written: {output}")
        screen.note(f"next: seqid inspect {quoted(logs[0])} -r {quoted(output)}")
    return EXIT_DONE


def _check_urdf_target(found: FoundUrdf, *, force: bool) -> None:
    """Raise UsageError where another URDF stands where that of a log would go."""
    path = found.urdf.path
    if force or not path.exists():
        return
    if not path.is_file() or path.read_bytes() != found.urdf.raw:
        raise UsageError(
            f"exists already, and is not the URDF on {found.topic} of {found.log}",
            where=str(path),
            hint="Give this one with --urdf, or overwrite it with --force.",
        )


def _write_robot_file(
    screen: Screen,
    content: str,
    output: Path,
    files: "Sequence[Path]",
    reading: Reading,
) -> str:
    """Write a robot file, and again with gravity where logs show it; return its text.

    Gravity is looked for with the robot file as it is read, so it has to exist first.
    """
    from seqid_cli.inspect.propose import with_gravity

    write_text_atomic(output, content, inputs=files)
    mounted = with_gravity(content, output, files, reading=reading)
    if mounted != content:
        write_text_atomic(output, mounted, inputs=files)
        screen.note("the logs tell the mounting: look at gravity in the file")
    return mounted


def _show_proposal(
    screen: Screen, proposal: "Proposal", content: str, output: Path | None
) -> None:
    """Show a robot file that is not written to a file, and what is to be completed."""
    document = {
        "output": str(output) if output else None,
        "joints": [joint.name for joint in proposal.template.joints],
        "todo": list(proposal.todo),
        "robot_toml": content,
    }
    screen.document(document)
    if output is None and not screen.json:
        sys.stdout.write(content)
    for line in proposal.todo:
        screen.note(f"to do: {line}")


def _numbers(option: str, text: str) -> list[float]:
    """Return the numbers between commas that an option was given."""
    try:
        return [float(part) for part in text.split(",")]
    except ValueError:
        raise UsageError(
            f"{option} {text!r} holds no numbers",
            hint="Give one number for all joints, or one for each: 0.12,0.12,0.09.",
        ) from None


def _path_from_robot_file(urdf: Path | None, output: Path | None) -> str | None:
    """Return the URDF's path as seen from the folder of the robot file."""
    if urdf is None:
        return None
    folder = output.parent if output else Path()
    try:
        return Path(os.path.relpath(urdf, folder)).as_posix()
    except ValueError:  # on another drive
        return str(urdf.resolve())
