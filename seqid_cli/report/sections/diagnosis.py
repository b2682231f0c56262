"""Effects that the model lacks: findings with evidence, unexplained parts, events."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from seqid_cli.params.results.diagnosis import (
    DiagnosisFile,
    EventEntry,
    FindingEntry,
    UnexplainedPart,
)
from seqid_cli.params.results.diagnosis_words import beyond_noise
from seqid_cli.report.collection import Collection, Diagnosed
from seqid_cli.report.figures.diagnosis import against_floor, timeline
from seqid_cli.report.figures.evidence import evidence_figure, rivals_table
from seqid_cli.report.judgement import known_effects
from seqid_cli.report.sections.parameters import value_rows
from seqid_cli.report.views import VALUE_COLUMNS, Absent, Column, Figure, Group, Section, Table
from seqid_cli.report.words import (
    command,
    effect_at,
    effect_words,
    limits,
    listed,
    number,
    percent,
    plural,
    short_path,
    unit_text,
)

_MOST_EVENTS = 200
_VERDICTS = {
    "nothing_missing": ("good", "nothing is missing"),
    "effect_found": ("open", "the model lacks an effect"),
    "unexplained": ("open", "a part fits no known effect"),
}


@dataclass(frozen=True)
class FindingView:
    """One finding as a card."""

    title: str
    about: str
    confidence: float
    confidence_text: str
    explains: float
    explains_text: str
    parameters: Table | None
    confusable: str
    separate: str
    note: str
    known: bool
    figure: Figure | None
    rivals: Table


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
    groups = [_group(place, item, collection) for place, item in enumerate(collection.diagnoses)]
    cards = {
        group.id: [_finding(finding, collection) for finding in item.file.findings]
        for group, item in zip(groups, collection.diagnoses, strict=True)
    }
    return Section(
        "diagnosis", title, lead, groups, template="findings.html.j2", data={"cards": cards}
    )


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
    return Group(
        f"diagnosis-{place + 1}",
        short_path(item.path),
        lead=f"{plural(len(file.inputs), 'log')}: "
        + listed([short_path(log.path) for log in file.inputs]),
        badge=badge,
        badge_text=text,
        figures=[*figures, *([floor] if floor else []), *([pushed] if pushed else [])],
        tables=[
            _joints(file, collection),
            *(rivals_table(_not_known(part), part.rivals) for part in file.unexplained),
            *(rivals_table(f"Tried at {name}", at.tried) for name, at in file.joints.items()),
            _events(file.events),
            _hidden(file),
        ],
        notes=[*_unexplained(file.unexplained), *file.notes],
    )


def _finding(item: FindingEntry, collection: Collection) -> FindingView:
    known = (item.effect, item.joint) in known_effects(collection)
    return FindingView(
        title=effect_at(item.effect, item.joint or "the whole arm"),
        about=_about(item.effect),
        confidence=min(max(item.confidence, 0.0), 1.0),
        confidence_text=percent(item.confidence, 0),
        explains=min(max(item.explains, 0.0), 1.0),
        explains_text=percent(item.explains, 0),
        parameters=_parameters(item),
        confusable=listed([effect_words(name) for name in item.confusable_with], 12),
        separate=item.separate_by,
        note=item.note,
        known=known,
        figure=evidence_figure(item.evidence, collection) if item.evidence else None,
        rivals=rivals_table("Tried in its place", item.rivals),
    )


def _not_known(part: UnexplainedPart) -> str:
    return f"Tried in place of what is unexplained at {part.joint}"


def _about(effect: str) -> str:
    from seqid_cli.model.effects.registry import CATALOGUE

    known = CATALOGUE.get(effect)
    return (known.__doc__ or "").strip().partition("\n")[0] if known else ""


def _parameters(item: FindingEntry) -> Table | None:
    rows = value_rows(item)
    if not rows:
        return None
    return Table(f"Parameters of {effect_at(item.effect, item.joint)}", VALUE_COLUMNS, rows)


def _unexplained(parts: Sequence[UnexplainedPart]) -> list[str]:
    return [
        f"{part.joint}: {percent(part.share, 0)} of the residual above the noise floor depends on "
        f"{listed([name.replace('_', ' ') for name in part.depends_on]) or 'nothing logged'}."
        for part in parts
    ]


def _joints(file: DiagnosisFile, collection: Collection) -> Table:
    columns = (
        Column("joint"),
        Column("RMS residual", numeric=True),
        Column("noise floor", numeric=True),
        Column("95 % interval", numeric=True),
        Column("with findings", numeric=True),
        Column("unit"),
        Column("only noise left"),
        Column("samples", numeric=True),
    )
    rows = [
        (
            name,
            number(entry.rmse),
            number(entry.noise_floor),
            limits(entry.noise_floor_interval),
            number(entry.rmse_explained) if file.findings else number(None),
            unit_text(collection.units(name)[0]),
            "yes" if entry.white else "no",
            str(entry.samples),
        )
        for name, entry in file.joints.items()
    ]
    return Table("Residual per joint", columns, rows)


def _events(events: Sequence[EventEntry]) -> Table:
    columns = (
        Column("log"),
        Column("from", numeric=True, unit="s"),
        Column("to", numeric=True, unit="s"),
        Column("joints"),
    )
    rows = [
        (short_path(event.log), f"{event.start:.2f}", f"{event.end:.2f}", ", ".join(event.joints))
        for event in events[:_MOST_EVENTS]
    ]
    more = len(events) - len(rows)
    return Table("Events", columns, rows, f"and {more} more" if more else "")


def _hidden(file: DiagnosisFile) -> Table:
    columns = (Column("effect"), Column("joint"), Column("visible", numeric=True))
    rows = [
        (effect_words(item.effect), item.joint or "whole arm", percent(item.visible))
        for item in file.hidden
    ]
    note = "Nothing is known of them either way."
    return Table("Effects that these motions cannot show", columns, rows, note if rows else "")
