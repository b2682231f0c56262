"""Forms of files by their suffix. A writer is imported only when it is needed."""

from __future__ import annotations

from collections.abc import Mapping
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

from seqid_cli.errors import UsageError

if TYPE_CHECKING:
    from seqid_cli.export.model import ExportModel
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
# Of each format: the module and the function that write it, and effects that it has a place for
# (None: for every one).
_WRITERS: Mapping[str, tuple[str, str, tuple[str, ...] | None]] = {
    "URDF": ("urdf", "urdf", ()),
    "MJCF": ("mjcf", "mjcf", ("spring", "backlash")),
    "ROS 2 parameters": ("text", "ros2_parameters", ()),
    "C header": ("code", "c_header", None),
    "numpy module": ("code", "numpy_module", None),
}


class Exported(NamedTuple):
    """A written form of an arm, and the model in it."""

    model: ExportModel
    text: str


def format_of(path: Path) -> str:
    """Return the format that a path's suffix stands for."""
    kind = FORMATS.get(path.suffix.lower())
    if kind is None:
        known = ", ".join(f"{suffix} ({name})" for suffix, name in FORMATS.items())
        message = f"no format is known for the suffix {path.suffix!r}"
        raise UsageError(message, where=str(path), hint=f"Choose one of: {known}.")
    return kind


def export(
    robot: Robot, stages: Stages, *, kind: str, errors: Mapping[str, float] | None = None
) -> Exported:
    """Write an arm in a form of `FORMATS`; RMS torque `errors` [N m] on new logs set its limits."""
    from seqid_cli.export.model import export_model

    module, function, holds = _WRITERS[kind]
    model = export_model(robot, stages, holds, errors)
    return Exported(model, getattr(import_module(f"seqid_cli.export.{module}"), function)(model))
