"""The commands that judge a model by logs: predict, diagnose, refine, and payload."""

import functools
from pathlib import Path
from typing import Annotated

import typer

from seqid_cli import identify
from seqid_cli.commands.command_run import CommandRun, quoted
from seqid_cli.commands.options import (
    SIX,
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
    is_positive,
    number_check,
)
from seqid_cli.commands.screen.render import Screen, number
from seqid_cli.commands.screen.show import (
    shared_reasons,
    show_motion,
    show_poor,
    show_shared,
    show_verdicts,
    verdict_text,
)
from seqid_cli.errors import UsageError
from seqid_cli.logs.reading import LogPart
from seqid_cli.params.results import tables
from seqid_cli.params.results.diagnosis import DiagnosisFile
from seqid_cli.params.results.payload import PayloadFile
from seqid_cli.params.results.prediction import PredictionFile

_VALIDATION = f"{SIX}/validation -r {SIX}/robot.toml -p inertia.json"
_HELD_OUT = (
    f"--holdout {SIX}/changed/held_out.parquet -r {SIX}/robot.toml -p inertia.json"
)

ExplainOption = Annotated[
    str | None,
    typer.Option(
        "--explain",
        metavar="JOINT",
        help=(
            "Tell of one joint what was tried there, what was taken and what was not,"
            " and why."
        ),
    ),
]

app = command_app()


