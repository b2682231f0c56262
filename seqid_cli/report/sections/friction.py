"""Friction, joint by joint."""

from __future__ import annotations

from seqid_cli.params.schema import FrictionJoint, FrictionStage
from seqid_cli.report.collection import Collection
from seqid_cli.report.figures.friction import FIGURES, drawable
from seqid_cli.report.figures.torque import Place
from seqid_cli.report.views import VALUE_COLUMNS, Absent, Group, Section, Table, badge, numbers
from seqid_cli.report.words import interval, number, percent, unit_text, with_error

_CALL = "seqid friction LOG... -r robot.toml -o friction.json"


def friction(collection: Collection) -> Section:
    """Return the section on friction."""
    title = "Friction"
    model = collection.model
    stage = model.stages.friction if model else None
    if model is None or stage is None:
        absent = Absent("No friction stage is in the files given.", _CALL)
        return Section("friction", title, absent=[absent])
    lead = (
        "Friction torque as a function of position and velocity (Eq. 7-11). Nothing is known "
        "between the slowest recorded speeds of both directions, where the sign turns; outside the "
        "recorded range Coulomb and viscous friction goes on, at its mean over position."
    )
    groups = [
        _joint(name, joint, stage, place, collection.robot.joints.index(name))
        for name, joint in stage.joints.items()
        for place in [Place(name, *collection.units(name))]
    ]
    notes = list(stage.notes)
    if model.stages.effects:
        notes.append("Effects that refinement added are not part of these surfaces.")
    return Section("friction", title, lead, groups, notes=notes)


def _joint(
    name: str, joint: FrictionJoint, stage: FrictionStage, place: Place, index: int
) -> Group:
    mine = [verdict for verdict in stage.verdicts if verdict.joint == name]
    sound = drawable(joint)
    state, text = badge(mine)
    unit = unit_text(place.torque_unit)
    facts = [
        ("orders", f"{joint.position_order}, {joint.velocity_order}"),
        ("RMS error of the fit", f"{number(joint.rmse)} {unit}"),
    ]
    if joint.held_out_rmse is not None:
        facts.append(("at left-out speeds", f"{number(joint.held_out_rmse)} {unit}"))
    if joint.asymmetry is not None:
        facts.append(("depends on direction", percent(joint.asymmetry)))
    return Group(
        f"friction-{index + 1}",
        name,
        joint=name,
        lead="; ".join(verdict.reason for verdict in mine if verdict.reason),
        badge=state,
        badge_text=text,
        facts=facts,
        figures=[draw(joint, place) for draw in FIGURES] if sound else [],
        absent=[] if sound else [Absent("Its surface is not finite: identify it anew.", _CALL)],
        tables=[_speeds(name, joint, place), _terms(name, joint)],
    )


def _speeds(name: str, joint: FrictionJoint, place: Place) -> Table:
    columns = (
        *numbers("speed", unit=f"{unit_text(place.position_unit)}/s"),
        *numbers("moves forward", "backward"),
        *numbers("RMS error", unit=unit_text(place.torque_unit)),
    )
    rows = [
        (number(item.speed), str(item.forward), str(item.backward), number(item.rmse))
        for item in joint.speeds
    ]
    return Table(f"Recorded speeds of {name}", columns, rows)


def _terms(name: str, joint: FrictionJoint) -> Table:
    rows = [
        (
            item.name,
            *with_error(item.value, item.std_error),
            interval(item.value, item.std_error),
            unit_text(item.unit),
        )
        for item in joint.parameters
    ]
    return Table(f"Friction parameters of {name}", VALUE_COLUMNS, rows)
