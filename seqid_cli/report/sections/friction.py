"""Friction, joint by joint."""

from seqid_cli.params.schema import FrictionStage
from seqid_cli.report.collection import Collection
from seqid_cli.report.figures.friction import FIGURES, drawable
from seqid_cli.report.views import (
    VALUE_HEADS,
    Absent,
    Group,
    Section,
    Table,
    badge,
    reasons,
    table,
    value_row,
)
from seqid_cli.report.words import number, percent

_CALL = "seqid friction LOG... -r robot.toml -o friction.json"


def friction(collection: Collection) -> Section:
    """Return the section on friction."""
    model = collection.model
    stage = model.stages.friction if model else None
    if model is None or stage is None:
        absent = Absent("No friction stage is in the files given.", _CALL)
        return Section("friction", "Friction", absent=[absent])
    lead = (
        "Friction torque as a function of position and velocity (Eq. 7-11). Nothing is known "
        "between the slowest recorded speeds of both directions, where the sign turns; outside the "
        "recorded range Coulomb and viscous friction goes on, at its mean over position."
    )
    groups = [_joint(collection, stage, name) for name in stage.joints]
    notes = list(stage.notes)
    if model.stages.effects:
        notes.append("Effects that refinement added are not part of these surfaces.")
    return Section("friction", "Friction", lead, groups, notes=notes)


def _joint(collection: Collection, stage: FrictionStage, name: str) -> Group:
    joint, place = stage.joints[name], collection.place(name)
    own = [verdict for verdict in stage.verdicts if verdict.joint == name]
    sound = drawable(joint)
    facts = [
        ("orders", f"{joint.position_order}, {joint.velocity_order}"),
        ("RMS error of the fit", f"{number(joint.rmse)} {place.unit}"),
    ]
    if joint.held_out_rmse is not None:
        facts.append(("at left-out speeds", f"{number(joint.held_out_rmse)} {place.unit}"))
    if joint.asymmetry is not None:
        facts.append(("depends on direction", percent(joint.asymmetry)))
    terms = [value_row(x.name, x.value, x.std_error, x.unit) for x in joint.parameters]
    return Group(
        f"friction-{collection.robot.joints.index(name) + 1}",
        name,
        joint=name,
        lead=reasons(own),
        badge=badge(own),
        facts=facts,
        figures=[draw(joint, place) for draw in FIGURES] if sound else [],
        absent=[] if sound else [Absent("Its surface is not finite: identify it anew.", _CALL)],
        tables=[
            table(
                f"Recorded speeds of {name}",
                "speed [{length}/s] | moves forward | backward | RMS error [{unit}]",
                "number count count number",
                [(x.speed, x.forward, x.backward, x.rmse) for x in joint.speeds],
                unit=place.unit,
                length=place.length,
            ),
            Table(f"Friction parameters of {name}", VALUE_HEADS, terms),
        ],
    )
