"""`seqid export`: an identified arm as URDF, MJCF, ROS 2 parameters or C."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from seqid_cli.commands.job import exit_code
from seqid_cli.commands.options import RobotPath, Strict
from seqid_cli.commands.render import Screen, number, percent, screen_of
from seqid_cli.export.formats import FORMATS, format_of
from seqid_cli.params.document import join, now, present, robot_id, tool
from seqid_cli.params.files import check_output, write_text_atomic
from seqid_cli.params.io import check_robot, file_sha256, read_parameters
from seqid_cli.robot.file import load_robot
from seqid_cli.robot.toml_read import read_robot_file
from seqid_cli.robot.urdf_text import read_urdf_text

if TYPE_CHECKING:
    from seqid_cli.export.model import ExportModel

EXAMPLES = (
    "seqid export inertia.json -r sample_logs/six_joint/robot.toml -o six_joint.urdf",
    "seqid export inertia.json -r sample_logs/two_joint/robot.toml -o two_joint.xml",
    "seqid export refined.json -r sample_logs/two_joint/robot.toml -o two_joint.h --strict",
)
EXPORT_SCHEMA = "seqid/export@1"
# Identified base parameters that no body has within so many standard errors are not noise.
MAX_STD_ERRORS = 4.0

Files = Annotated[
    list[Path],
    typer.Argument(metavar="FILE...", help="Parameter file; several are joined."),
]
_SUFFIXES = ", ".join(dict.fromkeys(f"{suffix} {name}" for suffix, name in FORMATS.items()))
Target = Annotated[
    Path,
    typer.Option("-o", "--output", metavar="FILE", help=f"Where it goes; by suffix: {_SUFFIXES}."),
]


def run(
    context: typer.Context,
    files: Files,
    robot: RobotPath,
    output: Target,
    strict: Strict = False,
) -> int:
    """Write an identified arm as URDF, MJCF, ROS 2 parameters or C.

    Links get inertial parameters that a body can have, with the identified torque, as near as
    possible to those of the URDF. Friction becomes Coulomb and viscous friction where the format
    knows no other.
    """
    screen = screen_of(context)
    kind = format_of(output)
    parts = [(str(path), read_parameters(path)) for path in files]
    previous = join(parts)
    content = read_robot_file(robot).content
    source = None if content.urdf is None else robot.parent / content.urdf
    check_output(output, [*files, robot, *([source] if source else [])])
    loaded = load_robot(robot)
    for name, part in parts:
        for warning in check_robot(part, loaded, where=name):
            screen.warn(warning)
    raw = None if source is None else read_urdf_text(source).raw

    from seqid_cli.export.formats import export

    done = export(loaded, previous.stages, kind=kind, urdf=raw)
    write_text_atomic(output, done.text)
    model = done.model
    screen.document(
        {
            "schema": EXPORT_SCHEMA,
            "created": now(),
            "tool": tool(),
            "robot": robot_id(loaded),
            "format": kind,
            "path": str(output),
            "parameters": [{"path": str(p), "sha256": file_sha256(p)} for p in files],
            "stages": list(present(previous.stages)),
            **_content(model),
        }
    )
    _show(screen, model)
    screen.note(f"written: {output} ({kind})")
    return exit_code(untrusted=strict and model.largest_deviation > MAX_STD_ERRORS, partial=())


def _content(model: ExportModel) -> dict[str, object]:
    from seqid_cli.model.bodies.pseudo_inertia import Body

    links = {}
    for k, name in enumerate(model.robot.joint_names):
        body, fit = Body.of(model.bodies[k]), model.friction[k]
        links[name] = {
            "mass": body.mass,
            "center_of_mass": body.center.tolist(),
            "inertia": body.inertia.tolist(),
            "rotor_inertia": float(model.rotor[k]),
            "armature": float(model.armature[k]),
            "prior": "urdf" if model.from_cad[k] else "guessed",
            "friction": None
            if fit is None
            else {
                "coulomb": fit.coulomb,
                "viscous": fit.viscous,
                "offset": fit.offset,
                "rms_misfit": fit.misfit,
                "rms": fit.size,
                "speed_range": list(fit.speeds),
            },
        }
    deviations = [
        {
            "name": d.name,
            "unit": d.unit,
            "identified": d.identified,
            "exported": d.exported,
            "std_error": d.std_error,
            "std_errors": d.std_errors,
        }
        for d in model.deviations
    ]
    return {
        "exact": model.exact,
        "largest_deviation": model.largest_deviation,
        "base_parameters": deviations,
        "joints": links,
        "notes": list(model.notes),
    }


def _show(screen: Screen, model: ExportModel) -> None:
    from seqid_cli.model.bodies.pseudo_inertia import Body

    rows = []
    for k, name in enumerate(model.robot.joint_names):
        body, fit = Body.of(model.bodies[k]), model.friction[k]
        center = " ".join(number(float(x)) for x in body.center)
        row = (name, number(body.mass, 4), center, number(float(model.armature[k])))
        friction = ("-", "-", "-")
        if fit is not None:
            share = fit.misfit / fit.size if fit.size > 0.0 else 0.0
            friction = (number(fit.coulomb), number(fit.viscous), percent(share))
        rows.append((*row, *friction))
    columns = ("joint", "mass kg", "centre of mass m", "armature", "Coulomb", "viscous", "misfit")
    screen.table(columns, rows)
    _show_deviations(screen, model)
    for note in model.notes:
        screen.note(f"note: {note}")


def _show_deviations(screen: Screen, model: ExportModel) -> None:
    if model.exact:
        screen.result("the identified base parameters are met exactly by bodies that can exist")
        return
    rows = [
        (d.name, number(d.identified, 5), number(d.exported, 5), f"{d.std_errors:+.2f}", d.unit)
        for d in model.deviations
        if d.std_errors is not None and abs(d.std_errors) >= 0.01
    ]
    screen.result("no body has the identified base parameters; the nearest ones are exported:")
    screen.table(("parameter", "identified", "exported", "std errors", "unit"), rows)
    if model.largest_deviation > MAX_STD_ERRORS:
        screen.warn(
            f"an exported base parameter is {model.largest_deviation:.1f} standard errors away from"
            " what was identified: geometry, gravity or torque scale of the robot file may be wrong"
        )
