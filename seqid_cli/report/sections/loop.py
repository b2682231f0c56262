"""The closed loop: the error before and after refinement, on held-out logs."""

from __future__ import annotations

from seqid_cli.params.results import tables
from seqid_cli.params.schema import ClosedLoop, RefinementRound
from seqid_cli.report.collection import Collection
from seqid_cli.report.figures.evidence import evidence_figure, rivals_table
from seqid_cli.report.figures.row_chart import RowChart
from seqid_cli.report.views import (
    Absent,
    Figure,
    Group,
    Key,
    Section,
    table_of,
)
from seqid_cli.report.words import (
    command,
    effect_at,
    listed,
    number,
    short_path,
)


def closed_loop(collection: Collection) -> Section:
    """Return the section on refinement."""
    title = "Before and after refinement"
    loops = [model for model in collection.models if model.file.closed_loop is not None]
    if not loops:
        model = collection.model
        path = model.path if model else "inertia.json"
        start = ["seqid", "refine", "LOG...", "--holdout", "LOG", "-r", "robot.toml", "-p"]
        call = command(*start, path, "-o", "refined.json")
        text = "No refined file is among the files given."
        return Section("loop", title, absent=[Absent(text, call)])
    model = loops[0]
    loop = model.file.closed_loop
    assert loop is not None
    lead = (
        "Effects were chosen on blocks of time that were left out of the logs to fit. The held-out "
        "logs were opened after the last decision: both errors are measured there, where joints "
        "slide, on the same samples. The noise floor estimates what torque noise and encoder alone "
        "leave. The gain is the part of the error's variance that the refined model takes away, "
        "with its 95 % interval."
    )
    figure, added = _figure(collection, loop), [(_title(item), item) for item in loop.rounds]
    units = {name: collection.units(name)[0] for name in collection.robot.joints}
    made = [
        table_of("RMS error on the held-out logs", tables.loop_errors(loop, units)),
        table_of("What was tried", tables.rounds(loop)),
    ]
    made += [rivals_table(f"Tried in place of {title}", item.rivals) for title, item in added]
    group = Group(
        "loop-errors",
        _headline(loop),
        badge="poor" if loop.verdict == "poor" else "",
        figures=[*([figure] if figure else []), *_shown(collection, loop)],
        tables=made,
        notes=[*_where(loop), *loop.notes],
        unfolded=True,
    )
    return Section("loop", title, lead, [group])


def _title(item: RefinementRound) -> str:
    return effect_at(item.effect, item.joint)


def _shown(collection: Collection, loop: ClosedLoop) -> list[Figure]:
    """Evidence of each added effect, on the logs that were fitted."""
    figures = [
        evidence_figure(item.evidence, collection, f"{_title(item)}: residual")
        for item in loop.rounds
        if item.evidence
    ]
    return [figure for figure in figures if figure]


def _headline(loop: ClosedLoop) -> str:
    if not loop.rounds:
        if loop.refused:
            return "Nothing was added: no effect predicts left-out blocks better"
        return "Nothing was added: nothing was found"
    said = f"Added: {listed([effect_at(item.effect, item.joint) for item in loop.rounds])}"
    return said if loop.verdict == "good" else f"{said}; not confirmed by the held-out logs"


def _where(loop: ClosedLoop) -> list[str]:
    if not loop.evaluated_on:
        return []
    return [f"Measured on {listed([short_path(path) for path in loop.evaluated_on])}."]


def _figure(collection: Collection, loop: ClosedLoop) -> Figure | None:
    names = [name for name in collection.robot.joints if name in loop.before]
    relative = bool(names) and all(loop.noise_floor.get(name, 0.0) > 0.0 for name in names)
    if not names or not relative:
        return None
    scaled = {name: [rmse / loop.noise_floor[name] for rmse in _both(loop, name)] for name in names}
    far = max(max(values) for values in scaled.values())
    chart = RowChart(names, max(far, 1.2), "RMS error as a multiple of the noise floor")
    chart.mark(1.0, "floor")
    for row, name in enumerate(names):
        values = scaled[name]
        chart.link(row, values[0], values[-1], "dumbbell")
        chart.dot(row, values[0], "before")
        if len(values) > 1:
            chart.dot(row, values[1], "after")
    title = "Error before and after refinement"
    text = "; ".join(
        f"{name}: {number(values[0])} before, {number(values[-1])} after"
        for name, values in scaled.items()
    )
    svg = chart.render(title, f"{text}, in multiples of the noise floor.")
    legend = [Key("before", "before"), Key("after", "after"), Key("floor", "noise floor")]
    return Figure("RMS error on held-out logs", svg, legend, wide=True)


def _both(loop: ClosedLoop, name: str) -> list[float]:
    return [errors[name].rmse for errors in (loop.before, loop.after) if name in errors]
