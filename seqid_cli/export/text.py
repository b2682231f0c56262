"""Numbers, remarks and templates of model files, and those of ROS 2 parameters."""

import json
import re
from collections.abc import Iterable, Mapping, Sequence

import numpy as np

from seqid_cli import __version__
from seqid_cli.export.model import ExportModel
from seqid_cli.export.urdf_tree import root_link
from seqid_cli.model.bodies.pseudo_inertia import Body
from seqid_cli.params.results.export import ExportedParameter
from seqid_cli.templates import filled
from seqid_cli.typing import Array


def real(value: float, *, digits: int = 15) -> str:
    """Return a number in 15 digits, always with a point: YAML takes 9e-05 for text."""
    text = f"{float(value) + 0.0:.{digits}g}"  # -0 + 0 is 0
    mantissa, mark, exponent = text.partition("e")
    if "." not in mantissa:
        mantissa = f"{mantissa}.0"
    return f"{mantissa}{mark}{exponent}"


def rendered(
    template: str,
    model: ExportModel,
    *,
    snippets: Mapping[str, str] = {},
    **content: object,
) -> str:
    """Fill in a template, which may include `snippets` by their names.

    Names of a robot are written by `e` or `tojson_ascii` there.
    """
    filters = {
        "real": real,
        "spaced": _spaced,
        "row": _row,
        "tojson_ascii": json.dumps,
    }
    of_every_form = {
        "joints": model.robot.joint_names,
        "gravity": model.robot.gravity,
        "remarks": remarks(model),
        "armature": model.armature,
        "friction": model.friction,
    }
    return filled(
        "seqid_cli.export",
        template,
        of_every_form | content,
        filters=filters,
        snippets=snippets,
    )


def _spaced(values: Iterable[float]) -> str:
    """Return numbers with spaces between them, as XML has them."""
    return " ".join(real(value) for value in values)


def _row(values: Array) -> str:
    """Return the numbers of an array of any shape with commas between them."""
    return ", ".join(real(value) for value in np.ravel(values))


def plain(text: str) -> str:
    """Return text that can stand in a comment of XML, YAML or C.

    It is ASCII, on one line, and no mark ends the comment.
    """
    line = re.sub(r"[^ -\[\]-~]", ".", text)
    return re.sub(r"(?<=[-*/])(?=[-*/])", " ", line).rstrip("-")


def remarks(model: ExportModel, *, min_errors: float = 0.1) -> list[str]:
    """Return the remarks that a reader of any exported file needs, a line each.

    `min_errors` are the standard errors from which on a deviation is worth a line.
    """
    lines = [
        f"Inertial parameters of {model.robot.name!r} identified by seqid"
        f" {__version__}."
    ]
    if model.physical is not None:
        lines.append(
            "The torque is exactly that of the file; no body need have these"
            " parameters."
        )
    else:
        met = "but for the deviations that follow"
        if model.nearest.exact:
            met = "exactly"
        lines.append(
            "Every link is physically consistent; what torque does not show is nearest"
            " to the prior."
        )
        lines.append(f"The identified base parameters are met {met}.")

    if not model.nearest.exact:
        lines += _deviation_lines(model.deviations, min_errors)
    lines += _friction_lines(model)
    lines += _loss_lines(model)
    if model.coupling == "gyroscopic":
        lines.append(
            "Rotors turn the links that carry them as well; an armature leaves that"
            " out."
        )
    return [plain(line) for line in [*lines, *model.notes]]


def _deviation_lines(
    deviations: Sequence[ExportedParameter], min_errors: float
) -> list[str]:
    """Say which base parameters are not met, a line for each."""
    return [
        f"{d.name}: identified {d.identified:.6g} {d.unit}, exported {d.exported:.6g}"
        f" ({d.std_errors:+.2f} standard errors)"
        for d in deviations
        if d.std_errors is not None and abs(d.std_errors) >= min_errors
    ]


def _friction_lines(model: ExportModel) -> list[str]:
    """Say what friction is written, a line for each joint that has any."""
    lines = []
    for joint, fit in zip(model.robot.joints, model.friction, strict=True):
        if fit is None:
            continue
        slowest, fastest = fit.speed_range
        lines.append(
            f"{joint.name}: Coulomb {fit.coulomb:.4g} and viscous {fit.viscous:.4g}"
            f" friction, RMS misfit {fit.rms_misfit:.3g} {joint.unit('N m')} over"
            f" {slowest:.3g} to {fastest:.3g} {joint.unit('rad/s')}"
        )
    return lines


def joint_remarks(model: ExportModel) -> list[str]:
    """Return the remarks of a file of friction and armatures alone, a line each."""
    name = (
        f"Friction and armatures of {model.robot.name!r} identified by seqid"
        f" {__version__}."
    )
    return [plain(line) for line in [name, *_loss_lines(model), *model.notes]]


def _loss_lines(model: ExportModel) -> list[str]:
    """Say what the form loses of the file's torque, a line for each joint."""
    if model.loss is None:
        return []
    lines = []
    if model.refitted:
        least = "Links and friction are those that lose least of the file's torque"
        lines.append(f"{least} on {model.loss.fitted_motion}.")
    ranges = model.loss.ranges(model.robot.joint_names)
    for joint, rms in zip(model.robot.joints, model.loss.rms, strict=True):
        unit = joint.unit("N m")
        if np.isnan(rms):
            lines.append(
                f"{joint.name}: what this form loses is not known, it slides nowhere"
            )
            continue
        smallest, largest = ranges[joint.name]
        lost = f"{rms:.3g} {unit} RMS of the file's torque"
        by_log = f"{smallest:.3g} to {largest:.3g} by log"
        lines.append(f"{joint.name}: loses {lost} ({model.loss.motion}; {by_log})")
    return lines


def ros2_parameters(model: ExportModel) -> str:
    """Return the arm's parameters for any node (`/**`), a group per joint.

    Inertias are about the centre of mass in the axes of the joint's frame, as (ixx,
    ixy, ixz, iyy, iyz, izz); `armature` is the rotor's inertia as the joint feels it.
    ROS 2's inverse_dynamics_solver reads the exported URDF from its root link to its
    tip.
    """
    root = "base_link"
    tip = f"{model.robot.joint_names[-1]}_link"
    if model.urdf is not None:
        root = root_link(model.urdf)
        tip = model.links[-1].link
    return rendered(
        "arm.yaml.jinja",
        model,
        root=root,
        tip=tip,
        bodies=[Body.of(phi) for phi in model.bodies],
        upper=np.triu_indices(3),
    )
