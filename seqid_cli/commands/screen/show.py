"""Stages as tables: numbers with units, a verdict per joint, and its reason."""

from collections import Counter
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass

from seqid_cli.commands.screen.render import Screen, number
from seqid_cli.params import schema
from seqid_cli.params.document import poor_because, worst_level
from seqid_cli.params.results.tables import of_joints, values


def show_stages(screen: Screen, stages: schema.Stages, robot: schema.RobotId) -> None:
    """Print those stages of a robot that have been identified."""
    if stages.friction is not None:
        _friction(screen, stages.friction, robot)
    if stages.imu is not None:
        _imu(screen, stages.imu)
    for name, stage in (("gravity", stages.gravity), ("inertia", stages.inertia)):
        if stage is not None:
            _rigid(screen, name, stage, robot)


def verdict_text(
    verdicts: Sequence[schema.Verdict],
    joint: str,
    *,
    shared: Collection[str] = (),
) -> str:
    """Return the worst verdict on a joint and its reason; a dash without any.

    Reasons that are `shared` with other joints stand below the table, see
    `show_shared`.
    """
    level = worst_level(verdict for verdict in verdicts if verdict.joint == joint)
    if level is None:
        return "-"
    if level == "good":
        return level
    own = [verdict for verdict in verdicts if verdict.reason not in shared]
    reasons = poor_because(own, joint)
    if reasons == poor_because(verdicts, joint):
        return f"{level}: {reasons}"
    return f"{level}: {reasons}; see below" if reasons else f"{level}: see below"


def shared_reasons(
    verdicts: Sequence[schema.Verdict], joints: Collection[str]
) -> dict[str, list[str]]:
    """Return the reasons why several of the joints are not good, with these joints."""
    joints_of: dict[str, list[str]] = {}
    for verdict in verdicts:
        if verdict.joint in joints and not verdict.good:
            named = joints_of.setdefault(verdict.reason, [])
            if verdict.joint not in named:
                named.append(verdict.joint)
    return {reason: named for reason, named in joints_of.items() if len(named) > 1}


def show_shared(screen: Screen, shared: Mapping[str, Sequence[str]]) -> None:
    """Print a line for each reason that joints of the table above it share."""
    for reason, joints in shared.items():
        screen.result(f"{', '.join(joints)}: {reason}")


def show_poor(
    screen: Screen, verdicts: Sequence[schema.Verdict], name_of_whole: str
) -> None:
    """Print the verdicts that are not good, of a document without a line per joint."""
    show_verdicts(
        screen, [verdict for verdict in verdicts if not verdict.good], name_of_whole
    )


def show_verdicts(
    screen: Screen,
    verdicts: Sequence[schema.Verdict],
    name_of_whole: str,
    notes: Sequence[str] = (),
    *,
    in_table: Collection[str] = (),
) -> None:
    """Print the verdicts and the notes.

    `name_of_whole` names what a verdict without a joint is on; joints `in_table` are
    left out, as a table has their verdicts. Joints of which the same is to be said
    share a line.
    """
    names_of: dict[str, list[str]] = {}
    for name in dict.fromkeys(verdict.joint for verdict in verdicts):
        if name not in in_table:
            text = verdict_text(verdicts, name)
            names_of.setdefault(text, []).append(name or name_of_whole)
    for text, names in names_of.items():
        screen.result(f"{', '.join(names)}: {text}")
    screen.remark(*notes)


def _friction(
    screen: Screen, stage: schema.FrictionStage, robot: schema.RobotId
) -> None:
    """Print a row per joint: the orders of its surface, its errors and its verdict."""
    rows = []
    shared = shared_reasons(stage.verdicts, stage.joints)
    for name, joint in stage.joints.items():
        # The classical fit has no measured friction to ask Eq. 11 of.
        largest_error = None if joint.criterion_met is None else joint.max_error
        row = (
            name,
            (joint.position_order, joint.velocity_order),
            joint.rmse,
            joint.held_out_rmse,
            largest_error,
            verdict_text(stage.verdicts, name, shared=shared),
        )
        rows.append(row)
    titles = (
        "joint | orders | RMS error [{unit}] | held-out [{unit}] | Eq. 11 | verdict"
    )
    kinds = "text text number number share text"
    screen.values(of_joints(titles, kinds, rows, robot))
    show_shared(screen, shared)
    show_verdicts(
        screen, stage.verdicts, "friction", stage.notes, in_table=stage.joints
    )


