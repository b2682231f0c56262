"""Forms of files by their suffix. A writer is imported only when it is needed."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from seqid_cli.errors import UsageError
from seqid_cli.robot.urdf.text import UrdfText, read_urdf_text

if TYPE_CHECKING:
    from seqid_cli.export.model import ExportModel
    from seqid_cli.export.urdf_tree import UrdfBody
    from seqid_cli.params.schema import Stages
    from seqid_cli.robot.types import Robot

FORMATS: Mapping[str, str] = {
    ".urdf": "URDF",
    ".xml": "MJCF",
    ".mjcf": "MJCF",
    ".yaml": "ROS 2 parameters",
    ".yml": "ROS 2 parameters",
    ".h": "C header",
}


@dataclass(frozen=True)
class Exported:
    """A written form of an arm, and the model in it."""

    model: ExportModel
    text: str


def format_of(path: Path) -> str:
    """Return the format that a path's suffix stands for.

    Raises
    ------
    UsageError
        The suffix is not known.
    """
    kind = FORMATS.get(path.suffix.lower())
    if kind is None:
        known = ", ".join(f"{suffix} ({name})" for suffix, name in FORMATS.items())
        raise UsageError(
            f"no format is known for the suffix {path.suffix!r}",
            where=str(path),
            hint=f"Choose one of: {known}.",
        )
    return kind


def export(robot: Robot, stages: Stages, *, kind: str) -> Exported:
    """Write an identified arm in one of the forms of `FORMATS`.

    Parameters
    ----------
    robot : Robot
    stages : Stages
        Whatever was identified.
    kind : str
        A value of `FORMATS`.

    Returns
    -------
    Exported

    Raises
    ------
    ConfigError
        If the file does not say enough, or is of another robot.
    QualityError
        If no physically consistent parameters are found.
    """
    from seqid_cli.export.model import export_model
    from seqid_cli.export.urdf_tree import bodies_of_urdf

    urdf = None if robot.urdf is None else read_urdf_text(robot.urdf)
    bodies = None if urdf is None else bodies_of_urdf(urdf.root, robot.joint_names)
    model = export_model(robot, stages, bodies)
    return Exported(model, _text(kind, model, urdf, bodies))


def _text(
    kind: str, model: ExportModel, urdf: UrdfText | None, bodies: tuple[UrdfBody, ...] | None
) -> str:
    if kind == "MJCF":
        from seqid_cli.export.mjcf import mjcf_of_chain

        return mjcf_of_chain(model)
    if kind == "ROS 2 parameters":
        from seqid_cli.export.ros2_yaml import ros2_parameters

        return ros2_parameters(model)
    if kind == "C header":
        from seqid_cli.export.c_header import c_header

        return c_header(model)
    from seqid_cli.export.urdf import edited_urdf, urdf_of_chain

    if urdf is None or bodies is None:
        return urdf_of_chain(model)
    return edited_urdf(urdf.raw, bodies, model)
