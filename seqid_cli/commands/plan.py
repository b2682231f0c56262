"""`seqid plan`: the experiment to run next, and the errors that it will give."""

from math import isfinite
from pathlib import Path
from typing import Annotated

import typer

from seqid_cli.commands.command_run import CommandRun, any_not_good
from seqid_cli.commands.options import (
    SIX,
    DebugOption,
    ExcludeOption,
    FromOption,
    JsonOption,
    NoColorOption,
    OutputOption,
    QuietOption,
    RobotOption,
    SetOption,
    ShowSettingsOption,
    StrictOption,
    ToOption,
    VerboseOption,
    command_app,
    examples,
    is_positive,
    number_check,
)
from seqid_cli.commands.screen.render import Screen, number, percent
from seqid_cli.logs.reading import LogPart
from seqid_cli.params.results import tables
from seqid_cli.params.results.plan import EffectSeparation, PlanFile, PlannedStage
from seqid_cli.params.schema import RobotId
from seqid_cli.plan import PlanOptions
from seqid_cli.plan import plan as plan_moves
from seqid_cli.plan.options import What
from seqid_cli.plan.settings import PlanSettings

app = command_app()

_seconds_check = number_check(is_positive, "a positive time")
_share_check = number_check(lambda x: 0.0 < x <= 1.0, "above 0 and at most 1")


@app.command(
    "plan",
    epilog=examples(
        f"seqid plan all -r {SIX}/robot.toml -o plan.json --trajectories moves",
        f"seqid plan inertia -r {SIX}/robot.toml -p gravity.json -o plan.json",
        "seqid plan inertia -r sample_logs/two_joint/robot.toml --together --duration"
        " 60 --trajectories moves",
        f"seqid plan discriminate -r {SIX}/robot.toml -p inertia.json --joint elbow"
        " --between load_dependent_friction,gear_efficiency",
    ),
)
def plan(
    *,
    what: Annotated[
        What,
        typer.Argument(
            help=(
                "The stage to record for, a whole session, or two effects to tell"
                " apart."
            ),
        ),
    ],
    robot: RobotOption = None,
    parameters: Annotated[
        list[Path] | None,
        typer.Option(
            "-p",
            "--parameters",
            metavar="FILE",
            help=(
                "What is identified already: torque and noise are taken from it;"
                " repeat it to join."
            ),
        ),
    ] = None,
    have: Annotated[
        list[str] | None,
        typer.Option(
            "--have",
            metavar="LOG",
            help=(
                "Logs that inertia or the diagnosis gets as well; repeat it per path,"
                " folder or glob."
            ),
        ),
    ] = None,
    start: FromOption = None,
    stop: ToOption = None,
    exclude: ExcludeOption = None,
    output: OutputOption = None,
    trajectories: Annotated[
        Path | None,
        typer.Option(
            "--trajectories",
            metavar="FOLDER",
            help="Where the moves go as CSV, ROS 2 and UR files.",
        ),
    ] = None,
    duration_s: Annotated[
        float,
        typer.Option(
            "--duration",
            metavar="S",
            callback=_seconds_check,
            help="Time that the inertia moves may take.",
        ),
    ] = PlanOptions.duration_s,
    move_s: Annotated[
        float | None,
        typer.Option(
            "--move-duration",
            metavar="S",
            callback=_seconds_check,
            help="Length of each of these moves; 20 ramps by default.",
        ),
    ] = None,
    together: Annotated[
        bool,
        typer.Option(
            "--together", help="Move all joints at once instead of two at a time."
        ),
    ] = False,
    ramp_s: Annotated[
        float,
        typer.Option(
            "--ramp",
            metavar="S",
            callback=_seconds_check,
            help=("Time from rest to the largest speed: what limits the acceleration."),
        ),
    ] = PlanOptions.ramp_s,
    share: Annotated[
        float,
        typer.Option(
            "--share",
            metavar="X",
            callback=_share_check,
            help="Share of all limits to use.",
        ),
    ] = PlanOptions.share,
    locked: Annotated[
        list[str] | None,
        typer.Option(
            "--lock",
            metavar="JOINT",
            help="Keep a joint still; repeat it for several.",
        ),
    ] = None,
    speed_scale: Annotated[
        float,
        typer.Option(
            "--speed-scale",
            metavar="X",
            callback=_share_check,
            help="Slow the files down, for the first run on the robot.",
        ),
    ] = PlanOptions.speed_scale,
    between: Annotated[
        str | None,
        typer.Option(
            "--between",
            metavar="EFFECT,EFFECT",
            help="Of discriminate: the two effects to tell apart.",
        ),
    ] = None,
    joint: Annotated[
        str | None,
        typer.Option(
            "--joint", metavar="JOINT", help="Of discriminate: where they are."
        ),
    ] = None,
    bandwidth_hz: Annotated[
        float,
        typer.Option(
            "--bandwidth",
            metavar="HZ",
            callback=number_check(is_positive, "a positive frequency"),
            help="Of drive: that of the position loops, about.",
        ),
    ] = PlanOptions.bandwidth_hz,
    load_kg: Annotated[
        float,
        typer.Option(
            "--load",
            metavar="KG",
            min=0.0,
            help="Of payload: the heaviest, for the torque limits.",
        ),
    ] = PlanOptions.load_kg,
    keep_out: Annotated[
        list[str] | None,
        typer.Option(
            "--keep-out",
            metavar="BOX",
            help="Box that no link enters: x,y,z,x,y,z in m; repeat it.",
        ),
    ] = None,
    workspace: Annotated[
        str | None,
        typer.Option(
            "--workspace",
            metavar="BOX",
            help="Box that no link leaves: x,y,z,x,y,z in m.",
        ),
    ] = None,
    floor: Annotated[
        bool,
        typer.Option(
            "--floor/--no-floor",
            help="Keep every point of the arm above the base plane, across gravity.",
        ),
    ] = True,
    seed: Annotated[
        int,
        typer.Option("--seed", metavar="N", min=0, help="Of the moves that are drawn."),
    ] = 0,
    strict: StrictOption = False,
    set_values: SetOption = None,
    show_settings: ShowSettingsOption = False,
    quiet: QuietOption = False,
    verbose: VerboseOption = False,
    json: JsonOption = False,
    no_color: NoColorOption = False,
    debug: DebugOption = False,
) -> int:
    """Plan the moves to record next, within the limits, and the \
standard errors they will give.

    Limits are the tighter of the robot file's and the URDF's. Nothing is sent to a
    robot.
    """  # noqa: D205
    with CommandRun(
        "plan", quiet=quiet, verbose=verbose, json=json, no_color=no_color
    ) as run:
        robot = run.robot_file(robot)
        options = PlanOptions(
            duration_s=duration_s,
            move_s=move_s,
            together=together,
            seed=seed,
            ramp_s=ramp_s,
            share=share,
            locked=tuple(locked or ()),
            speed_scale=speed_scale,
            between=tuple(name.strip() for name in between.split(","))
            if between
            else (),
            joint=joint,
            bandwidth_hz=bandwidth_hz,
            load_kg=load_kg,
            keep_out=tuple(_box(text) for text in keep_out or ()),
            workspace=None if workspace is None else _box(workspace),
            floor=floor,
            part=LogPart.of(start, stop, exclude),
        )
        settings = run.settings(PlanSettings(), set_values)
        file = plan_moves(
            what,
            robot,
            parameters or (),
            options,
            settings=settings,
            have=have or (),
            output=output,
            trajectories=trajectories,
        )
    run.screen.document(file)
    _show(run.screen, file)
    for path in (trajectories, output):
        if path is not None:
            run.screen.note(f"written: {path}")
    return run.exit_code(strict=strict, is_untrusted=any_not_good(file.verdicts))


