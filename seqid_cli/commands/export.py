"""`seqid export`: an identified arm in the forms that other tools read."""

from pathlib import Path
from typing import Annotated

import typer

from seqid_cli.commands.command_run import EXIT_UNTRUSTED, CommandRun
from seqid_cli.commands.options import (
    SIX,
    DebugOption,
    ExcludeOption,
    FromOption,
    JsonOption,
    NoColorOption,
    QuietOption,
    RobotOption,
    StrictOption,
    ToOption,
    VerboseOption,
    command_app,
    examples,
)
from seqid_cli.commands.screen.render import Screen, number
from seqid_cli.errors import UsageError
from seqid_cli.export.formats import BY_TARGET, BY_TITLE, FORMATS
from seqid_cli.logs.reading import LogPart
from seqid_cli.params.results import tables
from seqid_cli.params.results.export import ExportedLink, ExportFile

# A base parameter that the nearest bodies miss by more standard errors than this is
# not missed by noise: the robot file is wrong somewhere.
MAX_STD_ERRORS = 4.0
_SHOWN_STD_ERRORS = 0.01  # deviations below this are rounding
_TWO = "sample_logs/two_joint"
_SUFFIXES = ", ".join(
    dict.fromkeys(f"{suffix} {name}" for suffix, name in FORMATS.items())
)

app = command_app()


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
    start: FromOption = None,
    stop: ToOption = None,
    exclude: ExcludeOption = None,
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

    with CommandRun(
        "export", quiet=quiet, verbose=verbose, json=json, no_color=no_color
    ) as run:
        robot = run.robot_file(robot)
        if replay and no_replay:
            raise UsageError(
                "--replay and --no-replay exclude each other", hint="Give one of them."
            )
        file = write_export(
            parameters,
            robot,
            output,
            target=target,
            replay=replay or (),
            no_replay=no_replay,
            part=LogPart.of(start, stop, exclude),
        )
    run.screen.document(file)
    has_failed = False
    if file.joints:
        _show_links(run.screen, file)
        _show_fidelity(run.screen, file)
        has_failed = _show_replay(run.screen, file)
    for note in file.notes:
        run.screen.note(f"note: {note}")
    run.screen.note(f"written: {output} ({file.format})")

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
        titles = f"{titles} | loss [{{unit}}]"
        kinds = f"{kinds} number"

    rows = []
    for name, link in file.joints.items():
        center = " ".join(number(x) for x in link.center_of_mass)
        row = [name, link.mass, center, link.armature, *_friction_cells(link)]
        if file.loss:
            row.append(file.loss.get(name))
        rows.append(row)
    screen.values(tables.of_joints(titles, kinds, rows, file.robot))
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
        screen.result(f"replayed over {logs}, RMS errors:")
        titles = (
            "joint | parameter file [{unit}] | written file [{unit}]"
            " | loss there [{unit}] | samples"
        )
        kinds = "text number number number count"
        screen.values(tables.of_joints(titles, kinds, rows, file.robot))
    for text in file.replay.failures:
        screen.warn(text)
    if file.replay.failures:
        screen.note(
            "do: export again and do not edit what was written; where a form loses too"
            " much for its use, export to C or numpy, which hold the whole model"
        )
    return not file.replay.passed
