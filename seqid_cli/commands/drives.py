"""The commands about the controllers behind the torques: drive and replay."""

from pathlib import Path
from typing import Annotated

import typer

from seqid_cli import drive as drives
from seqid_cli.commands.command_run import CommandRun
from seqid_cli.commands.options import (
    SIX,
    AddedToOption,
    CutoffOption,
    DebugOption,
    ExcludeOption,
    FromOption,
    JsonOption,
    LogsArgument,
    NoColorOption,
    OutputOption,
    QuietOption,
    RobotOption,
    SetOption,
    ShowSettingsOption,
    SkipFailedOption,
    StrictOption,
    TimeOption,
    ToOption,
    VerboseOption,
    command_app,
    examples,
    is_positive,
    number_check,
)
from seqid_cli.commands.screen.render import Screen, percent
from seqid_cli.commands.screen.show import show_poor, verdict_text
from seqid_cli.drive.settings import DriveSettings
from seqid_cli.logs.reading import LogPart
from seqid_cli.params.results import tables
from seqid_cli.params.results.drive import DriveFile
from seqid_cli.params.results.replay import ReplayFile

app = command_app()


@app.command(
    "drive",
    epilog=examples(
        f"seqid drive LOGS -r {SIX}/robot.toml -p inertia.json -o drive.json",
        f"seqid drive LOGS -r {SIX}/robot.toml -p inertia.json --no-torque --json",
    ),
)
def drive(
    *,
    logs: LogsArgument,
    robot: RobotOption = None,
    parameters: AddedToOption = None,
    output: OutputOption = None,
    no_torque: Annotated[
        bool,
        typer.Option(
            "--no-torque",
            help="Take the model's torque of the motion instead of the logged one.",
        ),
    ] = False,
    same_servos: Annotated[
        bool,
        typer.Option(
            "--same-servos",
            help="Joints have servos of one type: some tell of the others.",
        ),
    ] = False,
    cutoff_hz: CutoffOption = None,
    time_source: TimeOption = "header",
    start: FromOption = None,
    stop: ToOption = None,
    exclude: ExcludeOption = None,
    skip_failed: SkipFailedOption = False,
    strict: StrictOption = False,
    set_values: SetOption = None,
    show_settings: ShowSettingsOption = False,
    quiet: QuietOption = False,
    verbose: VerboseOption = False,
    json: JsonOption = False,
    no_color: NoColorOption = False,
    debug: DebugOption = False,
) -> int:
    """Identify gains, delays and limits of the position controller of each joint.

    The logs hold what the controllers were asked for (`<joint>.command`) beside the
    motion. A measured torque makes the gains several times more exact; without one the
    torque that the model computes from the motion stands for it, and each joint is
    simulated in windows of the logs. Without -p the model is that of the URDF. Every
    number says whether these logs show it, and if not what to record.
    """
    with CommandRun(
        "drive", quiet=quiet, verbose=verbose, json=json, no_color=no_color
    ) as run:
        robot = run.robot_file(robot, logs)
        options = drives.DriveOptions(
            cutoff_hz=cutoff_hz,
            time_source=time_source,
            part=LogPart.of(start, stop, exclude),
            skip_failed=skip_failed,
            no_torque=no_torque,
            same_servos=same_servos,
        )
        settings = run.settings(DriveSettings(), set_values)
        file = drives.drive(
            logs,
            robot,
            parameters or (),
            options,
            settings=settings,
            output=output,
            on_progress=run.on_progress,
        )
    _show_drive(run.screen, file)
    run.show_output(output)
    return run.exit_code(file.verdicts, strict=strict)


