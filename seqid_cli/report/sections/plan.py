"""What to record next, and the errors that it will give."""

from __future__ import annotations

from seqid_cli.params.results import tables
from seqid_cli.params.results.plan import PlanFile, PlannedStage
from seqid_cli.report.collection import Collection
from seqid_cli.report.figures.plan import move_figure
from seqid_cli.report.views import Group, Section, table_of
from seqid_cli.report.words import number, percent


def plan(collection: Collection) -> Section | None:
    """Return the section on plans; None where none is given."""
    if not collection.plans:
        return None
    groups = [
        _group(f"plan-{place + 1}-{name}", name, file, stage)
        for place, file in enumerate(collection.plans)
        for name, stage in file.stages.items()
    ]
    lead = "Moves to record, and the standard errors that parameters will have after them."
    return Section("plan", "What to record next", lead, groups)


def _group(key: str, name: str, file: PlanFile, stage: PlannedStage) -> Group:
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
