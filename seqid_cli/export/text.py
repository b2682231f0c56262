"""Numbers and remarks of model files, their templates, and the one of ROS 2 parameters."""

import json
import re

import numpy as np

from seqid_cli import __version__
from seqid_cli.export.model import ExportModel
from seqid_cli.export.urdf_tree import root_link
from seqid_cli.model.bodies.pseudo_inertia import Body
from seqid_cli.templates import filled


def real(value: float, *, digits: int = 15) -> str:
    """Return a number in 15 digits, always with a point: YAML takes 9e-05 for text."""
    mantissa, mark, exponent = f"{float(value) + 0.0:.{digits}g}".partition("e")
    return f"{mantissa if '.' in mantissa else f'{mantissa}.0'}{mark}{exponent}"


def rendered(template: str, model: ExportModel, **content: object) -> str:
    """Fill in a template; names of a robot are written by `e` or `tojson_ascii` there."""
    filters = {
        "real": real,
        "spaced": lambda values: " ".join(map(real, values)),
        "row": lambda values: ", ".join(map(real, np.ravel(values))),
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
        "seqid_cli.export", template, of_every_form | content, filters=filters
    )


def plain(text: str) -> str:
    """Return text that can stand in a comment of XML, YAML or C: ASCII, on one line, no marks."""
    line = re.sub(r"[^ -\[\]-~]", ".", text)
    return re.sub(r"(?<=[-*/])(?=[-*/])", " ", line).rstrip("-")


def remarks(model: ExportModel, *, min_errors: float = 0.1) -> list[str]:
    """Return the remarks that a reader of any exported file needs, a line each."""
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

    lines += [
        f"{d.name}: identified {d.identified:.6g} {d.unit}, exported {d.exported:.6g}"
        f" ({d.std_errors:+.2f} standard errors)"
        for d in model.deviations
        if not model.nearest.exact
        and d.std_errors is not None
        and abs(d.std_errors) >= min_errors
    ]

    lines += [
        f"{joint.name}: Coulomb {fit.coulomb:.4g} and viscous {fit.viscous:.4g}"
        f" friction, RMS misfit {fit.rms_misfit:.3g} {joint.unit('N m')} over"
        f" {fit.speed_range[0]:.3g} to {fit.speed_range[1]:.3g} {joint.unit('rad/s')}"
        for joint, fit in zip(model.robot.joints, model.friction, strict=True)
        if fit is not None
    ]
    lines += _loss_lines(model)
    if model.coupling == "gyroscopic":
        lines.append(
            "Rotors turn the links that carry them as well; an armature leaves that"
            " out."
        )
    return [plain(line) for line in [*lines, *model.notes]]


def joint_remarks(model: ExportModel) -> list[str]:
    """Return the remarks of a file that holds friction and armatures alone, a line each."""
    name = (
        f"Friction and armatures of {model.robot.name!r} identified by seqid"
        f" {__version__}."
    )
    return [plain(line) for line in [name, *_loss_lines(model), *model.notes]]


def _loss_lines(model: ExportModel) -> list[str]:
    """Say what the form loses of the file's torque, a line for each joint that loses any."""
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
