"""Forms of files by their suffix. A writer is imported only when it is needed."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

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
    ".py": "numpy module",
}
_HOLDS: Mapping[str, frozenset[str]] = {
    "MJCF": frozenset({"spring", "backlash"}),
    "C header": frozenset({"spring"}),
    "numpy module": frozenset({"spring"}),
}


class Exported(NamedTuple):
    """A written form of an arm, and the model in it."""

    model: ExportModel
    text: str


def format_of(path: Path) -> str:
    """Return the format that a path's suffix stands for.

    Raises UsageError: the suffix is not known.
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


def export(
    robot: Robot, stages: Stages, *, kind: str, errors: Mapping[str, float] | None = None
) -> Exported:
    """Write an identified arm in a form `kind`, a value of `FORMATS`.

    `errors`: RMS error of the torque of each joint on new logs [N m], for thresholds. Raises
    ConfigError: the file does not say enough, or is of another robot. Raises QualityError: no
    physically consistent parameters are found.
    """
    from seqid_cli.export.model import export_model
    from seqid_cli.export.urdf_tree import bodies_of_urdf

    urdf = None if robot.urdf is None else read_urdf_text(robot.urdf)
    bodies = None if urdf is None else bodies_of_urdf(urdf.root, robot.joint_names)
    holds = _HOLDS.get(kind, frozenset())
    model = export_model(robot, stages, bodies, holds=holds, errors=errors)
    return Exported(model, _text(kind, model, urdf, bodies))


def _text(
    kind: str, model: ExportModel, urdf: UrdfText | None, bodies: tuple[UrdfBody, ...] | None
) -> str:
    if kind == "MJCF":
        from seqid_cli.export.mjcf import mjcf_of_chain

        return mjcf_of_chain(model)
    if kind == "ROS 2 parameters":
        from seqid_cli.export.ros2_yaml import ros2_parameters
        from seqid_cli.export.urdf_tree import root_link

        if urdf is None or bodies is None:
            return ros2_parameters(model, "base_link", f"{model.robot.joint_names[-1]}_link")
        return ros2_parameters(model, root_link(urdf.root), bodies[-1].link)
    if kind in ("C header", "numpy module"):
        from seqid_cli.export.code import c_header, numpy_module

        return c_header(model) if kind == "C header" else numpy_module(model)
    from seqid_cli.export.urdf import edited_urdf, urdf_of_chain

    if urdf is None or bodies is None:
        return urdf_of_chain(model)
    return edited_urdf(urdf.raw, bodies, model)
