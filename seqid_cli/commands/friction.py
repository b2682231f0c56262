"""`seqid friction`: the first stage."""

from typing import Annotated, Any

import typer

from seqid_cli.commands import options as opt
from seqid_cli.commands.job import listening, show_stage

EXAMPLES = (
    "seqid friction sample_logs/six_joint/friction -r sample_logs/six_joint/robot.toml"
    " -o friction.json",
    "seqid friction 'sample_logs/six_joint/friction/*' -r sample_logs/six_joint/robot.toml"
    " --position-order 4 --velocity-order 5 --json",
)
_FOLLOWING = "seqid gravity LOG... -r {robot} -p {output} -o gravity.json"

PositionOrder = Annotated[
    int | None,
    opt.option("--position-order N", "Order in position; found when left out.", min=0, max=30),
]
VelocityOrder = Annotated[
    int | None,
    opt.option("--velocity-order N", "Order in velocity; found when left out.", min=0, max=30),
]
Beta = Annotated[
    float | None,
    opt.option(
        "--beta SHARE",
        "End the search for orders as soon as Eq. 11 holds at this threshold.",
        min=0.0,
        max=1.0,
    ),
]


@opt.takes(
    "logs robot output position_order velocity_order beta"
    " cutoff_hz time_source jobs engine scheduler skip_failed strict"
)
def run(
    context: typer.Context,
    position_order: PositionOrder = None,
    velocity_order: VelocityOrder = None,
    beta: Beta = None,
    **shared: Any,
) -> int:
    """Identify joint friction over position and velocity.

    The logs hold moves of one joint at a time at constant velocity, forward and backward, at
    several speeds.
    """
    with listening(context) as told:
        from seqid_cli import identify

        file = told.call(identify.friction, identify.FrictionOptions)
    return show_stage(told, file, ["friction"], _FOLLOWING)
