"""Identified models in the forms that other tools read."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from seqid_cli.export.formats import export as written
from seqid_cli.export.formats import format_of
from seqid_cli.identify.inputs import Models, model_id, read_models, robot_of
from seqid_cli.logs.given import PathLike, listed
from seqid_cli.params.document import head, join, present, robot_id
from seqid_cli.params.files import check_output, write_text_atomic
from seqid_cli.params.results.export import EXPORT_SCHEMA, ExportedLink, ExportFile
from seqid_cli.params.schema import ParameterFile

if TYPE_CHECKING:
    from seqid_cli.export.model import ExportModel


def export(parameters: Models, robot: PathLike, output: PathLike) -> ExportFile:
    """Write a model in the form that the suffix of `output` stands for.

    Forms are URDF, MJCF, ROS 2 parameters, a C header and a numpy module. Links get inertial
    parameters that a body can have, with the identified torque, as near as can be to the URDF's.

    Parameters
    ----------
    parameters : path or ParameterFile, or a sequence of them
        Whatever was identified.
    robot : path
        The robot file, whose URDF is edited where it names one.
    output : path
        Where the file goes.
    """
    place, target, given = Path(robot), Path(output), listed(parameters)
    kind = format_of(target)
    models = read_models(given)
    previous = join(models)
    files = [Path(model) for model in given if not isinstance(model, ParameterFile)]
    check_output(target, [*files, place])
    arm = robot_of(place, models)
    if arm.urdf is not None:
        check_output(target, [arm.urdf])

    loop = previous.closed_loop
    errors = {name: joint.rmse for name, joint in loop.after.items()} if loop else None
    done = written(arm, previous.stages, kind=kind, errors=errors)
    write_text_atomic(target, done.text)
    model = done.model
    return ExportFile(
        **head(EXPORT_SCHEMA, previous.created),
        robot=robot_id(arm),
        format=kind,
        path=str(target),
        parameters=[model_id(name, file, files) for name, file in models],
        stages=list(present(previous.stages)),
        exact=model.nearest.exact,
        largest_deviation=model.largest_deviation,
        base_parameters=list(model.deviations),
        joints={name: _link(model, k) for k, name in enumerate(arm.joint_names)},
        notes=list(model.notes),
    )


def _link(model: ExportModel, k: int) -> ExportedLink:
    from seqid_cli.model.bodies.pseudo_inertia import Body

    body = Body.of(model.bodies[k])
    return ExportedLink(
        mass=body.mass,
        center_of_mass=body.center.tolist(),
        inertia=body.inertia.tolist(),
        rotor_inertia=float(model.nearest.rotor[k]),
        armature=float(model.armature[k]),
        prior="urdf" if model.nearest.from_cad[k] else "guessed",
        friction=model.friction[k],
    )
