"""`seqid export`: an identified arm as URDF, MJCF, ROS 2 parameters or C."""

from pathlib import Path
from typing import Annotated

import typer

from seqid_cli.commands.job import listening
from seqid_cli.commands.options import RobotPath, Strict, option
from seqid_cli.commands.screen.render import Screen, number
from seqid_cli.export.formats import FORMATS
from seqid_cli.params.results.export import ExportFile
from seqid_cli.params.results.tables import values

EXAMPLES = (
    "seqid export inertia.json -r sample_logs/six_joint/robot.toml -o six_joint.urdf",
    "seqid export inertia.json -r sample_logs/two_joint/robot.toml -o two_joint.xml",
    "seqid export refined.json -r sample_logs/two_joint/robot.toml -o two_joint.h --strict",
)
# Identified base parameters that no body has within so many standard errors are not noise.
MAX_STD_ERRORS = 4.0

Files = Annotated[
    list[Path], typer.Argument(metavar="FILE...", help="Parameter file; several are joined.")
]
_SUFFIXES = ", ".join(dict.fromkeys(f"{suffix} {name}" for suffix, name in FORMATS.items()))
Target = Annotated[Path, option("-o --output FILE", f"Where it goes; by suffix: {_SUFFIXES}.")]


def run(
    context: typer.Context, files: Files, robot: RobotPath, output: Target, strict: Strict = False
) -> int:
    """Write an identified arm as URDF, MJCF, ROS 2 parameters or C.

    Links get inertial parameters that a body can have, with the identified torque, as near as
    possible to those of the URDF. Friction becomes Coulomb and viscous friction where the format
    knows no other.
    """
    with listening(context) as told:
        from seqid_cli.export import export

        file = export(files, robot, output)
    told.screen.document(file)
    _show(told.screen, file)
    told.screen.note(f"written: {output} ({file.format})")
    return told.ended(untrusted=file.largest_deviation > MAX_STD_ERRORS)


def _show(screen: Screen, file: ExportFile) -> None:
    rows = []
    for name, link in file.joints.items():
        center, fit = " ".join(number(x) for x in link.center_of_mass), link.friction
        friction: tuple[float | None, ...] = (None, None, None)
        if fit is not None:
            share = fit.rms_misfit / fit.rms if fit.rms > 0.0 else 0.0
            friction = (fit.coulomb, fit.viscous, share)
        rows.append((name, link.mass, center, link.armature, *friction))
    titles = "joint | mass [kg] | centre of mass [m] | armature | Coulomb | viscous | misfit"
    screen.values(values(titles, "text number4 text number number number share", rows))
    if file.exact:
        screen.result("the identified base parameters are met exactly by bodies that can exist")
    else:
        _show_deviations(screen, file)
    for note in file.notes:
        screen.note(f"note: {note}")


def _show_deviations(screen: Screen, file: ExportFile) -> None:
    rows = [
        (d.name, d.identified, d.exported, f"{d.std_errors:+.2f}", d.unit)
        for d in file.base_parameters
        if d.std_errors is not None and abs(d.std_errors) >= 0.01
    ]
    screen.result("no body has the identified base parameters; the nearest ones are exported:")
    titles = "parameter | identified | exported | std errors | unit"
    screen.values(values(titles, "text number5 number5 text text", rows))
    if file.largest_deviation > MAX_STD_ERRORS:
        screen.warn(
            f"an exported base parameter is {file.largest_deviation:.1f} standard errors away from"
            " what was identified: geometry, gravity or torque scale of the robot file may be wrong"
        )
