"""Stages as tables: numbers with their units, a verdict per joint, and why it is poor."""

from collections import Counter
from collections.abc import Collection, Sequence
from dataclasses import dataclass
from statistics import median

from seqid_cli.commands.screen.render import Screen, number
from seqid_cli.params import schema
from seqid_cli.params.document import poor_because, worst_level
from seqid_cli.params.results.tables import of_joints, values


def show_stages(screen: Screen, stages: schema.Stages, robot: schema.RobotId) -> None:
    """Print the stages of a robot that are there."""
    if stages.friction is not None:
        _friction(screen, stages.friction, robot)
    if stages.imu is not None:
        _imu(screen, stages.imu)
    for name, stage in (("gravity", stages.gravity), ("inertia", stages.inertia)):
        if stage is not None:
            _rigid(screen, name, stage, robot)


def verdict_text(verdicts: Sequence[schema.Verdict], joint: str) -> str:
    """Return `good`, or `usable` or `poor` and why, or a dash where nothing was judged."""
    level = worst_level(verdict for verdict in verdicts if verdict.joint == joint)
    if level is None:
        return "-"
    if level == "good":
        return level
    return f"{level}: {poor_because(verdicts, joint)}"


def show_poor(screen: Screen, verdicts: Sequence[schema.Verdict], whole: str) -> None:
    """Print what is poor, of a document that has no line for every joint."""
    show_verdicts(screen, [verdict for verdict in verdicts if not verdict.good], whole)


def show_verdicts(
    screen: Screen,
    verdicts: Sequence[schema.Verdict],
    whole: str,
    notes: Sequence[str] = (),
    *,
    shown: Collection[str] = (),
) -> None:
    """Print the verdicts on other joints than those `shown`, or on the `whole`, and the notes."""
    for name in dict.fromkeys(verdict.joint for verdict in verdicts):
        if name not in shown:
            screen.result(f"{name or whole}: {verdict_text(verdicts, name)}")
    screen.remark(*notes)


def _friction(screen: Screen, stage: schema.FrictionStage, robot: schema.RobotId) -> None:
    rows = []
    for name, x in stage.joints.items():
        # The classical fit has no measured friction to ask Eq. 11 of.
        largest = None if x.criterion_met is None else x.max_error
        errors = (x.rmse, x.held_out_rmse, largest)
        orders, verdict = (x.position_order, x.velocity_order), verdict_text(stage.verdicts, name)
        rows.append((name, orders, *errors, verdict))
    titles = "joint | orders | RMS error [{unit}] | held-out [{unit}] | Eq. 11 | verdict"
    screen.values(of_joints(titles, "text text number number share text", rows, robot))
    show_verdicts(screen, stage.verdicts, "friction", stage.notes, shown=stage.joints)


def _rigid(screen: Screen, name: str, stage: schema.RigidStage, robot: schema.RobotId) -> None:
    if not stage.parameters:
        screen.result(f"{name}: nothing to identify on this robot")
    rows = [(x.name, x.value, x.std_error, x.unit) for x in stage.parameters]
    titles = "parameter | value | std error | unit"
    screen.values(values(titles, "text number5 number2 text", rows))
    if stage.parameters:
        screen.result(f"{name}: rank {stage.rank}, condition {number(stage.condition)}")
    if stage.not_excited:
        screen.result(f"not excited by these logs: {', '.join(stage.not_excited)}")
    joints = [(joint, x, verdict_text(stage.verdicts, joint)) for joint, x in stage.rmse.items()]
    titles = "joint | RMS error [{unit}] | verdict"
    screen.values(of_joints(titles, "text number text", joints, robot))
    show_verdicts(screen, stage.verdicts, name, stage.notes, shown=stage.rmse)
    show_motion(screen, stage.motion_use, robot)


def _imu(screen: Screen, stage: schema.ImuStage) -> None:
    rows = []
    for name, x in stage.imus.items():
        errors, verdict = (x.std_error_deg, x.axis_rmse_deg), verdict_text(stage.verdicts, name)
        rows.append((name, *errors, x.configurations, verdict))
    titles = "imu | std error deg | axis error deg | configurations | verdict"
    screen.values(values(titles, "text number number count text", rows))
    show_verdicts(screen, stage.verdicts, "imu", stage.notes, shown=stage.imus)


@dataclass(frozen=True)
class _TwoErrors:
    """Standard errors of one joint's acceleration: by the source that was taken, and another."""

    joint: str
    taken: float
    other: float


def _medians(errors: Sequence[_TwoErrors], robot: schema.RobotId, other: str) -> str:
    """Say the medians of both errors, unit by unit."""
    by_unit: dict[str, list[_TwoErrors]] = {}
    for error in errors:
        by_unit.setdefault(robot.unit("rad/s^2", error.joint), []).append(error)
    text = ""
    for unit, own in by_unit.items():
        now = number(median(error.taken for error in own), 2)
        before = number(median(error.other for error in own), 2)
        text += f"; acceleration known to {now} {unit}, {other} {before} (medians)"
    return text


def show_motion(screen: Screen, uses: Sequence[schema.MotionUse], robot: schema.RobotId) -> None:
    """Say which source the motion came from and what that gained, and warn of IMUs left aside."""
    for warning, count in Counter(w for use in uses for w in use.warnings).items():
        if count > 1:
            screen.warn(f"{warning} ({count} of {len(uses)} logs)")
        else:
            log = next(use.log for use in uses if warning in use.warnings)
            screen.warn(f"{log}: {warning}")
    if not any(use.imus or use.warnings or use.fused_error for use in uses):
        return  # no IMU could take part
    parts = []
    for (source, imus), count in Counter((use.source, tuple(use.imus)) for use in uses).items():
        names = f" ({', '.join(imus)})" if imus else ""
        parts.append(f"{source}{names} in {count} of {len(uses)} logs")
    with_imus = [
        _TwoErrors(joint, error, use.encoder_error[joint])
        for use in uses
        for joint, error in use.acceleration_error.items()
        if use.imus
    ]
    # Both errors below the encoders' own cut-off, where the IMUs would have made it worse.
    by_encoders = [
        _TwoErrors(joint, use.encoder_error[joint], error)
        for use in uses
        for joint, error in use.fused_error.items()
        if not use.imus
    ]
    gain = _medians(with_imus, robot, "by the encoders alone")
    gain = gain or _medians(by_encoders, robot, "with the IMUs as well")
    screen.note(f"motion: {', '.join(parts)}{gain}")