def _box(text: str) -> tuple[float, ...]:
    """Return x, y, z of two corners of a box [m], from six numbers between commas."""
    try:
        corners = tuple(float(word) for word in text.split(","))
    except ValueError:
        corners = ()
    if len(corners) != 6 or not all(map(isfinite, corners)):
        raise typer.BadParameter(f"{text!r} is not six numbers x,y,z,x,y,z")
    return corners


def _show(screen: Screen, plan: PlanFile) -> None:
    """Show the moves, and what each stage will know after them."""
    screen.values(tables.moves(plan.moves))
    for name, stage in plan.stages.items():
        screen.remark(*stage.notes)
        if stage.separation:
            _show_separation(screen, stage.separation, plan.robot)
        if stage.rank is not None:
            _show_stage(screen, name, stage, plan.robot)
    for verdict in plan.verdicts:
        if not verdict.good:
            screen.warn(verdict.reason)
    screen.remark(*plan.notes)
    screen.note(f"noise of the torque: {plan.noise_origin}")
    screen.result(
        f"{len(plan.moves)} moves, {plan.duration_s:.0f} s of motion,"
        f" {plan.total_s:.0f} s with the ways between them"
    )


def _show_stage(screen: Screen, name: str, stage: PlannedStage, robot: RobotId) -> None:
    """Show the errors that a stage will have, its rank and what was minimised."""
    screen.values(tables.planned_errors(stage))

    torque_errors = ""
    if stage.torque_error:
        unit = robot.unit("N m", *stage.torque_error)
        errors = ", ".join(
            f"{joint} {number(error)}" for joint, error in stage.torque_error.items()
        )
        torque_errors = f"; torque error by the parameters, {unit}: {errors}"
    screen.result(
        f"{name}: rank {stage.rank} of {stage.structural_rank}, condition"
        f" {number(stage.condition)}{torque_errors}"
    )

    _show_criterion(screen, name, stage)
    if stage.not_excited:
        screen.remark(f"not excited: {'; '.join(stage.not_excited)}")


def _show_criterion(screen: Screen, name: str, stage: PlannedStage) -> None:
    """Say what the search minimised, its value, and both conditions of Eq. 20."""
    if stage.criterion is not None:
        value = number(stage.criterion.value)
        screen.result(f"{name}: minimised was {stage.criterion.minimised}: {value}")
    if stage.plain_condition is not None:
        screen.result(
            f"{name}: cond(Phi(H_g)) of Eq. 20 is {number(stage.plain_condition)},"
            f" with columns of length 1 {number(stage.scaled_condition)}"
        )


def _show_separation(
    screen: Screen, separation: EffectSeparation, robot: RobotId
) -> None:
    """Say how surely a diagnosis of the moves tells two effects apart."""
    if separation.seconds_needed is None:
        length = "no length of them is enough"
    else:
        length = f"{number(separation.seconds_needed)} s are enough"
    first, second = separation.between
    joints = [separation.joint] if separation.joint else robot.joints
    unit = robot.unit("N m", *joints)
    screen.result(
        f"{first} or {second}, of {number(separation.size)} {unit} RMS: the diagnosis"
        f" tells them apart with probability {percent(separation.power)}; for 95 %"
        f" {length}"
    )
