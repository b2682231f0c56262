"""`seqid plan`: the experiment to run next, and the errors that it will give."""

from math import isfinite
from pathlib import Path

import typer

from seqid_cli.commands.job import any_poor, called
from seqid_cli.commands.options import OUTPUT, SIX, command, only, option
from seqid_cli.commands.screen.render import Screen, number, percent
from seqid_cli.params.results import tables
from seqid_cli.params.results.plan import EffectSeparation, PlanFile, PlannedStage
from seqid_cli.params.schema import RobotId
from seqid_cli.plan.options import PlanOptions, What

_seconds = only("a positive time")
_share = only("above 0 and at most 1", lambda x: 0.0 < x <= 1.0)


@command(
    "what robot parameters have output trajectories duration_s move_s together ramp_s"
    " share locked speed_scale between joint load_kg keep_out workspace floor seed"
    " strict",
    f"seqid plan all -r {SIX}/robot.toml -o plan.json --trajectories moves",
    f"seqid plan inertia -r {SIX}/robot.toml -p gravity.json -o plan.json",
    "seqid plan inertia -r sample_logs/two_joint/robot.toml --together --duration 60"
    " --trajectories moves",
    f"seqid plan discriminate -r {SIX}/robot.toml -p inertia.json --joint elbow"
    " --between load_dependent_friction,gear_efficiency",
)
def plan(
    context: typer.Context,
    what: What = typer.Argument(
        ...,
        help="The stage to record for, a whole session, or two effects to tell apart.",
    ),
    parameters: list[Path] | None = option(
        None,
        "-p --parameters FILE",
        "What is identified already: torque and noise are taken from it; repeat it to"
        " join.",
    ),
    have: list[str] | None = option(
        None,
        "--have LOG",
        "Logs that inertia or the diagnosis gets as well; repeat it per path, folder or"
        " glob.",
    ),
    output: Path | None = OUTPUT,
    trajectories: Path | None = option(
        None, "--trajectories FOLDER", "Where the moves go as CSV, ROS 2 and UR files."
    ),
    duration_s: float = option(
        PlanOptions.duration_s,
        "--duration S",
        "Time that the inertia moves may take.",
        _seconds,
    ),
    move_s: float | None = option(
        None,
        "--move-duration S",
        "Length of each of these moves; 20 ramps by default.",
        _seconds,
    ),
    together: bool = option(
        False, "--together", "Move all joints at once instead of two at a time."
    ),
    ramp_s: float = option(
        PlanOptions.ramp_s,
        "--ramp S",
        "Time from rest to the largest speed: what limits the acceleration.",
        _seconds,
    ),
    share: float = option(
        PlanOptions.share, "--share X", "Share of all limits to use.", _share
    ),
    locked: list[str] | None = option(
        None, "--lock JOINT", "Keep a joint still; repeat it for several."
    ),
    speed_scale: float = option(
        PlanOptions.speed_scale,
        "--speed-scale X",
        "Slow the files down, for the first run on the robot.",
        _share,
    ),
    between: str | None = option(
        None,
        "--between EFFECT,EFFECT",
        "Of discriminate: the two effects to tell apart.",
    ),
    joint: str | None = option(
        None, "--joint JOINT", "Of discriminate: where they are."
    ),
    load_kg: float = option(
        PlanOptions.load_kg,
        "--load KG",
        "Of payload: the heaviest, for the torque limits.",
        min=0.0,
    ),
    keep_out: list[str] | None = option(
        None, "--keep-out BOX", "Box that no link enters: x,y,z,x,y,z in m; repeat it."
    ),
    workspace: str | None = option(
        None, "--workspace BOX", "Box that no link leaves: x,y,z,x,y,z in m."
    ),
    floor: bool = option(
        True,
        "--floor/--no-floor",
        "Keep every point of the arm above the base plane, across gravity.",
    ),
    seed: int = option(0, "--seed N", "Of the moves that are drawn.", min=0),
) -> int:
    """Plan the moves to record next, within the limits, and the standard errors they will give.

    Limits are the tighter of the robot file's and the URDF's. Nothing is sent to a
    robot.
    """
    context.params |= {
        "locked": tuple(locked or ()),
        "between": tuple(between.split(",")) if between else (),
        "keep_out": tuple(_box(text) for text in keep_out or ()),
        "workspace": None if workspace is None else _box(workspace),
    }
    told, file = called(context, "plan.plan")
    _show(told.screen, file)
    for path in (trajectories, output):
        if path is not None:
            told.screen.note(f"written: {path}")
    return told.ended(untrusted=any_poor(file.verdicts))


def _box(text: str) -> tuple[float, ...]:
    try:
        corners = tuple(float(word) for word in text.split(","))
    except ValueError:
        corners = ()
    if len(corners) != 6 or not all(map(isfinite, corners)):
        raise typer.BadParameter(f"{text!r} is not six numbers x,y,z,x,y,z")
    return corners


def _show(screen: Screen, plan: PlanFile) -> None:
    screen.values(tables.moves(plan.moves))
    for name, stage in plan.stages.items():
        screen.remark(*stage.notes)
        if stage.separation:
            _show_separation(screen, stage.separation, plan.robot)
        if stage.rank is None:
            continue
        screen.values(tables.planned_errors(stage))
        errors = ", ".join(
            f"{joint} {number(x)}" for joint, x in stage.torque_error.items()
        )
        unit = plan.robot.unit("N m", *stage.torque_error)
        tail = f"; torque error by the parameters, {unit}: {errors}" if errors else ""
        screen.result(
            f"{name}: rank {stage.rank} of {stage.structural_rank}, condition"
            f" {number(stage.condition)}{tail}"
        )
        _show_criterion(screen, name, stage)
        if stage.not_excited:
            screen.remark(f"not excited: {'; '.join(stage.not_excited)}")
    for verdict in plan.verdicts:
        if not verdict.good:
            screen.warn(verdict.reason)
    screen.remark(*plan.notes)
    screen.note(f"noise of the torque: {plan.noise_origin}")
    screen.result(
        f"{len(plan.moves)} moves, {plan.duration_s:.0f} s of motion,"
        f" {plan.total_s:.0f} s with the ways between them"
    )


def _show_criterion(screen: Screen, name: str, stage: PlannedStage) -> None:
    """Say what the search minimised, its value, and both conditions of Eq. 20."""
    if stage.criterion is not None:
        minimised, value = stage.criterion.minimised, number(stage.criterion.value)
        screen.result(f"{name}: minimised was {minimised}: {value}")
    if stage.plain_condition is not None:
        screen.result(
            f"{name}: cond(Phi(H_g)) of Eq. 20 is {number(stage.plain_condition)},"
            f" with columns of length 1 {number(stage.scaled_condition)}"
        )


def _show_separation(screen: Screen, told: EffectSeparation, robot: RobotId) -> None:
    first, second = told.between
    needed = told.seconds_needed
    length = (
        "no length of them is enough"
        if needed is None
        else f"{number(needed)} s are enough"
    )
    unit = robot.unit("N m", *([told.joint] if told.joint else robot.joints))
    screen.result(
        f"{first} or {second}, of {number(told.size)} {unit} RMS: the diagnosis tells"
        f" them apart with probability {percent(told.power)}; for 95 % {length}"
    )
