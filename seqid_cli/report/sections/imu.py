"""How accelerometers and IMUs are mounted on the links, and how well that is known."""

from collections.abc import Sequence

from seqid_cli.params.schema import ImuStage, MotionUse, RobotId
from seqid_cli.report.collection import Collection
from seqid_cli.report.views import Group, Section, Table, badge, lacking, reasons, table
from seqid_cli.report.words import MINUS, number, short_path, with_error

_CALL = "seqid imu-calib LOG... -r robot.toml -p gravity.json -o imu.json"


def imu(collection: Collection) -> Section:
    """Return the section on IMU calibration."""
    title = "IMU calibration"
    stages = collection.model.stages if collection.model else None
    if stages is None or stages.imu is None:
        text = "No IMU stage is in the files given; robots without IMUs have none."
        return lacking("imu", title, text, _CALL)
    lead = (
        "The rotation turns vectors from IMU coordinates into those of the link that"
        " carries the IMU (Eq. 38). The gain compares the joint's acceleration with the"
        " one that the IMU sees about the joint's axis: 1 if both agree (Eq. 31)."
    )
    groups = [
        _group(k, name, stages.imu) for k, name in enumerate(stages.imu.imus, start=1)
    ]
    uses = stages.inertia.motion_use if stages.inertia else []
    # remarks on IMUs that took no part, with their logs
    skipped: dict[str, list[str]] = {}
    for use in uses:
        for warning in use.warnings:
            skipped.setdefault(warning, []).append(short_path(use.log))
    notes = [
        *stages.imu.notes,
        *(f"{text} ({', '.join(logs)})" for text, logs in skipped.items()),
    ]
    motion = [_motion(uses, collection.robot)]
    return Section("imu", title, lead, groups, tables=motion, notes=notes)


def _group(place: int, name: str, stage: ImuStage) -> Group:
    item, verdicts = stage.imus[name], [v for v in stage.verdicts if v.joint == name]
    facts = [("std error", f"{number(item.std_error_deg, 2)}\u00b0")]
    facts.append(("configurations", str(item.configurations)))
    if item.axis_rmse_deg is not None:
        facts.append(("axis error, RMS", f"{number(item.axis_rmse_deg, 2)}\u00b0"))
    if item.noise_density is not None:
        facts.append(("noise", f"{number(item.noise_density)} rad/s\u00b2/\u221aHz"))
    if item.time_offset_s:
        facts.append(("clock offset", f"{number(1e3 * item.time_offset_s)} ms"))
    references = [
        (
            joint,
            *with_error(x.gain, x.gain_std_error),
            *_fixed((x.axis + [0.0] * 3)[:3]),
        )
        for joint, x in item.references.items()
    ]
    errors = (
        item.std_errors_deg
        if len(item.std_errors_deg) == 3
        else [item.std_error_deg] * 3
    )
    axes = zip("xyz", item.rotation, errors, strict=True)
    rows = [(axis, *_fixed(row), error) for axis, row, error in axes]
    titles = "link axis | IMU x | IMU y | IMU z | std error [\u00b0]"
    gains, counts = (
        "joint | gain | std error | axis x | y | z",
        "text count count count count",
    )
    return Group(
        f"imu-{place}",
        name,
        lead=reasons(verdicts),
        badge=badge(verdicts),
        facts=facts,
        tables=[
            table(
                f"Rotation of {name}", titles, "text count count count number2", rows
            ),
            table(
                f"Joint axes as {name} sees them", gains, f"{counts} count", references
            ),
        ],
        notes=[f"Not determined: {what}" for what in item.not_determined],
    )


def _fixed(values: Sequence[float]) -> list[str]:
    return [f"{value:.4f}".replace("-", MINUS) for value in values]


def _motion(uses: Sequence[MotionUse], robot: RobotId) -> Table:
    rows = []
    for use in uses:
        log, imus = short_path(use.log), ", ".join(use.imus)
        for joint, error in use.acceleration_error.items():
            rows.append(
                (log, use.source, imus, joint, error, use.encoder_error.get(joint))
            )
    titles = "log | motion from | IMUs | joint | std error of acceleration [{unit}]"
    titles += " | by encoders alone [{unit}]"
    unit = robot.unit("rad/s^2", *(row[3] for row in rows))
    kinds = "text text text text number2 number2"
    return table(
        "Where the motion of the inertia logs came from", titles, kinds, rows, unit=unit
    )
