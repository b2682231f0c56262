"""Forms of files, by their suffix or as a target.

A writer is imported only when needed.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING, Literal, NamedTuple

from msgspec import structs

from seqid_cli.errors import UsageError

if TYPE_CHECKING:
    from seqid_cli.export.model import ExportModel
    from seqid_cli.export.motions import Motions, Unrefined
    from seqid_cli.params.schema import Stages
    from seqid_cli.robot.types import Robot

# How much of a file's model a form can hold: all of it, links with Coulomb and viscous
# friction ("reduced"), the friction of these alone ("joints"), or a load at the flange.
Extent = Literal["whole", "reduced", "joints", "load"]


@dataclass(frozen=True, kw_only=True)
class Format:
    """One form of file: who writes it, and what it has a place for.

    `target` is its name for `--target`, `suffixes` choose it without one. `effects` are
    those that it holds as they are, None where it holds every one.
    """

    title: str
    target: str
    module: str
    function: str
    extent: Extent
    suffixes: tuple[str, ...] = ()
    effects: tuple[str, ...] | None = ()
    offset: bool = False


ALL: tuple[Format, ...] = (
    Format(
        title="URDF",
        target="urdf",
        module="urdf",
        function="urdf",
        extent="reduced",
        suffixes=(".urdf",),
    ),
    Format(
        title="MJCF",
        target="mujoco",
        module="mjcf",
        function="mjcf",
        extent="reduced",
        suffixes=(".xml", ".mjcf"),
        effects=("spring", "backlash"),
    ),
    Format(
        title="MJCF with position actuators",
        target="mujoco-position",
        module="mjcf",
        function="mjcf_with_positions",
        extent="reduced",
        effects=("spring", "backlash"),
    ),
    Format(
        title="MJCF with DC motors",
        target="mujoco-dcmotor",
        module="mjcf",
        function="mjcf_with_dc_motors",
        extent="reduced",
        effects=("spring", "backlash"),
    ),
    Format(
        title="ROS 2 parameters",
        target="ros2-parameters",
        module="text",
        function="ros2_parameters",
        extent="reduced",
        suffixes=(".yaml", ".yml"),
        offset=True,
    ),
    Format(
        title="C header",
        target="c",
        module="code",
        function="c_header",
        extent="whole",
        suffixes=(".h",),
        effects=None,
    ),
    Format(
        title="numpy module",
        target="numpy",
        module="code",
        function="numpy_module",
        extent="whole",
        suffixes=(".py",),
        effects=None,
    ),
    Format(
        title="ros2_control controllers",
        target="ros2-control",
        module="targets",
        function="ros2_control",
        extent="joints",
    ),
    Format(
        title="UR friction model parameters",
        target="ur-friction",
        module="targets",
        function="ur_friction",
        extent="joints",
    ),
    Format(
        title="USD joint attributes",
        target="usd",
        module="targets",
        function="usd_joints",
        extent="joints",
    ),
    Format(
        title="Isaac Lab actuator configuration",
        target="isaac-lab",
        module="targets",
        function="isaac_lab",
        extent="joints",
    ),
    Format(
        title="UR payload",
        target="ur-payload",
        module="loads",
        function="ur_payload",
        extent="load",
    ),
    Format(
        title="Franka load",
        target="franka-load",
        module="loads",
        function="franka_load",
        extent="load",
    ),
)
BY_TITLE: Mapping[str, Format] = {form.title: form for form in ALL}
BY_TARGET: Mapping[str, Format] = {form.target: form for form in ALL}
# The title of each suffix, in the order of the forms.
FORMATS: Mapping[str, str] = {
    suffix: form.title for form in ALL for suffix in form.suffixes
}


class Exported(NamedTuple):
    """A written form of an arm, and the model in it."""

    model: ExportModel
    text: str


def format_of(path: Path, target: str | None = None) -> str:
    """Return the title of the form that `target` names, or else the suffix of `path`."""
    if target is not None:
        form = BY_TARGET.get(target)
        if form is None:
            known = ", ".join(BY_TARGET)
            raise UsageError(
                f"no target is named {target!r}", hint=f"Choose one of: {known}."
            )
        return form.title
    kind = FORMATS.get(path.suffix.lower())
    if kind is None:
        known = ", ".join(f"{suffix} ({name})" for suffix, name in FORMATS.items())
        message = f"no format is known for the suffix {path.suffix!r}"
        hint = f"Choose one of: {known}; or name a form with --target."
        raise UsageError(message, where=str(path), hint=hint)
    return kind


def export(
    robot: Robot,
    stages: Stages,
    *,
    kind: str,
    errors: Mapping[str, float] | None = None,
    before: Unrefined | None = None,
    motions: Motions | None = None,
) -> Exported:
    """Write an arm in a form of `BY_TITLE`.

    Parameters
    ----------
    robot, stages : Robot, Stages
        The arm, and what was identified of it.
    kind : str
        The title of the form.
    errors : mapping, optional
        RMS errors of the torque [N m] on new logs, which set the limits of collision
        detection.
    before : Unrefined, optional
        The file as it came into its refinement; `stages` without effects if left out.
    motions : Motions, optional
        What forms are fitted to that cannot hold the whole model. Without them these
        get the file's own parameters, and nothing is said of what they lose.
    """
    from seqid_cli.export.model import export_model, with_file_torque

    form = BY_TITLE[kind]
    model = export_model(robot, stages, form.effects, errors)
    if motions is not None and form.extent in ("reduced", "joints"):
        from seqid_cli.export.motions import Unrefined
        from seqid_cli.export.reduced import Form, reduced

        held = Form(offset=form.offset, effects=form.effects or ())
        if before is None:
            without_effects = structs.replace(stages, effects=None)
            before = Unrefined(stages=without_effects, is_known=False)
        model = reduced(model, stages, before, motions, held)
    if form.extent == "whole":
        model = with_file_torque(model, stages)
    writer = getattr(import_module(f"seqid_cli.export.{form.module}"), form.function)
    return Exported(model, writer(model))
