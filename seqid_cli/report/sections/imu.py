"""How accelerometers and IMUs are mounted on the links, and how well that is known."""

from __future__ import annotations

import math
from collections.abc import Sequence

from seqid_cli.params.schema import ImuCalibration, RigidStage, Verdict
from seqid_cli.report.collection import Collection
from seqid_cli.report.views import Absent, Group, Section, Table, badge, numbers, texts
from seqid_cli.report.words import number, short_path, with_error

_CALL = "seqid imu-calib LOG... -r robot.toml -p gravity.json -o imu.json"


def imu(collection: Collection) -> Section:
    """Return the section on IMU calibration."""
    title = "IMU calibration"
    model = collection.model
    stage = model.stages.imu if model else None
    if stage is None:
        text = "No IMU stage is in the files given; robots without IMUs have none."
        return Section("imu", title, absent=[Absent(text, _CALL)])
    lead = (
        "The rotation turns vectors from IMU coordinates into those of the link that carries the "
        "IMU (Eq. 38). The gain compares the joint's acceleration with the one that the IMU sees "
        "about the joint's axis: 1 if both agree (Eq. 31)."
    )
    groups = [
        _group(place, name, item, [v for v in stage.verdicts if v.joint == name])
        for place, (name, item) in enumerate(stage.imus.items())
    ]
    inertia = model.stages.inertia if model else None
    motion = [_motion(inertia)] if inertia else []
    notes = [*stage.notes, *(_warnings(inertia) if inertia else [])]
    return Section("imu", title, lead, groups, tables=motion, notes=notes)


def _group(place: int, name: str, item: ImuCalibration, verdicts: Sequence[Verdict]) -> Group:
    state, text = badge(verdicts)
    facts = [("std error", f"{number(item.std_error_deg, 2)}\u00b0")]
    facts.append(("configurations", str(item.configurations)))
    if item.axis_rmse_deg is not None:
        facts.append(("axis error, RMS", f"{number(item.axis_rmse_deg, 2)}\u00b0"))
    if item.noise_density is not None:
        facts.append(("noise", f"{number(item.noise_density)} rad/s\u00b2/\u221aHz"))
    if item.time_offset_s:
        facts.append(("clock offset", f"{number(1e3 * item.time_offset_s)} ms"))
    return Group(
        f"imu-{place + 1}",
        name,
        lead="; ".join(verdict.reason for verdict in verdicts if verdict.reason),
        badge=state,
        badge_text=text,
        facts=facts,
        tables=[_rotation(name, item), _references(name, item)],
        notes=[f"Not determined: {what}" for what in item.not_determined],
    )


def _rotation(name: str, item: ImuCalibration) -> Table:
    axes = ("x", "y", "z")
    columns = (
        *texts("link axis"),
        *numbers(*(f"IMU {axis}" for axis in axes)),
        *numbers("std error", unit="\u00b0"),
    )
    errors = item.std_errors_deg if len(item.std_errors_deg) == 3 else [item.std_error_deg] * 3
    rows = [
        (axis, *(f"{value:.4f}".replace("-", "\u2212") for value in row), number(error, 2))
        for axis, row, error in zip(axes, item.rotation, errors, strict=True)
    ]
    return Table(f"Rotation of {name}", columns, rows, _turn(item))


def _turn(item: ImuCalibration) -> str:
    trace = sum(item.rotation[i][i] for i in range(3))
    angle = math.degrees(math.acos(min(max((trace - 1.0) / 2.0, -1.0), 1.0)))
    return f"Turned by {angle:.1f}\u00b0 in all."


def _references(name: str, item: ImuCalibration) -> Table:
    columns = (*texts("joint"), *numbers("gain", "std error", "axis x", "y", "z"))
    rows = []
    for joint, reference in item.references.items():
        axis = [f"{value:.3f}".replace("-", "\u2212") for value in (reference.axis + [0.0] * 3)[:3]]
        rows.append((joint, *with_error(reference.gain, reference.gain_std_error), *axis))
    return Table(f"Joint axes as {name} sees them", columns, rows)


def _warnings(stage: RigidStage) -> list[str]:
    """Remarks on IMUs that took no part, or only partly; each once, with its logs."""
    logs: dict[str, list[str]] = {}
    for use in stage.motion_use:
        for warning in use.warnings:
            logs.setdefault(warning, []).append(short_path(use.log))
    return [f"{warning} ({', '.join(names)})" for warning, names in logs.items()]


def _motion(stage: RigidStage) -> Table:
    columns = (
        *texts("log", "motion from", "IMUs", "joint"),
        *numbers("std error of acceleration", "by encoders alone", unit="rad/s\u00b2"),
    )
    rows = [
        (
            short_path(use.log) if place == 0 else "",
            use.source if place == 0 else "",
            ", ".join(use.imus) if place == 0 else "",
            joint,
            number(error, 2),
            number(use.encoder_error.get(joint), 2),
        )
        for use in stage.motion_use
        for place, (joint, error) in enumerate(use.acceleration_error.items())
    ]
    return Table("Where the motion of the inertia logs came from", columns, rows)
