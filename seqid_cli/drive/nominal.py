"""The model of an arm that nothing was identified of: the URDF's inertials alone."""

from seqid_cli.params.schema import RigidStage, Stages
from seqid_cli.robot.base_parameters import standard_names
from seqid_cli.robot.types import Robot

NOMINAL = "nominal"


def nominal_stages(robot: Robot) -> Stages:
    """Return stages whose rigid body is the URDF's, without friction or rotors.

    The robot has nominal inertials.
    """
    assert robot.nominal is not None
    values = robot.nominal.ravel().tolist()
    names = standard_names(robot.n)[: len(values)]
    stage = RigidStage(
        parameters=[],
        condition=1.0,
        rank=0,
        representative={
            name: value
            for name, value in zip(names, values, strict=True)
            if value != 0.0
        },
        method=NOMINAL,
    )
    return Stages(inertia=stage)
