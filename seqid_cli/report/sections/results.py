"""What the flange carries, and what to record next."""

import numpy as np

from seqid_cli.motion.planned import sampled
from seqid_cli.params.results import tables
from seqid_cli.params.results.plan import PlanFile, PlannedMove, PlannedStage
from seqid_cli.params.results.tables import Values
from seqid_cli.report import views
from seqid_cli.report.chart import figure, small_panel
from seqid_cli.report.collection import Collection
from seqid_cli.report.words import number, percent

_POINTS = 80


def payload(collection: Collection) -> views.Section | None:
    """Return the section on payloads; None where no file of one is given."""
    if not collection.payloads:
        return None
    lead = (
        "The body that the logs carry beyond the model, by the torque that the model"
        " leaves. Its frame is that of the last joint; its inertia is about the centre"
        " of mass."
    )
    groups = []
    for place, file in enumerate(
        (item.content for item in collection.payloads), start=1
    ):
        body = [
            views.value_row(n, x.value, x.std_error, x.unit)
            for n, x in file.payload.numbers()
        ]
        told = tables.values("for | setting", "text text", file.settings.items())
        group = views.Group(
            f"payload-{place}",
            f"Payload, frame {file.payload.frame}",
            lead=views.reasons(file.verdicts),
            badge=views.badge(file.verdicts),
            tables=[
                views.Table("The body", Values(views.VALUE_HEADS, body)),
                views.Table("As controllers take it", told),
                views.Table(
                    "Torque error where joints slide", tables.payload_joints(file)
                ),
            ],
            notes=file.notes,
            unfolded=True,
        )
        groups.append(group)
    return views.Section("payload", "Payload", lead, groups)


def plan(collection: Collection) -> views.Section | None:
    """Return the section on plans; None where none is given."""
    if not collection.plans:
        return None
    groups = [
        _planned(f"plan-{place + 1}-{name}", name, item.content, stage)
        for place, item in enumerate(collection.plans)
        for name, stage in item.content.stages.items()
    ]
    lead = (
        "Moves to record, and the standard errors that parameters will have after them."
    )
    return views.Section("plan", "What to record next", lead, groups)


def _planned(key: str, name: str, file: PlanFile, stage: PlannedStage) -> views.Group:
    facts = [("moves", f"{number(stage.duration_s)} s")]
    if stage.rank is not None and stage.structural_rank is not None:
        facts.append(("rank", f"{stage.rank} of {stage.structural_rank}"))
    if stage.condition is not None:
        facts.append(("condition", number(stage.condition)))
    told, moves = stage.separation, [move for move in file.moves if move.stage == name]
    if told is not None:
        facts.append(("to tell apart", " and ".join(told.between)))
        facts += [
            ("power", percent(told.power)),
            ("imitated at most", percent(told.imitated)),
        ]
    errors = views.Table(
        "Standard errors that it will give", tables.planned_errors(stage)
    )
    return views.Group(
        key,
        name,
        facts=facts,
        figures=[drawn for move in moves for drawn in move_figures(move, file)],
        tables=[views.Table("Moves", tables.moves(moves)), errors],
        notes=stage.notes,
    )


def move_figures(move: PlannedMove, file: PlanFile) -> list[views.Figure]:
    """Draw a move against its limits; every joint is a line that names itself when pointed at."""
    names, limits = list(file.limits), list(file.limits.values())
    t, q, dq, _ = sampled(move, names, _POINTS / move.duration_s)
    low, high = np.array([limit.position for limit in limits]).T
    speed = [limit.speed or 1.0 for limit in limits]
    shown = [
        (
            "position in its range",
            0.0,
            t,
            (q - low) / np.where(high > low, high - low, 1.0),
            names,
        ),
        ("speed over its limit", -1.0, t, dq / speed, names),
    ]
    known = [name for name in names if name in move.torque and file.limits[name].torque]
    if known:
        torque = np.array(
            [np.divide(move.torque[n], file.limits[n].torque or 1.0) for n in known]
        )
        times = (np.arange(torque.shape[1]) + 0.5) * move.duration_s / torque.shape[1]
        shown.append(("torque over its limit", 0.0, times, torque.T, known))
    text = f"{len(move.joints)} joints move for {move.duration_s:.3g} s."
    legend, figures = {"predicted": "each joint"}, []
    for what, least, x, values, joints in shown:
        room = 0.08 * (1.0 - least)
        y_range, title = (least - room, 1.0 + room), f"{move.name}: {what}"
        panel = small_panel(
            ("t", "s"), (0.0, float(x[-1])), what, y_range, height=110.0
        )
        for name, column in zip(joints, values.T, strict=True):
            panel.line(x, column, "predicted", name=name)
        figures.append(figure([panel], title, text, legend, None))
    return figures
