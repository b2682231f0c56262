"""Effects that the model lacks: findings with evidence, unexplained parts, events."""

from __future__ import annotations

from collections.abc import Sequence

from seqid_cli.params.results import tables
from seqid_cli.params.results.diagnosis import (
    FindingEntry,
    UnexplainedPart,
)
from seqid_cli.params.results.diagnosis_words import beyond_noise
from seqid_cli.report.collection import Collection, Diagnosed
from seqid_cli.report.figures.diagnosis import against_floor, timeline
from seqid_cli.report.figures.evidence import evidence_figure, rivals_table
from seqid_cli.report.judgement import known_effects
from seqid_cli.report.sections.parameters import value_rows
from seqid_cli.report.views import (
    VALUE_COLUMNS,
    Absent,
    Group,
    Section,
    Table,
    table_of,
)
from seqid_cli.report.words import (
    command,
    effect_at,
    effect_words,
    listed,
    percent,
    plural,
    short_path,
)

_MOST_EVENTS = 200
_VERDICTS = {
    "nothing_missing": ("good", "nothing is missing"),
    "effect_found": ("open", "the model lacks an effect"),
    "unexplained": ("open", "a part fits no known effect"),
}


def diagnosis(collection: Collection) -> Section:
    """Return the section on effects that the model lacks."""
    title = "Diagnosis: what the model lacks"
    if not collection.diagnoses:
        model = collection.model
        path = model.path if model else "inertia.json"
        start = ["seqid", "diagnose", "LOG...", "-r", "robot.toml", "-p"]
        call = command(*start, path, "-o", "diagnosis.json")
        text = "No diagnosis is among the files given."
        return Section("diagnosis", title, absent=[Absent(text, call)])
    lead = (
        "Each diagnosis takes what the model leaves of the torque and asks which physical effect "
        "predicts it on held-out data. Confidence is a probability; the share explained is of the "
        "residual's variance above the noise floor."
    )
    groups = [
        group
        for place, item in enumerate(collection.diagnoses)
        for group in (_group(place, item, collection), *_findings(place, item, collection))
    ]
    return Section("diagnosis", title, lead, groups)


def _group(place: int, item: Diagnosed, collection: Collection) -> Group:
    file = item.file
    badge, text = _VERDICTS[file.verdict]
    if file.verdict == "nothing_missing" and any(map(beyond_noise, file.joints.values())):
        badge, text = "open", "no effect was found, but more than noise is left"
    known = known_effects(collection)
    if file.findings and all((f.effect, f.joint) in known for f in file.findings):
        badge, text = "good", "found, and in the refined model"
    figures = [
        figure
        for part in file.unexplained
        if part.evidence
        and (figure := evidence_figure(part.evidence, collection, "Unexplained torque"))
    ]
    floor = against_floor(file, collection)
    pushed = timeline(file.events)
    left_out = len(file.events) - _MOST_EVENTS
    more = f"and {left_out} more" if left_out > 0 else ""
    units = {name: collection.units(name)[0] for name in collection.robot.joints}
    return Group(
        f"diagnosis-{place + 1}",
        short_path(item.path),
        lead=f"{plural(len(file.inputs), 'log')}: "
        + listed([short_path(log.path) for log in file.inputs]),
        badge=badge,
        badge_text=text,
        figures=[*figures, *([floor] if floor else []), *([pushed] if pushed else [])],
        tables=[
            table_of("Residual per joint", tables.joint_residuals(file.joints, units)),
            *(
                rivals_table(f"Tried for what is unexplained at {part.joint}", part.rivals)
                for part in file.unexplained
            ),
            *(rivals_table(f"Tried at {name}", at.tried) for name, at in file.joints.items()),
            table_of("Events", tables.events(file.events[:_MOST_EVENTS]), more),
            table_of("Effects that these motions cannot show", tables.hidden(file.hidden)),
        ],
        notes=[*_unexplained(file.unexplained), *file.notes],
    )


def _findings(place: int, item: Diagnosed, collection: Collection) -> list[Group]:
    known = known_effects(collection)
    return [
        _finding(f"finding-{place + 1}-{k + 1}", one, (one.effect, one.joint) in known, collection)
        for k, one in enumerate(item.file.findings)
    ]


def _finding(key: str, item: FindingEntry, known: bool, collection: Collection) -> Group:
    title = effect_at(item.effect, item.joint or "the whole arm")
    figure = evidence_figure(item.evidence, collection) if item.evidence else None
    rows = value_rows(item)
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
        _about(item.effect),
        joint=item.joint or "",
        badge="good" if known else "open",
        badge_text="in the refined model" if known else "not in the model",
        facts=[
            ("confidence", percent(item.confidence, 0)),
            ("explains", percent(item.explains, 0)),
        ],
        figures=[figure] if figure else [],
        tables=[
            Table(f"Parameters of {title}", VALUE_COLUMNS, rows),
            rivals_table("Tried in its place", item.rivals),
        ],
        notes=[*notes, *([item.note] if item.note else [])],
        unfolded=True,
    )


def _about(effect: str) -> str:
    from seqid_cli.model.effects.registry import CATALOGUE

    known = CATALOGUE.get(effect)
    return (known.__doc__ or "").strip().partition("\n")[0] if known else ""


def _unexplained(parts: Sequence[UnexplainedPart]) -> list[str]:
    return [
        f"{part.joint}: {percent(part.share, 0)} of the residual above the noise floor depends on "
        f"{listed([name.replace('_', ' ') for name in part.depends_on]) or 'nothing logged'}."
        for part in parts
    ]
