"""Stages as tables: numbers with their units, a verdict per joint, and why it is poor."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from seqid_cli.commands.screen.render import Screen, number
from seqid_cli.commands.screen.show_motion import show_motion
from seqid_cli.params.schema import FrictionStage, ImuStage, RigidStage, Stages, Verdict


def show_stages(screen: Screen, stages: Stages) -> None:
    """Print the stages that are there."""
    if stages.friction is not None:
        _friction(screen, stages.friction)
    if stages.gravity is not None:
        _rigid(screen, "gravity", stages.gravity)
    if stages.imu is not None:
        _imu(screen, stages.imu)
    if stages.inertia is not None:
        _rigid(screen, "inertia", stages.inertia)


def verdict_text(verdicts: Sequence[Verdict], joint: str) -> str:
    """Return `good`, or `poor` and why, or a dash where nothing was judged."""
    mine = [verdict for verdict in verdicts if verdict.joint == joint]
    reasons = [verdict.reason for verdict in mine if not verdict.good]
    if reasons:
        return "poor: " + "; ".join(reasons)
    return "good" if mine else "-"


def show_poor(screen: Screen, verdicts: Sequence[Verdict], whole: str) -> None:
    """Print what is poor, of a document that has no line for every joint."""
    for name in dict.fromkeys(verdict.joint for verdict in verdicts if not verdict.good):
        screen.result(f"{name or whole}: {verdict_text(verdicts, name)}")


def _friction(screen: Screen, stage: FrictionStage) -> None:
    columns = ("joint", "orders", "RMS error N m", "held-out N m", "largest N m", "verdict")
    rows = [
        (
            name,
            f"({joint.position_order}, {joint.velocity_order})",
            number(joint.rmse),
            number(joint.held_out_rmse),
            number(joint.max_abs_error),
            verdict_text(stage.verdicts, name),
        )
        for name, joint in stage.joints.items()
    ]
    screen.table(columns, rows)
    _remarks(screen, "friction", stage.verdicts, stage.notes, stage.joints)


def _rigid(screen: Screen, name: str, stage: RigidStage) -> None:
    if not stage.parameters:
        screen.result(f"{name}: nothing to identify on this robot")
    rows = [
        (item.name, number(item.value, 5), number(item.std_error, 2), item.unit)
        for item in stage.parameters
    ]
    screen.table(("parameter", "value", "std error", "unit"), rows)
    if stage.parameters:
        screen.result(f"{name}: rank {stage.rank}, condition {number(stage.condition)}")
    if stage.not_excited:
        screen.result(f"not excited by these logs: {', '.join(stage.not_excited)}")
    joints = [
        (joint, number(rmse), verdict_text(stage.verdicts, joint))
        for joint, rmse in stage.rmse.items()
    ]
    screen.table(("joint", "RMS error N m", "verdict"), joints)
    _remarks(screen, name, stage.verdicts, stage.notes, stage.rmse)
    show_motion(screen, stage.motion_use)


def _imu(screen: Screen, stage: ImuStage) -> None:
    columns = ("imu", "std error deg", "axis error deg", "configurations", "verdict")
    rows = [
        (
            name,
            number(imu.std_error_deg),
            number(imu.axis_rmse_deg),
            str(imu.configurations),
            verdict_text(stage.verdicts, name),
        )
        for name, imu in stage.imus.items()
    ]
    screen.table(columns, rows)
    _remarks(screen, "imu", stage.verdicts, stage.notes, stage.imus)


def _remarks(
    screen: Screen,
    stage: str,
    verdicts: Sequence[Verdict],
    notes: Sequence[str],
    shown: Mapping[str, object],
) -> None:
    for name in dict.fromkeys(verdict.joint for verdict in verdicts):
        if name not in shown:
            screen.result(f"{name or stage}: {verdict_text(verdicts, name)}")
    for note in notes:
        screen.remark(note)
