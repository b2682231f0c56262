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
    uses = stages.inertia.motion_use if stages.inertia else []
    return Section(
        id="imu",
        title=title,
        lead=lead,
        groups=[
            _group(place, name, stages.imu)
            for place, name in enumerate(stages.imu.imus, start=1)
        ],
        tables=[_motion_table(uses, collection.robot)],
        notes=[*stages.imu.notes, *_notes_on_use(uses)],
    )


def _notes_on_use(uses: Sequence[MotionUse]) -> list[str]:
    """Return remarks on IMUs that took no part, each with its logs."""
    logs_of_warning: dict[str, list[str]] = {}
    for use in uses:
        for warning in use.warnings:
            logs_of_warning.setdefault(warning, []).append(short_path(use.log))
    return [
        f"{warning} ({', '.join(logs)})" for warning, logs in logs_of_warning.items()
    ]


def _group(place: int, name: str, stage: ImuStage) -> Group:
    """Return the group on one IMU."""
    entry = stage.imus[name]
    verdicts = [verdict for verdict in stage.verdicts if verdict.joint == name]
    facts = [
        ("std error", f"{number(entry.std_error_deg, 2)}\u00b0"),
        ("configurations", str(entry.configurations)),
    ]
    if entry.axis_rmse_deg is not None:
        facts.append(("axis error, RMS", f"{number(entry.axis_rmse_deg, 2)}\u00b0"))
    if entry.noise_density is not None:
        facts.append(("noise", f"{number(entry.noise_density)} rad/s\u00b2/\u221aHz"))
    if entry.time_offset_s:
        facts.append(("clock offset", f"{number(1e3 * entry.time_offset_s)} ms"))
    if entry.time_rate:
        facts.append(("clock drift", f"{number(1e3 * entry.time_rate)} ms/s"))

    # Older files have one error for all axes.
    std_errors_deg = entry.std_errors_deg
    if len(std_errors_deg) != 3:
        std_errors_deg = [entry.std_error_deg] * 3
    rotation_rows = [
        (axis, *_fixed(row), std_error)
        for axis, row, std_error in zip(
            "xyz", entry.rotation, std_errors_deg, strict=True
        )
    ]
    rotation = table(
        f"Rotation of {name}",
        "link axis | IMU x | IMU y | IMU z | std error [\u00b0]",
        "text count count count number2",
        rotation_rows,
    )

    axis_rows = []
    for joint, reference in entry.references.items():
        gain = with_error(reference.gain, reference.gain_std_error)
        axis_of_joint = (reference.axis + [0.0] * 3)[:3]
        axis_rows.append((joint, *gain, *_fixed(axis_of_joint)))
    axes = table(
        f"Joint axes as {name} sees them",
        "joint | gain | std error | axis x | y | z",
        "text count count count count count",
        axis_rows,
    )
    return Group(
        id=f"imu-{place}",
        title=name,
        lead=reasons(verdicts),
        badge=badge(verdicts),
        facts=facts,
        tables=[rotation, axes],
        notes=[f"Not determined: {quantity}" for quantity in entry.not_determined],
    )


def _fixed(values: Sequence[float]) -> list[str]:
    """Return numbers with four decimals."""
    return [f"{value:.4f}".replace("-", MINUS) for value in values]


def _motion_table(uses: Sequence[MotionUse], robot: RobotId) -> Table:
    """Return where the motion of each log came from, with its error per joint."""
    rows = []
    joints = []
    for use in uses:
        log = short_path(use.log)
        imus = ", ".join(use.imus)
        for joint, error in use.acceleration_error.items():
            by_encoders = use.encoder_error.get(joint)
            rows.append((log, use.source, imus, joint, error, by_encoders))
            joints.append(joint)

    # The unit is that of all joints: a slide among them has another.
    titles = (
        "log | motion from | IMUs | joint | std error of acceleration [{unit}]"
        " | by encoders alone [{unit}]"
    )
    return table(
        "Where the motion of the inertia logs came from",
        titles,
        "text text text text number2 number2",
        rows,
        unit=robot.unit("rad/s^2", *joints),
    )
