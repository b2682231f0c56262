"""What the flange carries, and what to record next."""

import numpy as np

from seqid_cli.motion.planned import sampled
from seqid_cli.params.results import tables
from seqid_cli.params.results.payload import PayloadFile
from seqid_cli.params.results.plan import PlanFile, PlannedMove, PlannedStage
from seqid_cli.params.results.tables import Values
from seqid_cli.report import views
from seqid_cli.report.chart import figure, small_panel
from seqid_cli.report.collection import Collection
from seqid_cli.report.words import number, percent
from seqid_cli.typing import Array

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
    groups = [
        _payload_group(f"payload-{place}", source.content)
        for place, source in enumerate(collection.payloads, start=1)
    ]
    return views.Section(id="payload", title="Payload", lead=lead, groups=groups)


def _payload_group(key: str, file: PayloadFile) -> views.Group:
    """Return the group on one payload."""
    body = [
        views.value_row(name, estimate.value, estimate.std_error, estimate.unit)
        for name, estimate in file.payload.numbers()
    ]
    settings = tables.values("for | setting", "text text", file.settings.items())

    # One body is all that its group is about: its tables stand open.
    return views.Group(
        id=key,
        title=f"Payload, frame {file.payload.frame}",
        lead=views.reasons(file.verdicts),
        badge=views.badge(file.verdicts),
        tables=[
            views.Table(caption="The body", values=Values(views.VALUE_HEADS, body)),
            views.Table(caption="As controllers take it", values=settings),
            views.Table(
                caption="Torque error where joints slide",
                values=tables.payload_joints(file),
            ),
        ],
        notes=file.notes,
        unfolded=True,
    )


def plan(collection: Collection) -> views.Section | None:
    """Return the section on plans; None where none is given."""
    if not collection.plans:
        return None
    groups = []
    for place, source in enumerate(collection.plans, start=1):
        for name, stage in source.content.stages.items():
            key = f"plan-{place}-{name}"
            groups.append(_plan_group(key, name, source.content, stage))
    lead = (
        "Moves to record, and the standard errors that parameters will have after them."
    )
    return views.Section(
        id="plan", title="What to record next", lead=lead, groups=groups
    )


def _plan_group(
    key: str, name: str, file: PlanFile, stage: PlannedStage
) -> views.Group:
    """Return the group on one planned stage."""
    moves = [move for move in file.moves if move.stage == name]
    figures = []
    for move in moves:
        figures += move_figures(move, file)
    return views.Group(
        id=key,
        title=name,
        facts=_plan_facts(stage),
        figures=figures,
        tables=[
            views.Table(caption="Moves", values=tables.moves(moves)),
            views.Table(
                caption="Standard errors that it will give",
                values=tables.planned_errors(stage),
            ),
        ],
        notes=stage.notes,
    )


def _plan_facts(stage: PlannedStage) -> list[tuple[str, str]]:
    """Return how long a planned stage takes, and how much it determines."""
    facts = [("moves", f"{number(stage.duration_s)} s")]
    if stage.rank is not None and stage.structural_rank is not None:
        facts.append(("rank", f"{stage.rank} of {stage.structural_rank}"))
    if stage.condition is not None:
        facts.append(("condition", number(stage.condition)))
    separation = stage.separation
    if separation is not None:
        facts += [
            ("to tell apart", " and ".join(separation.between)),
            ("power", percent(separation.power)),
            ("imitated at most", percent(separation.imitated)),
        ]
    return facts


def move_figures(move: PlannedMove, file: PlanFile) -> list[views.Figure]:
    """Draw a move against its limits.

    Every joint is a line that names itself when pointed at.
    """
    names = list(file.limits)
    limits = list(file.limits.values())
    t, q, dq, _ = sampled(move, names, _POINTS / move.duration_s)
    low, high = np.array([limit.position for limit in limits]).T
    width = np.where(high > low, high - low, 1.0)
    speed_limits = [limit.speed or 1.0 for limit in limits]

    figures = [
        _limit_figure(move, "position in its range", t, (q - low) / width, names),
        _limit_figure(
            move, "speed over its limit", t, dq / speed_limits, names, least=-1.0
        ),
    ]
    with_torque = [
        name for name in names if name in move.torque and file.limits[name].torque
    ]
    if with_torque:
        loads = np.array(
            [
                np.divide(move.torque[name], file.limits[name].torque or 1.0)
                for name in with_torque
            ]
        )
        # Torques are the largest of equal parts of the time.
        n_parts = loads.shape[1]
        times = (np.arange(n_parts) + 0.5) * move.duration_s / n_parts
        figures.append(
            _limit_figure(move, "torque over its limit", times, loads.T, with_torque)
        )
    return figures


def _limit_figure(
    move: PlannedMove,
    quantity: str,
    t: Array,
    shares: Array,
    joints: list[str],
    *,
    least: float = 0.0,
) -> views.Figure:
    """Draw shares (N, n) of limits over times (N,) s, from the `least` to one."""
    room = 0.08 * (1.0 - least)
    panel = small_panel(
        ("t", "s"),
        (0.0, float(t[-1])),
        quantity,
        (least - room, 1.0 + room),
        height=110.0,
    )
    for name, column in zip(joints, shares.T, strict=True):
        panel.line(t, column, "predicted", name=name)
    text = f"{len(move.joints)} joints move for {move.duration_s:.3g} s."
    legend = {"predicted": "each joint"}
    return figure([panel], f"{move.name}: {quantity}", text, legend, None)
