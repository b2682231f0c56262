"""Effects that the model lacks: findings with evidence, unexplained parts, events."""

from collections.abc import Sequence

from seqid_cli.model.effects.registry import CATALOGUE
from seqid_cli.params.io import Source
from seqid_cli.params.results import tables
from seqid_cli.params.results.diagnosis import DiagnosisFile, EventEntry, FindingEntry
from seqid_cli.report.collection import Collection
from seqid_cli.report.figures.chart import RowChart
from seqid_cli.report.figures.evidence import evidence_figure, rivals_table
from seqid_cli.report.judgement import known_effects, unexplained
from seqid_cli.report.sections.parameters import value_rows
from seqid_cli.report.views import VALUE_HEADS, Absent, Figure, Group, Key, Section, Table, table_of
from seqid_cli.report.words import (
    effect_at,
    effect_words,
    file_name,
    listed,
    number,
    percent,
    plural,
    short_path,
)

_MOST_EVENTS = 200  # in a table, and in a row of the figure
_MOST_LOGS = 20
_VERDICTS = {
    "nothing_missing": ("good", "nothing is missing"),
    "effect_found": ("open", "the model lacks an effect"),
    "unexplained": ("open", "a part fits no known effect"),
}


def diagnosis(collection: Collection) -> Section:
    """Return the section on effects that the model lacks."""
    title = "Diagnosis: what the model lacks"
    if not collection.diagnoses:
        call = collection.call("diagnose", output="diagnosis.json")
        absent = Absent("No diagnosis is among the files given.", call)
        return Section("diagnosis", title, absent=[absent])
    lead = (
        "Each diagnosis takes what the model leaves of the torque and asks which physical effect "
        "predicts it on held-out data. Confidence is a probability; the share explained is of the "
        "residual's variance above the noise floor."
    )
    groups = []
    for place, item in enumerate(collection.diagnoses, start=1):
        groups.append(_group(f"diagnosis-{place}", item, collection))
        for k, finding in enumerate(item.content.findings, start=1):
            groups.append(_finding(f"finding-{place}-{k}", finding, collection))
    return Section("diagnosis", title, lead, groups)


def _group(key: str, item: Source[DiagnosisFile], collection: Collection) -> Group:
    file, known = item.content, known_effects(collection)
    badge, text = _VERDICTS[file.verdict]
    if file.verdict == "nothing_missing" and file.leaves_more:
        badge, text = "open", "no effect was found, but more than noise is left"
    if file.findings and all((f.effect, f.joint) in known for f in file.findings):
        badge, text = "good", "found, and in the refined model"
    left_out = len(file.events) - _MOST_EVENTS
    more = f"and {left_out} more" if left_out > 0 else ""
    return Group(
        key,
        short_path(item.path),
        lead=f"{plural(len(file.inputs), 'log')}: "
        + listed([short_path(log.path) for log in file.inputs]),
        badge=badge,
        badge_text=text,
        figures=[
            *(
                evidence_figure(x.evidence, collection, "Unexplained torque")
                for x in file.unexplained
            ),
            against_floor(file, collection),
            timeline(file.events),
        ],
        tables=[
            table_of("Residual per joint", tables.joint_residuals(file.joints, collection.robot)),
            *(
                rivals_table(f"Tried for what is unexplained at {part.joint}", part.rivals)
                for part in file.unexplained
            ),
            *(rivals_table(f"Tried at {name}", at.tried) for name, at in file.joints.items()),
            table_of("Events", tables.events(file.events[:_MOST_EVENTS]), more),
            table_of("Effects that these motions cannot show", tables.hidden(file.hidden)),
        ],
        notes=[*(f"{unexplained(part)}." for part in file.unexplained), *file.notes],
    )


def _finding(key: str, item: FindingEntry, collection: Collection) -> Group:
    title = effect_at(item.effect, item.joint or "the whole arm")
    about = CATALOGUE[item.effect].__doc__ or "" if item.effect in CATALOGUE else ""
    known, rows = (item.effect, item.joint) in known_effects(collection), value_rows(item)
    notes = [] if rows else ["These logs do not determine its parameters."]
    if item.confusable_with:
        others = listed([effect_words(name) for name in item.confusable_with], 12)
        notes.append(f"Could also be {others}.")
    if item.separate_by:
        aim = "To tell them apart" if item.confusable_with else "To make sure"
        notes.append(f"{aim}, record {item.separate_by}.")
    return Group(
        key,
        title,
        about.strip().partition("\n")[0],
        joint=item.joint or "",
        badge="good" if known else "open",
        badge_text="in the refined model" if known else "not in the model",
        facts=[
            ("confidence", percent(item.confidence, 0)),
            ("explains", percent(item.explains, 0)),
        ],
        figures=[evidence_figure(item.evidence, collection)],
        tables=[
            Table(f"Parameters of {title}", VALUE_HEADS, rows),
            rivals_table("Tried in its place", item.rivals),
        ],
        notes=[*notes, *([item.note] if item.note else [])],
        unfolded=True,
    )


def against_floor(file: DiagnosisFile, collection: Collection) -> Figure | None:
    """Draw each joint's residual as a multiple of its noise floor."""
    shown = {
        name: (entry.rmse / entry.noise_floor, (entry.rmse_explained or 0.0) / entry.noise_floor)
        for name in collection.robot.joints
        if (entry := file.joints.get(name)) is not None and entry.rmse and entry.noise_floor
    }
    if not shown:
        return None
    far = max(1.2, *(max(pair) for pair in shown.values()))
    chart = RowChart(list(shown), far, "RMS residual as a multiple of the noise floor")
    for row, (rmse, explained) in enumerate(shown.values()):
        chart.bar(row, 0.0, rmse, "bar")
        if file.findings and explained:
            chart.dots(row, [explained])
    chart.mark(1.0, "floor")
    text = "; ".join(f"{name}: {number(rmse)}" for name, (rmse, _) in shown.items())
    legend = [Key("bar", "residual"), Key("floor", "noise floor")]
    legend += [Key("after", "with the findings")] if file.findings else []
    return chart.figure("Residual against the noise floor", f"{text}, times the floor.", legend)


def timeline(events: Sequence[EventEntry]) -> Figure | None:
    """Draw the events over time, one row per log."""
    if not events:
        return None
    logs = list(dict.fromkeys(event.log for event in events))
    names = [file_name(log) for log in logs[:_MOST_LOGS]]
    chart = RowChart(names, max(event.end for event in events), "time since its log's start, s")
    for row, log in enumerate(logs[:_MOST_LOGS]):
        for event in [event for event in events if event.log == log][:_MOST_EVENTS]:
            tooltip = f"{event.start:.2f} to {event.end:.2f} s: {', '.join(event.joints)}"
            chart.bar(row, event.start, event.end, "span event", tooltip)
    text = f"{plural(len(events), 'event')} in {plural(len(logs), 'log')}; the table lists them."
    return chart.figure("Events: something pushed the arm", text, [Key("event", "pushed")])
