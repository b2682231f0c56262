"""Forms of files, by their suffix or as a target."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
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
    """One form of file, and what it has a place for.

    Attributes
    ----------
    title : str
        Its name in results and messages.
    target : str
        Its name for `--target`.
    extent : str
        How much of a file's model it can hold.
    suffixes : tuple of str
        Those that choose it without a target.
    effects : tuple of str or None
        Effects that it holds as they are, None where it holds every one.
    offset : bool
        Whether it has a place for a constant torque.
    """

    title: str
    target: str
    extent: Extent
    suffixes: tuple[str, ...] = ()
    effects: tuple[str, ...] | None = ()
    offset: bool = False


ALL: tuple[Format, ...] = (
    Format(
        title="URDF",
        target="urdf",
        extent="reduced",
        suffixes=(".urdf",),
    ),
    Format(
        title="MJCF",
        target="mujoco",
        extent="reduced",
        suffixes=(".xml", ".mjcf"),
        effects=("spring", "backlash"),
    ),
    Format(
        title="MJCF with position actuators",
        target="mujoco-position",
        extent="reduced",
        effects=("spring", "backlash"),
    ),
    Format(
        title="MJCF with DC motors",
        target="mujoco-dcmotor",
        extent="reduced",
        effects=("spring", "backlash"),
    ),
    Format(
        title="ROS 2 parameters",
        target="ros2-parameters",
        extent="reduced",
        suffixes=(".yaml", ".yml"),
        offset=True,
    ),
    Format(
        title="C header",
        target="c",
        extent="whole",
        suffixes=(".h",),
        effects=None,
    ),
    Format(
        title="numpy module",
        target="numpy",
        extent="whole",
        suffixes=(".py",),
        effects=None,
    ),
    Format(
        title="ros2_control controllers",
        target="ros2-control",
        extent="joints",
    ),
    Format(
        title="UR friction model parameters",
        target="ur-friction",
        extent="joints",
    ),
    Format(
        title="USD joint attributes",
        target="usd",
        extent="joints",
    ),
    Format(
        title="Isaac Lab actuator configuration",
        target="isaac-lab",
        extent="joints",
    ),
    Format(
        title="UR payload",
        target="ur-payload",
        extent="load",
    ),
    Format(
        title="Franka load",
        target="franka-load",
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
    """Return the title of the form that `target` names, or else the suffix of `path`.

    Raises
    ------
    UsageError
        There is no form of this name or suffix.
    """
    if target is not None:
        form = BY_TARGET.get(target)
        if form is None:
            targets = ", ".join(BY_TARGET)
            raise UsageError(
                f"no target is named {target!r}", hint=f"Choose one of: {targets}."
            )
        return form.title

    title = FORMATS.get(path.suffix.lower())
    if title is None:
        suffixes = ", ".join(f"{suffix} ({name})" for suffix, name in FORMATS.items())
        raise UsageError(
            f"no format is known for the suffix {path.suffix!r}",
            where=str(path),
            hint=f"Choose one of: {suffixes}; or name a form with --target.",
        )
    return title


def export(
    robot: Robot,
    stages: Stages,
    *,
    kind: str,
    errors: Mapping[str, float] | None = None,
    unrefined: Unrefined | None = None,
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
    unrefined : Unrefined, optional
        The file as it came into its refinement; `stages` without effects if left out.
    motions : Motions, optional
        What forms are fitted to that cannot hold the whole model. Without them these
        get the file's own parameters, and nothing is said of what they lose.

    Returns
    -------
    Exported
        The text, and the model whose numbers stand in it.
    """
    from seqid_cli.export.model import export_model, with_file_torque

    form = BY_TITLE[kind]
    model = export_model(robot, stages, form.effects, errors)
    if motions is not None and form.extent in ("reduced", "joints"):
        from seqid_cli.export.motions import Unrefined
        from seqid_cli.export.reduced import Form, reduced

        held = Form(offset=form.offset, effects=form.effects or ())
        if unrefined is None:
            without_effects = structs.replace(stages, effects=None)
            unrefined = Unrefined(stages=without_effects, is_known=False)
        model = reduced(model, stages, unrefined, motions, held)
    if form.extent == "whole":
        model = with_file_torque(model, stages)
    return Exported(model=model, text=_writers()[form.title](model))


def _writers() -> Mapping[str, Callable[[ExportModel], str]]:
    """Return the function that writes each form of an arm, by the form's title.

    They are imported here: a command that only lists the forms has no use for them.
    """
    from seqid_cli.export import code, mjcf, targets, text, urdf

    return {
        "URDF": urdf.urdf,
        "MJCF": mjcf.mjcf,
        "MJCF with position actuators": mjcf.mjcf_with_positions,
        "MJCF with DC motors": mjcf.mjcf_with_dc_motors,
        "ROS 2 parameters": text.ros2_parameters,
        "C header": code.c_header,
        "numpy module": code.numpy_module,
        "ros2_control controllers": targets.ros2_control,
        "UR friction model parameters": targets.ur_friction,
        "USD joint attributes": targets.usd_joints,
        "Isaac Lab actuator configuration": targets.isaac_lab,
    }