def _show_drive(screen: Screen, file: DriveFile) -> None:
    """Show each controller, what it leaves of the torque, and the verdict."""
    screen.document(file)
    screen.values(tables.drive_parameters(file))
    for name, joint in file.joints.items():
        known = "" if joint.command_known else " (assumed)"
        left = [f"commands are {joint.command}{known}"]
        if joint.left is not None:
            left.append(f"{percent(joint.left)} of the torque is left by rows")
        if joint.window_rms is not None:
            left.append(
                f"{joint.window_rms:.2g} of the position in held-out windows, where the"
                f" guess leaves {joint.window_guess:.2g}"
            )
        screen.result(f"{name}: {'; '.join(left)}")
    if file.command_delay is not None and file.command_delay.value is not None:
        delay_ms = 1e3 * file.command_delay.value
        error_ms = 1e3 * (file.command_delay.std_error or 0.0)
        screen.result(
            f"command delay of all joints: {delay_ms:.4g} ms, standard error"
            f" {error_ms:.2g} ms"
        )
    of_joints = [verdict for verdict in file.verdicts if verdict.joint]
    show_poor(screen, of_joints, "drive")
    screen.result(f"drive: {verdict_text(file.verdicts, '')}")
    screen.remark(*file.notes)


@app.command(
    "replay",
    epilog=examples(
        f"seqid replay LOGS -r {SIX}/robot.toml -p drive.json -o replay.json",
        f"seqid replay LOGS -r {SIX}/robot.toml -p drive.json --window 2 --json",
    ),
)
def replay(
    *,
    logs: LogsArgument,
    robot: RobotOption = None,
    parameters: Annotated[
        Path,
        typer.Option(
            "-p",
            "--parameters",
            metavar="FILE",
            help="The result of seqid drive, which holds the model of the arm as well.",
        ),
    ],
    output: OutputOption = None,
    window_s: Annotated[
        float,
        typer.Option(
            "--window",
            metavar="SECONDS",
            callback=number_check(is_positive, "a positive number"),
            help="Length of what is simulated at once, from the state of the log.",
        ),
    ] = 1.0,
    cutoff_hz: CutoffOption = None,
    time_source: TimeOption = "header",
    start: FromOption = None,
    stop: ToOption = None,
    exclude: ExcludeOption = None,
    skip_failed: SkipFailedOption = False,
    strict: StrictOption = False,
    quiet: QuietOption = False,
    verbose: VerboseOption = False,
    json: JsonOption = False,
    no_color: NoColorOption = False,
    debug: DebugOption = False,
) -> int:
    """Simulate the robot from its commands, and compare it with its logs.

    Arm, friction and controllers are stepped in closed loop, in windows that each begin
    with the state of the log. Beside the error of the simulation stand those of guesses
    that need no model: the command at the best delay, and the first position with the
    change of that command. `without drive` is the arm moved by the measured torque.
    """
    with CommandRun(
        "replay", quiet=quiet, verbose=verbose, json=json, no_color=no_color
    ) as run:
        robot = run.robot_file(robot, logs)
        options = drives.ReplayOptions(
            cutoff_hz=cutoff_hz,
            time_source=time_source,
            part=LogPart.of(start, stop, exclude),
            skip_failed=skip_failed,
            window_s=window_s,
        )
        file = drives.replay(
            logs,
            robot,
            parameters,
            options,
            output=output,
            on_progress=run.on_progress,
        )
    _show_replay(run.screen, file)
    run.show_output(output)
    return run.exit_code(file.verdicts, strict=strict)


def _show_replay(screen: Screen, file: ReplayFile) -> None:
    """Show the errors of each joint beside those of guesses, and the verdict."""
    screen.document(file)
    screen.values(tables.replay_errors(file))
    screen.result(
        f"{file.windows} windows of {file.window_s:g} s; RMS errors of positions in"
        " rad, of velocities in rad/s, of torques in N m"
    )
    of_joints = [verdict for verdict in file.verdicts if verdict.joint]
    show_poor(screen, of_joints, "replay")
    screen.result(f"replay: {verdict_text(file.verdicts, '')}")
    screen.remark(*file.notes)