def _rigid(
    screen: Screen, name: str, stage: schema.RigidStage, robot: schema.RobotId
) -> None:
    """Print the parameters of a stage, then a row per joint: its error and verdict."""
    if not stage.parameters:
        # A robot without parameters, such as a planar arm's gravity, excites none.
        text = "nothing to identify on this robot"
        if stage.not_excited:
            text = "nothing is identified: these logs are too short, or move too little"
        screen.result(f"{name}: {text}")
    parameters = [
        (parameter.name, parameter.value, parameter.std_error, parameter.unit)
        for parameter in stage.parameters
    ]
    titles = "parameter | value | std error | unit"
    screen.values(values(titles, "text number5 number2 text", parameters))

    if stage.parameters:
        condition = number(stage.condition)
        screen.result(f"{name}: rank {stage.rank}, condition {condition}")
    if stage.not_excited:
        screen.result(f"not excited by these logs: {', '.join(stage.not_excited)}")

    shared = shared_reasons(stage.verdicts, stage.rmse)
    joints = [
        (joint, rmse, verdict_text(stage.verdicts, joint, shared=shared))
        for joint, rmse in stage.rmse.items()
    ]
    titles = "joint | RMS error [{unit}] | verdict"
    screen.values(of_joints(titles, "text number text", joints, robot))
    show_shared(screen, shared)
    show_verdicts(screen, stage.verdicts, name, stage.notes, in_table=stage.rmse)
    show_motion(screen, stage.motion_use, robot)


def _imu(screen: Screen, stage: schema.ImuStage) -> None:
    """Print a row per IMU: the errors of its mounting and its verdict."""
    rows = []
    shared = shared_reasons(stage.verdicts, stage.imus)
    for name, imu in stage.imus.items():
        row = (
            name,
            imu.std_error_deg,
            imu.axis_rmse_deg,
            imu.configurations,
            verdict_text(stage.verdicts, name, shared=shared),
        )
        rows.append(row)
    titles = "imu | std error deg | axis error deg | configurations | verdict"
    screen.values(values(titles, "text number number count text", rows))
    show_shared(screen, shared)
    show_verdicts(screen, stage.verdicts, "imu", stage.notes, in_table=stage.imus)


@dataclass(frozen=True, kw_only=True)
class _AccelerationErrors:
    """Standard errors of a joint's acceleration, by the chosen source and another.

    In rad/s^2, or in m/s^2 of a joint that slides.
    """

    joint: str
    chosen: float
    by_other: float


def show_motion(
    screen: Screen, uses: Sequence[schema.MotionUse], robot: schema.RobotId
) -> None:
    """Say which source the motion came from and what that gained.

    Warns of IMUs that were left aside. Says nothing where no IMU could take part.
    """
    _warn_of_imus(screen, uses)
    if not any(use.imus or use.warnings or use.fused_error for use in uses):
        return

    sources = Counter((use.source, tuple(use.imus)) for use in uses)
    shares = []
    for (source, imus), count in sources.items():
        names = f" ({', '.join(imus)})" if imus else ""
        shares.append(f"{source}{names} in {count} of {len(uses)} logs")

    with_imus = [
        _AccelerationErrors(
            joint=joint, chosen=error, by_other=use.encoder_error[joint]
        )
        for use in uses
        for joint, error in use.acceleration_error.items()
        if use.imus
    ]
    # Both errors below the encoders' own cut-off, where the IMUs would have made it
    # worse.
    by_encoders = [
        _AccelerationErrors(
            joint=joint, chosen=use.encoder_error[joint], by_other=error
        )
        for use in uses
        for joint, error in use.fused_error.items()
        if not use.imus
    ]
    if with_imus:
        gain = _median_errors(with_imus, robot, "by the encoders alone")
    else:
        gain = _median_errors(by_encoders, robot, "with the IMUs as well")
    screen.note(f"motion: {', '.join(shares)}{gain}")


def _warn_of_imus(screen: Screen, uses: Sequence[schema.MotionUse]) -> None:
    """Say why IMUs were left aside; what several logs share is said once."""
    counts = Counter(warning for use in uses for warning in use.warnings)
    for warning, count in counts.items():
        if count > 1:
            screen.warn(f"{warning} ({count} of {len(uses)} logs)")
        else:
            log = next(use.log for use in uses if warning in use.warnings)
            screen.warn(f"{log}: {warning}")


def _median_errors(
    errors: Sequence[_AccelerationErrors], robot: schema.RobotId, other_source: str
) -> str:
    """Return the medians of both errors in words, unit by unit."""
    from statistics import median

    by_unit: dict[str, list[_AccelerationErrors]] = {}
    for error in errors:
        unit = robot.unit("rad/s^2", error.joint)
        by_unit.setdefault(unit, []).append(error)

    text = ""
    for unit, unit_errors in by_unit.items():
        chosen_error = number(median(error.chosen for error in unit_errors), 2)
        other_error = number(median(error.by_other for error in unit_errors), 2)
        text += (
            f"; acceleration known to {chosen_error} {unit}, {other_source}"
            f" {other_error} (medians)"
        )
    return text
