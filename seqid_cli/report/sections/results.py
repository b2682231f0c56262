"""What the flange carries, and what to record next."""

import numpy as np

from seqid_cli.params.results import tables
from seqid_cli.params.results.payload import PayloadFile
from seqid_cli.params.results.plan import PlanFile, PlannedMove, PlannedStage
from seqid_cli.plan.moves.trajectories import sampled
from seqid_cli.report.collection import Collection
from seqid_cli.report.figures.chart import Box, Panel, drawing
from seqid_cli.report.figures.svg import line
from seqid_cli.report.views import (
    VALUE_HEADS,
    Figure,
    Group,
    Key,
    Section,
    Table,
    badge,
    reasons,
    table,
    table_of,
    value_row,
)
from seqid_cli.report.words import number, percent

_LEFT, _WIDTH, _HEIGHT, _GAP = 40.0, 190.0, 110.0, 50.0
_POINTS = 80


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
    body = [value_row(n, x.value, x.std_error, x.unit) for n, x in file.payload.numbers()]
    return Group(
        f"payload-{place + 1}",
        f"Payload, frame {file.payload.frame}",
        lead=reasons(file.verdicts),
        badge=badge(file.verdicts),
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


def move_figure(move: PlannedMove, file: PlanFile) -> Figure:
    """Draw a move; every joint is a line that names itself when it is pointed at."""
    names, limits = list(file.limits), file.limits
    t, q, dq, _ = sampled(move, names, _POINTS / move.duration_s)
    low, high = np.array([limits[name].position for name in names]).T
    width = np.where(high > low, high - low, 1.0)
    speed = np.array([limits[name].speed or 1.0 for name in names])
    shown = [
        ("position in its range", 0.0, t, (q - low) / width, names),
        ("speed over its limit", -1.0, t, dq / speed, names),
    ]
    known = [name for name in names if name in move.torque and limits[name].torque]
    if known:
        torque = np.array([move.torque[n] for n in known]).T
        torque /= np.array([limits[n].torque or 1.0 for n in known])
        times = (np.arange(len(torque)) + 0.5) * move.duration_s / len(torque)
        shown.append(("torque over its limit", 0.0, times, torque, known))
    panels = []
    for place, (title, least, x, values, joints) in enumerate(shown):
        room = 0.08 * (1.0 - least)
        box = Box(_LEFT + place * (_WIDTH + _GAP), 26, _WIDTH, _HEIGHT)
        y_range = (least - room, 1.0 + room)
        panel = Panel(
            box, (0.0, float(x[-1])), y_range, "time, s", title, x_ticks=4, y_ticks=3, hover="t|s"
        )
        for at in [panel.y(limit) for limit in (least, 1.0) if limit]:
            panel.add(line("rule line-mark", box.left, at, box.right, at))
        for name, column in zip(joints, values.T, strict=True):
            panel.line(x, column, "predicted", name=name)
        panels.append(panel)
    text = f"{len(move.joints)} joints move for {move.duration_s:.3g} s within dashed limits"
    total = _LEFT + len(panels) * (_WIDTH + _GAP)
    svg = drawing(total, _HEIGHT + 76, move.name, text, panels)
    return Figure(move.name, svg, [Key("predicted", "each joint"), Key("line-mark", "limit")])
