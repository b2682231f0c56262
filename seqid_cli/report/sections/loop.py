"""The closed loop: the error before and after refinement, on held-out logs."""

from seqid_cli.params.results import tables
from seqid_cli.params.results.diagnosis import nothing_added
from seqid_cli.params.schema import ClosedLoop
from seqid_cli.report.collection import Collection
from seqid_cli.report.figures.chart import RowChart
from seqid_cli.report.figures.evidence import evidence_figure, rivals_table
from seqid_cli.report.judgement import unconfirmed
from seqid_cli.report.views import Absent, Figure, Group, Key, Section, table_of
from seqid_cli.report.words import effect_at, listed, number, short_path


def closed_loop(collection: Collection) -> Section:
    """Return the section on refinement."""
    title = "Before and after refinement"
    loop = next((x.file.closed_loop for x in collection.models if x.file.closed_loop), None)
    if loop is None:
        call = collection.call("refine", "LOG...", "--holdout", "LOG", output="refined.json")
        absent = Absent("No refined file is among the files given.", call)
        return Section("loop", title, absent=[absent])
    lead = (
        "Effects were chosen on blocks of time that were left out of the logs to fit. The held-out "
        "logs were opened after the last decision: both errors are measured there, where joints "
        "slide, on the same samples. The noise floor estimates what torque noise and encoder alone "
        "leave. The gain is the part of the error's variance that the refined model takes away, "
        "with its 95 % interval."
    )
    added = [(effect_at(item.effect, item.joint), item) for item in loop.rounds]
    shown = [evidence_figure(x.evidence, collection, f"{name}: residual") for name, x in added]
    poor = [v for v in loop.verdicts if not v.good]
    faults = [": ".join(filter(None, (v.joint, v.reason))) for v in poor]
    measured = listed([short_path(path) for path in loop.evaluated_on])
    group = Group(
        "loop-errors",
        f"Added: {listed([name for name, _ in added])}" if added else nothing_added(loop),
        lead="; ".join([*unconfirmed(loop), *faults]),
        badge="poor" if loop.verdict == "poor" else "",
        figures=[_figure(collection, loop), *shown],
        tables=[
            table_of("RMS error on the held-out logs", tables.loop_errors(loop, collection.robot)),
            table_of("What was tried", tables.rounds(loop)),
            *(rivals_table(f"Tried in place of {name}", x.rivals) for name, x in added),
        ],
        notes=[*([f"Measured on {measured}."] if measured else []), *loop.notes],
        unfolded=True,
    )
    return Section("loop", title, lead, [group])


def _figure(collection: Collection, loop: ClosedLoop) -> Figure | None:
    names = [name for name in collection.robot.joints if name in loop.before]
    if not names or not all(loop.noise_floor.get(name, 0.0) > 0.0 for name in names):
        return None
    errors = (("before", loop.before), ("after", loop.after))
    scaled = {
        name: {s: own[name].rmse / loop.noise_floor[name] for s, own in errors if name in own}
        for name in names
    }
    far = max(max(values.values()) for values in scaled.values())
    chart = RowChart(names, max(far, 1.2), "RMS error as a multiple of the noise floor")
    chart.mark(1.0, "floor")
    for row, name in enumerate(names):
        chart.dots(row, scaled[name])
    text = "; ".join(
        f"{name}: {number(x['before'])} before, {number(x.get('after', x['before']))} after"
        for name, x in scaled.items()
    )
    legend = [Key("before", "before"), Key("after", "after"), Key("floor", "noise floor")]
    title, text = "Error before and after refinement", f"{text}, in multiples of the noise floor."
    return chart.figure(title, text, legend, name="RMS error on held-out logs")
