"""The commands that identify a stage: friction, gravity, IMUs, inertia, or all at once."""

from collections.abc import Sequence
from pathlib import Path

import typer

from seqid_cli.commands.job import called
from seqid_cli.commands.options import ADDED_TO, SIX, command, option
from seqid_cli.commands.screen.show import show_stages
from seqid_cli.identify.settings import (
    FrictionSettings,
    GravitySettings,
    ImuCalibSettings,
    InertiaSettings,
    SimultaneousSettings,
)
from seqid_cli.params.document import worst_level
from seqid_cli.params.schema import Stages

_SHARED = "cutoff_hz time_source jobs engine scheduler skip_failed"
_NEXT_INERTIA = "seqid inertia LOG... -r {robot} -p {output} -o inertia.json"
_NEXT_DIAGNOSE = "seqid diagnose LOG... -r {robot} -p {output} -o diagnosis.json"
_NEXT_PREDICT = "seqid predict LOG... -r {robot} -p {output} -o prediction.json"


@command(
    f"logs robot output position_order velocity_order beta {_SHARED} strict",
    f"seqid friction {SIX}/friction -r {SIX}/robot.toml -o friction.json",
    f"seqid friction '{SIX}/friction/*' -r {SIX}/robot.toml --position-order 4"
    " --velocity-order 5 --json",
    settings=FrictionSettings(),
)
def friction(
    context: typer.Context,
    position_order: int | None = option(
        None,
        "--position-order N",
        "Order in position; found when left out.",
        min=0,
        max=30,
    ),
    velocity_order: int | None = option(
        None,
        "--velocity-order N",
        "Order in velocity; found when left out.",
        min=0,
        max=30,
    ),
    beta: float | None = option(
        None,
        "--beta SHARE",
        "Take the fewest orders at which Eq. 11 holds with this threshold, if any do.",
        min=0.0,
        max=1.0,
    ),
) -> int:
    """Identify joint friction over position and velocity.

    The logs hold moves of one joint at a time at constant velocity, forward and
    backward, at several speeds.
    """
    following = "seqid gravity LOG... -r {robot} -p {output} -o gravity.json"
    return _stage(context, ["friction"], following)


@command(
    f"logs robot parameters output {_SHARED} strict",
    f"seqid gravity {SIX}/gravity {SIX}/friction -r {SIX}/robot.toml -p friction.json"
    " -o gravity.json",
    f"seqid gravity {SIX}/gravity -r {SIX}/robot.toml -p friction.json --strict",
    settings=GravitySettings(),
)
def gravity(context: typer.Context) -> int:
    """Identify the gravity parameters, given the friction.

    The logs hold moves of one joint at a time at constant velocity, with the other
    joints locked in several configurations.
    """
    following = f"{_NEXT_INERTIA}  (with accelerometers: seqid imu-calib first)"
    return _stage(context, ["gravity"], following)


@command(
    f"logs robot parameters output {_SHARED} strict",
    f"seqid imu-calib {SIX}/imu -r {SIX}/robot.toml -p gravity.json -o imu.json",
    f"seqid imu-calib {SIX}/imu -r {SIX}/robot.toml --json",
    settings=ImuCalibSettings(),
)
def imu_calib(context: typer.Context, parameters: list[Path] | None = ADDED_TO) -> int:
    """Find how accelerometers and IMUs are mounted on the links, and what they are like.

    The logs hold rotations of the first joint with the other joints locked in several
    configurations. Mounting, place, biases, scales, axes and clock offset are found
    together.
    """
    return _stage(context, ["imu"], _NEXT_INERTIA)


@command(
    f"logs robot parameters output source {_SHARED} consistent strict",
    f"seqid inertia {SIX}/inertia -r {SIX}/robot.toml -p imu.json -o inertia.json",
    f"seqid inertia {SIX}/inertia -r {SIX}/robot.toml -p gravity.json --motion encoder"
    " --strict",
    settings=InertiaSettings(),
)
def inertia(context: typer.Context) -> int:
    """Identify the inertia parameters, given friction and gravity.

    The logs hold moves of two joints (or more) at a time.
    """
    return _stage(context, ["inertia"], _NEXT_PREDICT)


@command(
    "logs robot parameters output offset source cutoff_hz time_source consistent"
    " strict",
    f"seqid simultaneous {SIX}/inertia -r {SIX}/robot.toml -o simultaneous.json",
    f"seqid simultaneous {SIX}/friction {SIX}/inertia -r {SIX}/robot.toml --json",
    settings=SimultaneousSettings(),
)
def simultaneous(
    context: typer.Context,
    parameters: list[Path] | None = ADDED_TO,
    offset: bool = option(
        True,
        "--offset/--no-offset",
        "Give each joint a constant torque besides friction.",
    ),
) -> int:
    """Identify all parameters at once, with Coulomb and viscous friction (Eq. 5-6).

    Any logs will do. For comparison, and for data without moves of single joints. With
    the file of seqid imu-calib (-p) accelerometers are used as well.
    """
    return _stage(context, ["friction", "inertia"], _NEXT_PREDICT)


def _stage(context: typer.Context, names: Sequence[str], following: str) -> int:
    """Identify and show stages; `following` is proposed unless a verdict is poor."""
    told, file = called(context, f"identify.{context.info_name}".replace("-", "_"))
    stages = Stages(**{name: getattr(file.stages, name) for name in names})
    show_stages(told.screen, stages, file.robot)
    verdicts = [verdict for name in names for verdict in getattr(stages, name).verdicts]
    level = worst_level(verdicts)
    proposed = {"good": following, "usable": _NEXT_DIAGNOSE, "poor": ""}
    told.tell_output(proposed[level] if level else following)
    return told.ended(verdicts)
