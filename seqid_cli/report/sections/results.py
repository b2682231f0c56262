"""What the flange carries, and what to record next."""

from __future__ import annotations

from seqid_cli.params.results import tables
from seqid_cli.params.results.payload import PayloadFile
from seqid_cli.params.results.plan import PlanFile, PlannedStage
from seqid_cli.report.collection import Collection
from seqid_cli.report.figures.plan import move_figure
from seqid_cli.report.views import (
    VALUE_HEADS,
    Group,
    Section,
    Table,
    badge,
    reasons,
    table,
    table_of,
    value_row,
)
from seqid_cli.report.words import number, percent


def payload(collection: Collection) -> Section | None:
    """Return the section on payloads; None where no file of one is given."""
    if not collection.payloads:
        return None
    lead = (
        "The body that the logs carry beyond the model, by the torque that the model leaves. Its "
        "frame is that of the last joint; its inertia is about the centre of mass."
    )
    groups = [_carried(place, item.content) for place, item in enumerate(collection.payloads)]
    return Section("payload", "Payload", lead, groups)


def _carried(place: int, file: PayloadFile) -> Group:
    state = badge(file.verdicts) or "good"
    body = [value_row(n, x.value, x.std_error, x.unit) for n, x in file.payload.numbers()]
    return Group(
        f"payload-{place + 1}",
        f"Payload, frame {file.payload.frame}",
        lead=reasons(file.verdicts),
        badge=state,
        badge_text=state,
        tables=[
            Table("The body", VALUE_HEADS, body),
            table("As controllers take it", "for | setting", "text text", file.settings.items()),
            table_of("Torque error where joints slide", tables.payload_joints(file)),
        ],
        notes=file.notes,
        unfolded=True,
    )


def plan(collection: Collection) -> Section | None:
    """Return the section on plans; None where none is given."""
    if not collection.plans:
        return None
    groups = [
        _planned(f"plan-{place + 1}-{name}", name, item.content, stage)
        for place, item in enumerate(collection.plans)
        for name, stage in item.content.stages.items()
    ]
    lead = "Moves to record, and the standard errors that parameters will have after them."
    return Section("plan", "What to record next", lead, groups)


def _planned(key: str, name: str, file: PlanFile, stage: PlannedStage) -> Group:
    facts = [("moves", f"{number(stage.duration_s)} s")]
    if stage.rank is not None and stage.structural_rank is not None:
        facts.append(("rank", f"{stage.rank} of {stage.structural_rank}"))
    if stage.condition is not None:
        facts.append(("condition", number(stage.condition)))
    told, moves = stage.separation, [move for move in file.moves if move.stage == name]
    if told is not None:
        facts += [
            ("to tell apart", " and ".join(told.between)),
            ("power", percent(told.power)),
            ("imitated at most", percent(told.imitated)),
        ]
    return Group(
        key,
        name,
        facts=facts,
        figures=[move_figure(move, file) for move in moves],
        tables=[
            table_of("Moves", tables.moves(moves)),
            table_of("Standard errors that it will give", tables.planned_errors(stage)),
        ],
        notes=stage.notes,
    )