@app.command(
    "predict",
    epilog=examples(
        f"seqid predict {_VALIDATION} -o prediction.json",
        f"seqid predict {_VALIDATION} --torques torques.parquet --json",
        f"seqid predict {_VALIDATION} --torques torques.mcap --layouts layouts",
    ),
)
def predict(
    *,
    logs: LogsArgument,
    robot: RobotOption = None,
    parameters: ParametersOption,
    output: OutputOption = None,
    torques: Annotated[
        Path | None,
        typer.Option(
            "--torques",
            metavar="FILE",
            help="Where the torques go: as MCAP if it ends so, else Parquet.",
        ),
    ] = None,
    layouts: Annotated[
        Path | None,
        typer.Option(
            "--layouts",
            metavar="FOLDER",
            help=(
                "Where layouts of PlotJuggler and Foxglove go that show the torques of"
                " this robot's joints."
            ),
        ),
    ] = None,
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
    strict: StrictOption = False,
    with_unexplained: Annotated[
        bool,
        typer.Option(
            "--with-unexplained",
            help="Add the smooth terms that no known effect explains.",
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
    """Predict the joint torques of any logs and compare them with the measured ones.

    The error is given per joint over the samples in which it slides, in N m and
    relative to the RMS of the measured torque there. Its parts are of samples inside
    and outside the positions and speeds at which friction was identified. At rest
    friction is an interval, and the error is the distance to it. `in 90 %` says how
    many sliding samples the 90 % band holds.
    """
    with CommandRun(
        "predict", quiet=quiet, verbose=verbose, json=json, no_color=no_color
    ) as run:
        robot = run.robot_file(robot, logs)
        options = identify.PredictOptions(
            cutoff_hz=cutoff_hz,
            time_source=time_source,
            part=LogPart.of(start, stop, exclude),
            skip_failed=skip_failed,
            source=source,
            with_unexplained=with_unexplained,
        )
        settings = run.settings(identify.PredictSettings(), set_values)
        executor = run.log_readers(logs, jobs=jobs, engine=engine, scheduler=scheduler)
        file = identify.predict(
            logs,
            robot,
            parameters,
            options,
            torques=torques,
            settings=settings,
            output=output,
            executor=executor,
            on_progress=run.on_progress,
        )
    _show_prediction(run.screen, file)
    if torques is not None:
        run.screen.note(f"written: {torques}")
    if layouts is not None:
        from seqid_cli.identify.prediction.layouts import write_layouts

        for path in write_layouts(layouts, file.robot.joints):
            run.screen.note(f"written: {path}")
    run.show_output(output)
    return run.exit_code(file.verdicts, strict=strict)


def _show_prediction(screen: Screen, file: PredictionFile) -> None:
    """Show the errors and the verdict of each joint, and the cut-offs in use."""
    screen.document(file)
    shared = shared_reasons(file.verdicts, file.joints)
    screen.values(
        tables.prediction_errors(file, functools.partial(verdict_text, shared=shared))
    )
    show_shared(screen, shared)
    notes = list(file.notes)
    for log in file.logs:
        notes += [f"{log.path}: {note}" for note in log.notes]
    show_verdicts(screen, file.verdicts, "prediction", notes, in_table=file.joints)
    motion_uses = [log.motion for log in file.logs if log.motion is not None]
    show_motion(screen, motion_uses, file.robot)

    # By size; some look alike once they are rounded.
    in_order = sorted(log.cutoff_hz for log in file.logs)
    cutoffs_hz = dict.fromkeys(map(number, in_order))
    screen.note(
        f"cut-off: {', '.join(cutoffs_hz)} Hz, {file.cutoff_origin} (--cutoff"
        " overrides)"
    )
    for log in file.logs:
        screen.detail(f"{log.path}: cut-off {number(log.cutoff_hz)} Hz")


@app.command(
    "diagnose",
    epilog=examples(
        f"seqid diagnose {_VALIDATION} -o diagnosis.json",
        f"seqid diagnose {SIX}/changed -r {SIX}/robot.toml -p inertia.json --strict"
        " --json",
    ),
)
def diagnose(
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
    strict: StrictOption = False,
    explain: ExplainOption = None,
    set_values: SetOption = None,
    show_settings: ShowSettingsOption = False,
    quiet: QuietOption = False,
    verbose: VerboseOption = False,
    json: JsonOption = False,
    no_color: NoColorOption = False,
    debug: DebugOption = False,
) -> int:
    """Find out which physical effects a model lacks; any logs will do, \
nothing is changed.

    With --strict the exit code is 1 unless nothing is missing.
    """  # noqa: D205
    from seqid_cli import discover
    from seqid_cli.commands.screen.show_diagnosis import show_diagnosis

    with CommandRun(
        "diagnose", quiet=quiet, verbose=verbose, json=json, no_color=no_color
    ) as run:
        robot = run.robot_file(robot, logs)
        if explain is not None:
            _check_joint(explain, robot)
        options = discover.DiagnoseOptions(
            cutoff_hz=cutoff_hz,
            time_source=time_source,
            part=LogPart.of(start, stop, exclude),
            source=source,
        )
        settings = run.settings(discover.DiscoverSettings(), set_values)
        file = discover.diagnose(
            logs,
            robot,
            parameters,
            options,
            settings=settings,
            output=output,
            on_progress=run.on_progress,
        )
    run.screen.document(file)
    show_diagnosis(run.screen, file, explain)
    show_motion(run.screen, file.motion, file.robot)
    run.show_output(output)
    if advice := _next_after_diagnosis(file, robot, parameters):
        run.screen.note(f"next: {advice}")
    is_incomplete = file.verdict != "nothing_missing"
    return run.exit_code(file.verdicts, strict=strict, is_untrusted=is_incomplete)


def _check_joint(name: str, robot: Path) -> None:
    """Refuse a joint that the robot does not have, before logs are read."""
    from seqid_cli.robot.file import load_robot

    joint_names = load_robot(robot).joint_names
    if name not in joint_names:
        raise UsageError(
            f"--explain names no joint of this robot: {name!r}",
            where=str(robot),
            hint=f"Its joints are {', '.join(joint_names)}.",
        )


def _next_after_diagnosis(
    file: DiagnosisFile, robot: Path, parameters: list[Path]
) -> str:
    """Return what to do after a diagnosis; nothing where the model lacks nothing."""
    if file.verdict == "nothing_missing":
        return ""
    if file.verdict == "values_changed":
        return "identify again, with logs that move the arm as these do"
    if file.verdict in ("too_short", "nothing_seen"):
        return (
            "record longer logs in which all joints move and rest, then diagnose again"
        )
    models = " ".join(f"-p {quoted(path)}" for path in parameters)
    # Without a known effect only a smooth term is left to add.
    smooth = "" if file.findings else " --with-unexplained"
    return (
        f"seqid refine LOG... --holdout LOG... -r {quoted(robot)} {models}{smooth}"
        " -o refined.json"
    )


@app.command(
    "refine",
    epilog=examples(
        f"seqid refine {SIX}/changed/fourier.parquet {_HELD_OUT} -o refined.json",
        f"seqid refine {SIX}/changed/fourier.parquet {SIX}/changed/trapezoids.parquet"
        f" {_HELD_OUT} --rounds 2 --json",
    ),
)
def refine(
    *,
    logs: LogsArgument,
    holdout: Annotated[
        list[str],
        typer.Option(
            "--holdout",
            metavar="LOG",
            help=(
                "Log, folder or glob that is opened after the last decision, and"
                " confirms what was added; repeat it for several."
            ),
        ),
    ],
    robot: RobotOption = None,
    parameters: ParametersOption,
    output: OutputOption = None,
    rounds: Annotated[
        int | None,
        typer.Option(
            "--rounds",
            metavar="N",
            min=1,
            max=100,
            help=(
                "At most this many rounds, each of one effect, at one joint or at"
                " several, or of one smooth term; no limit if left out."
            ),
        ),
    ] = None,
    with_unexplained: Annotated[
        bool,
        typer.Option(
            "--with-unexplained",
            help="Add a smooth term where no known effect explains.",
        ),
    ] = False,
    keep_unconfirmed: Annotated[
        bool,
        typer.Option(
            "--keep-unconfirmed",
            help="Leave effects in the model that the held-out logs do not confirm.",
        ),
    ] = False,
    source: MotionOption = "auto",
    cutoff_hz: CutoffOption = None,
    time_source: TimeOption = "header",
    start: FromOption = None,
    stop: ToOption = None,
    exclude: ExcludeOption = None,
    strict: StrictOption = False,
    explain: ExplainOption = None,
    set_values: SetOption = None,
    show_settings: ShowSettingsOption = False,
    quiet: QuietOption = False,
    verbose: VerboseOption = False,
    json: JsonOption = False,
    no_color: NoColorOption = False,
    debug: DebugOption = False,
) -> int:
    """Add the effects that a model lacks, as long as left-out blocks are \
predicted better.

    The held-out logs choose nothing: they are opened last. What they do not confirm is
    taken out and listed; the rest is fitted again without it. With --strict the exit
    code is 1 if nothing stays, or if something stays that they do not confirm.
    """  # noqa: D205
    from seqid_cli import discover
    from seqid_cli.commands.screen.show_diagnosis import show_refinement

    with CommandRun(
        "refine", quiet=quiet, verbose=verbose, json=json, no_color=no_color
    ) as run:
        robot = run.robot_file(robot, logs)
        if explain is not None:
            _check_joint(explain, robot)
        options = discover.RefineOptions(
            cutoff_hz=cutoff_hz,
            time_source=time_source,
            part=LogPart.of(start, stop, exclude),
            source=source,
            rounds=rounds,
            with_unexplained=with_unexplained,
            keep_unconfirmed=keep_unconfirmed,
        )
        settings = run.settings(discover.DiscoverSettings(), set_values)
        file = discover.refine(
            logs,
            holdout,
            robot,
            parameters,
            options,
            settings=settings,
            output=output,
            on_progress=run.on_progress,
        )
    run.screen.document(file)
    loop = file.closed_loop
    assert loop is not None  # what a refinement writes
    show_refinement(run.screen, loop, file, explain)
    show_motion(run.screen, loop.motion, file.robot)
    run.show_output(
        output,
        f"seqid predict LOG... -r {quoted(robot)}"
        f" -p {quoted(output)} -o prediction.json",
    )
    is_untrusted = loop.verdict == "poor" or not loop.rounds
    return run.exit_code(loop.verdicts, strict=strict, is_untrusted=is_untrusted)


@app.command(
    "payload",
    epilog=examples(
        f"seqid payload {_VALIDATION} -o payload.json",
        f"seqid payload {_VALIDATION} --friction-change 0.1 --json",
    ),
)
def payload(
    *,
    logs: LogsArgument,
    robot: RobotOption = None,
    parameters: ParametersOption,
    output: OutputOption = None,
    friction_change: Annotated[
        float,
        typer.Option(
            "--friction-change",
            metavar="SHARE",
            callback=number_check(is_positive, "a positive number"),
            help=(
                "Standard deviation by which friction may differ from the model's, as"
                " a share of it."
            ),
        ),
    ] = 0.2,
    source: MotionOption = "auto",
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
    """Identify the mass, centre of mass and inertia of what the flange carries.

    The logs are recorded with the tool or load, the parameter file is of the arm
    without it. Moves of all joints, some of them slow, tell most. The result is in the
    frame of the last joint.
    """
    from seqid_cli import payload as payloads
    from seqid_cli.payload.settings import PayloadSettings

    with CommandRun(
        "payload", quiet=quiet, verbose=verbose, json=json, no_color=no_color
    ) as run:
        robot = run.robot_file(robot, logs)
        options = payloads.PayloadOptions(
            cutoff_hz=cutoff_hz,
            time_source=time_source,
            part=LogPart.of(start, stop, exclude),
            skip_failed=skip_failed,
            source=source,
            friction_change=friction_change,
        )
        settings = run.settings(PayloadSettings(), set_values)
        file = payloads.payload(
            logs,
            robot,
            parameters,
            options,
            settings=settings,
            output=output,
            on_progress=run.on_progress,
        )
    _show_payload(run.screen, file)
    run.show_output(output)
    return run.exit_code(file.verdicts, strict=strict)


def _show_payload(screen: Screen, file: PayloadFile) -> None:
    """Show the body, what is left at each joint, and the verdict."""
    screen.document(file)
    rows = [(name, x.value, x.std_error, x.unit) for name, x in file.payload.numbers()]
    titles = "payload, frame {frame} | value | std error | unit"
    body = tables.values(
        titles, "text number4 number2 text", rows, frame=file.payload.frame
    )
    screen.values(body)
    screen.values(tables.payload_joints(file))
    for where, text in file.settings.items():
        screen.result(f"{where}: {text}")
    of_joints = [verdict for verdict in file.verdicts if verdict.joint]
    show_poor(screen, of_joints, "payload")
    screen.result(f"payload: {verdict_text(file.verdicts, '')}")
    screen.remark(*file.notes)
