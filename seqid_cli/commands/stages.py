"""The commands that identify: friction, gravity, IMUs, inertia, or all at once."""

from collections.abc import Sequence
from pathlib import Path
from typing import Annotated

import typer

from seqid_cli import identify
from seqid_cli.commands.command_run import CommandRun, quoted
from seqid_cli.commands.options import (
    SIX,
    AddedToOption,
    ConsistentOption,
    CutoffOption,
    DebugOption,
    EngineOption,
    ExcludeOption,
    FromOption,
    JobsOption,
    JsonOption,
    LogsArgument,
    MotionOption,
    NoColorOption,
    OutputOption,
    ParametersOption,
    QuietOption,
    RobotOption,
    SchedulerOption,
    SetOption,
    ShowSettingsOption,
    SkipFailedOption,
    StrictOption,
    TimeOption,
    ToOption,
    VerboseOption,
    command_app,
    examples,
)
from seqid_cli.commands.screen.show import show_stages
from seqid_cli.identify.options import MAX_POSITION_ORDER
from seqid_cli.logs.reading import LogPart
from seqid_cli.params.document import worst_level
from seqid_cli.params.schema import ParameterFile, Stages, Verdict

app = command_app()


@app.command(
    "friction",
    epilog=examples(
        f"seqid friction {SIX}/friction -r {SIX}/robot.toml -o friction.json",
        f"seqid friction '{SIX}/friction/*' -r {SIX}/robot.toml --position-order 4"
        " --velocity-order 5 --json",
    ),
)
def friction(
    *,
    logs: LogsArgument,
    robot: RobotOption = None,
    output: OutputOption = None,
    position_order: Annotated[
        int | None,
        typer.Option(
            "--position-order",
            metavar="N",
            min=0,
            max=MAX_POSITION_ORDER,
            help="Order in position; found when left out.",
        ),
    ] = None,
    velocity_order: Annotated[
        int | None,
        typer.Option(
            "--velocity-order",
            metavar="N",
            min=0,
            max=30,
            help="Order in velocity; found when left out.",
        ),
    ] = None,
    beta: Annotated[
        float | None,
        typer.Option(
            "--beta",
            metavar="SHARE",
            min=0.0,
            max=1.0,
            help=(
                "Take the fewest orders at which Eq. 11 holds with this threshold, if"
                " any do."
            ),
        ),
    ] = None,
    cutoff_hz: CutoffOption = None,
    time_source: TimeOption = "header",
    start: FromOption = None,
    stop: ToOption = None,
    exclude: ExcludeOption = None,
    jobs: JobsOption = None,
    engine: EngineOption = "local",
    scheduler: SchedulerOption = None,
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
    """Identify joint friction over position and velocity.

    The logs hold moves of one joint at a time at constant velocity, forward and
    backward, at several speeds.
    """
    with CommandRun(
        "friction", quiet=quiet, verbose=verbose, json=json, no_color=no_color
    ) as run:
        robot = run.robot_file(robot, logs)
        options = identify.FrictionOptions(
            cutoff_hz=cutoff_hz,
            time_source=time_source,
            part=LogPart.of(start, stop, exclude),
            skip_failed=skip_failed,
            position_order=position_order,
            velocity_order=velocity_order,
            beta=beta,
        )
        settings = run.settings(identify.FrictionSettings(), set_values)
        executor = run.log_readers(logs, jobs=jobs, engine=engine, scheduler=scheduler)
        file = identify.friction(
            logs,
            robot,
            options,
            settings=settings,
            output=output,
            executor=executor,
            on_progress=run.on_progress,
        )
    verdicts = _show_result(run, file, ["friction"])
    following = (
        f"seqid gravity LOG... -r {quoted(robot)} -p {quoted(output)} -o gravity.json"
    )
    run.show_output(output, _proposed(verdicts, following, robot, output))
    return run.exit_code(verdicts, strict=strict)


@app.command(
    "gravity",
    epilog=examples(
        f"seqid gravity {SIX}/gravity {SIX}/friction -r {SIX}/robot.toml"
        " -p friction.json -o gravity.json",
        f"seqid gravity {SIX}/gravity -r {SIX}/robot.toml -p friction.json --strict",
    ),
)
def gravity(
    *,
    logs: LogsArgument,
    robot: RobotOption = None,
    parameters: ParametersOption,
    output: OutputOption = None,
    cutoff_hz: CutoffOption = None,
    time_source: TimeOption = "header",
    start: FromOption = None,
    stop: ToOption = None,
    exclude: ExcludeOption = None,
    jobs: JobsOption = None,
    engine: EngineOption = "local",
    scheduler: SchedulerOption = None,
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
    """Identify the gravity parameters, given the friction.

    The logs hold moves of one joint at a time at constant velocity, with the other
    joints locked in several configurations.
    """
    with CommandRun(
        "gravity", quiet=quiet, verbose=verbose, json=json, no_color=no_color
    ) as run:
        robot = run.robot_file(robot, logs)
        options = identify.LogOptions(
            cutoff_hz=cutoff_hz,
            time_source=time_source,
            part=LogPart.of(start, stop, exclude),
            skip_failed=skip_failed,
        )
        settings = run.settings(identify.GravitySettings(), set_values)
        executor = run.log_readers(logs, jobs=jobs, engine=engine, scheduler=scheduler)
        file = identify.gravity(
            logs,
            robot,
            parameters,
            options,
            settings=settings,
            output=output,
            executor=executor,
            on_progress=run.on_progress,
        )
    verdicts = _show_result(run, file, ["gravity"])
    inertia_command = _inertia_command(robot, output)
    following = f"{inertia_command}  (with accelerometers: seqid imu-calib first)"
    run.show_output(output, _proposed(verdicts, following, robot, output))
    return run.exit_code(verdicts, strict=strict)


@app.command(
    "imu-calib",
    epilog=examples(
        f"seqid imu-calib {SIX}/imu -r {SIX}/robot.toml -p gravity.json -o imu.json",
        f"seqid imu-calib {SIX}/imu -r {SIX}/robot.toml --json",
    ),
)
def imu_calib(
    *,
    logs: LogsArgument,
    robot: RobotOption = None,
    parameters: AddedToOption = None,
    output: OutputOption = None,
    cutoff_hz: CutoffOption = None,
    time_source: TimeOption = "header",
    start: FromOption = None,
    stop: ToOption = None,
    exclude: ExcludeOption = None,
    jobs: JobsOption = None,
    engine: EngineOption = "local",
    scheduler: SchedulerOption = None,
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
    """Find how accelerometers and IMUs are mounted on the links, and \
what they are like.

    The logs hold rotations of the first joint with the other joints locked in several
    configurations. Mounting, place, biases, scales, axes and clock offset are found
    together.
    """  # noqa: D205
    with CommandRun(
        "imu-calib", quiet=quiet, verbose=verbose, json=json, no_color=no_color
    ) as run:
        robot = run.robot_file(robot, logs)
        options = identify.LogOptions(
            cutoff_hz=cutoff_hz,
            time_source=time_source,
            part=LogPart.of(start, stop, exclude),
            skip_failed=skip_failed,
        )
        settings = run.settings(identify.ImuCalibSettings(), set_values)
        executor = run.log_readers(logs, jobs=jobs, engine=engine, scheduler=scheduler)
        file = identify.imu_calib(
            logs,
            robot,
            parameters or (),
            options,
            settings=settings,
            output=output,
            executor=executor,
            on_progress=run.on_progress,
        )
    verdicts = _show_result(run, file, ["imu"])
    following = _inertia_command(robot, output)
    run.show_output(output, _proposed(verdicts, following, robot, output))
    return run.exit_code(verdicts, strict=strict)


@app.command(
    "inertia",
    epilog=examples(
        f"seqid inertia {SIX}/inertia -r {SIX}/robot.toml -p imu.json -o inertia.json",
        f"seqid inertia {SIX}/inertia -r {SIX}/robot.toml -p gravity.json --motion"
        " encoder --strict",
    ),
)
def inertia(
    *,
    logs: LogsArgument,
    robot: RobotOption = None,
    parameters: ParametersOption,
    output: OutputOption = None,
    source: MotionOption = "auto",
    cutoff_hz: CutoffOption = None,
    time_source: TimeOption = "header",
    start: FromOption = None,
    stop: ToOption = None,
    exclude: ExcludeOption = None,
    jobs: JobsOption = None,
    engine: EngineOption = "local",
    scheduler: SchedulerOption = None,
    skip_failed: SkipFailedOption = False,
    consistent: ConsistentOption = False,
    strict: StrictOption = False,
    set_values: SetOption = None,
    show_settings: ShowSettingsOption = False,
    quiet: QuietOption = False,
    verbose: VerboseOption = False,
    json: JsonOption = False,
    no_color: NoColorOption = False,
    debug: DebugOption = False,
) -> int:
    """Identify the inertia parameters, given friction and gravity.

    The logs hold moves of two joints (or more) at a time.
    """
    with CommandRun(
        "inertia", quiet=quiet, verbose=verbose, json=json, no_color=no_color
    ) as run:
        robot = run.robot_file(robot, logs)
        options = identify.RigidOptions(
            cutoff_hz=cutoff_hz,
            time_source=time_source,
            part=LogPart.of(start, stop, exclude),
            skip_failed=skip_failed,
            source=source,
            consistent=consistent,
        )
        settings = run.settings(identify.InertiaSettings(), set_values)
        executor = run.log_readers(logs, jobs=jobs, engine=engine, scheduler=scheduler)
        file = identify.inertia(
            logs,
            robot,
            parameters,
            options,
            settings=settings,
            output=output,
            executor=executor,
            on_progress=run.on_progress,
        )
    verdicts = _show_result(run, file, ["inertia"])
    following = _predict_command(robot, output)
    run.show_output(output, _proposed(verdicts, following, robot, output))
    return run.exit_code(verdicts, strict=strict)


@app.command(
    "simultaneous",
    epilog=examples(
        f"seqid simultaneous {SIX}/inertia -r {SIX}/robot.toml -o simultaneous.json",
        f"seqid simultaneous {SIX}/friction {SIX}/inertia -r {SIX}/robot.toml --json",
    ),
)
def simultaneous(
    *,
    logs: LogsArgument,
    robot: RobotOption = None,
    parameters: AddedToOption = None,
    output: OutputOption = None,
    offset: Annotated[
        bool,
        typer.Option(
            "--offset/--no-offset",
            help="Give each joint a constant torque besides friction.",
        ),
    ] = True,
    source: MotionOption = "auto",
    cutoff_hz: CutoffOption = None,
    time_source: TimeOption = "header",
    start: FromOption = None,
    stop: ToOption = None,
    exclude: ExcludeOption = None,
    consistent: ConsistentOption = False,
    strict: StrictOption = False,
    set_values: SetOption = None,
    show_settings: ShowSettingsOption = False,
    quiet: QuietOption = False,
    verbose: VerboseOption = False,
    json: JsonOption = False,
    no_color: NoColorOption = False,
    debug: DebugOption = False,
) -> int:
    """Identify all parameters at once, with Coulomb and viscous friction (Eq. 5-6).

    Any logs will do. For comparison, and for data without moves of single joints. With
    the file of seqid imu-calib (-p) accelerometers are used as well.
    """
    with CommandRun(
        "simultaneous", quiet=quiet, verbose=verbose, json=json, no_color=no_color
    ) as run:
        robot = run.robot_file(robot, logs)
        options = identify.SimultaneousOptions(
            cutoff_hz=cutoff_hz,
            time_source=time_source,
            part=LogPart.of(start, stop, exclude),
            source=source,
            consistent=consistent,
            offset=offset,
        )
        settings = run.settings(identify.SimultaneousSettings(), set_values)
        file = identify.simultaneous(
            logs,
            robot,
            parameters or (),
            options,
            settings=settings,
            output=output,
            on_progress=run.on_progress,
        )
    verdicts = _show_result(run, file, ["friction", "inertia"])
    following = _predict_command(robot, output)
    run.show_output(output, _proposed(verdicts, following, robot, output))
    return run.exit_code(verdicts, strict=strict)


def _show_result(
    run: CommandRun, file: ParameterFile, stage_names: Sequence[str]
) -> list[Verdict]:
    """Show the stages that were identified, and return their verdicts."""
    run.screen.document(file)
    stages = Stages(**{name: getattr(file.stages, name) for name in stage_names})
    show_stages(run.screen, stages, file.robot)

    verdicts = []
    for name in stage_names:
        verdicts += getattr(stages, name).verdicts
    return verdicts


def _proposed(
    verdicts: Sequence[Verdict], following: str, robot: Path, output: Path | None
) -> str:
    """Return the command to type next: none after a poor verdict."""
    level = worst_level(verdicts)
    if level == "poor":
        return ""
    if level == "usable":
        return (
            f"seqid diagnose LOG... -r {quoted(robot)}"
            f" -p {quoted(output)} -o diagnosis.json"
        )
    return following


def _inertia_command(robot: Path, output: Path | None) -> str:
    return (
        f"seqid inertia LOG... -r {quoted(robot)} -p {quoted(output)} -o inertia.json"
    )


def _predict_command(robot: Path, output: Path | None) -> str:
    return (
        f"seqid predict LOG... -r {quoted(robot)}"
        f" -p {quoted(output)} -o prediction.json"
    )
