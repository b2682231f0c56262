"""Effects that the model lacks, with their evidence, and the error before and after refinement."""

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from seqid_cli.model.effects.registry import CATALOGUE
from seqid_cli.params.evidence_schema import EvidenceEntry, RivalEntry
from seqid_cli.params.io import Source
from seqid_cli.params.results import tables
from seqid_cli.params.results.diagnosis import (
    DiagnosisFile,
    FindingEntry,
    nothing_added,
    over_words,
    values_at,
)
from seqid_cli.params.results.tables import Values
from seqid_cli.report import words
from seqid_cli.report.chart import dots, figure, padded, small_panel
from seqid_cli.report.collection import Collection
from seqid_cli.report.judgement import known_effects, not_kept, unconfirmed, unexplained
from seqid_cli.report.sections.parameters import value_rows
from seqid_cli.report.views import (
    VALUE_HEADS,
    Figure,
    Group,
    Section,
    Table,
    lacking,
    table,
)

_MOST_EVENTS = 200
_VERDICTS = {
    "nothing_missing": ("good", "nothing is missing"),
    "effect_found": ("open", "the model lacks an effect"),
    "unexplained": ("open", "a part fits no known effect"),
    "values_changed": ("open", "the file's values do not hold"),
    "too_short": ("open", "the logs are too short to tell"),
    "nothing_seen": ("poor", "no sample could be looked at"),
}


def diagnosis(collection: Collection) -> Section:
    """Return the section on effects that the model lacks."""
    title = "Diagnosis: what the model lacks"
    if not collection.diagnoses:
        call = collection.call("diagnose", output="diagnosis.json")
        return lacking(
            "diagnosis", title, "No diagnosis is among the files given.", call
        )
    lead = (
        "Each diagnosis takes what the model leaves of the torque and asks which"
        " physical effect predicts it on held-out data. Confidence is a probability;"
        " the share explained is of the residual's variance above the noise floor."
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
    tried = {
        f"what is unexplained at {part.joint}": part.rivals for part in file.unexplained
    }
    tried |= {name: joint.tried for name, joint in file.joints.items()}
    floors = {name: joint.noise_floor or 0.0 for name, joint in file.joints.items()}
    errors = {"before": {name: joint.rmse for name, joint in file.joints.items()}}
    if file.findings:
        errors["after"] = {
            name: joint.rmse_explained for name, joint in file.joints.items()
        }
    more = f"and {left_out} more" if left_out > 0 else ""
    shown = [
        evidence_figure(x.evidence, collection, "Unexplained torque")
        for x in file.unexplained
    ]
    logs = words.listed([words.short_path(log.path) for log in file.inputs])
    return Group(
        key,
        words.short_path(item.path),
        lead=f"{words.plural(len(file.inputs), 'log')}: {logs}",
        badge=badge,
        badge_text=text,
        figures=[
            *shown,
            _over_floor("Residual without and with the findings", errors, floors),
        ],
        tables=[
            Table(
                "Residual per joint",
                tables.joint_residuals(file.joints, collection.robot),
            ),
            Table(
                "Joints at which the file's values do not hold",
                tables.changed_values(file.changed, collection.robot),
            ),
            *(_tried(f"for {what}", terms) for what, terms in tried.items()),
            Table("Events", tables.events(file.events[:_MOST_EVENTS]), more),
            Table("Effects that these motions cannot show", tables.hidden(file.hidden)),
        ],
        notes=[
            *(f"{unexplained(part)}." for part in file.unexplained),
            *(values_at(one) for one in file.changed),
            *file.notes,
        ],
    )


def _finding(key: str, item: FindingEntry, collection: Collection) -> Group:
    title = words.effect_at(item.effect, item.joint or "the whole arm")
    about = CATALOGUE[item.effect].__doc__ or "" if item.effect in CATALOGUE else ""
    known, rows = (
        (item.effect, item.joint) in known_effects(collection),
        value_rows(item),
    )
    notes = [] if rows else ["These logs do not determine its parameters."]
    if item.confusable_with:
        others = words.listed(
            [words.effect_words(name) for name in item.confusable_with], 12
        )
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
            (x, words.percent(getattr(item, x), 0)) for x in ("confidence", "explains")
        ],
        figures=[evidence_figure(item.evidence, collection)],
        tables=[
            Table(f"Parameters of {title}", Values(VALUE_HEADS, rows)),
            _tried("in its place", item.rivals),
        ],
        notes=[*notes, *filter(None, [item.note])],
        unfolded=True,
    )


def closed_loop(collection: Collection) -> Section:
    """Return the section on refinement."""
    title = "Before and after refinement"
    loop = next(
        (x.file.closed_loop for x in collection.models if x.file.closed_loop), None
    )
    if loop is None:
        call = collection.call(
            "refine", "LOG...", "--holdout", "LOG", output="refined.json"
        )
        return lacking("loop", title, "No refined file is among the files given.", call)
    lead = (
        "Effects were chosen on blocks of time that were left out of the logs to fit."
        " The held-out logs were opened after the last decision; what they do not"
        " confirm is taken out. Both errors are measured there, where joints slide, on"
        " the same samples. The noise floor estimates what torque noise and encoder"
        " alone leave. The gain is the part of the error's variance that the refined"
        " model takes away, with its 95 % interval."
    )
    added = [(words.effect_at(item.effect, item.joint), item) for item in loop.rounds]
    shown = [
        evidence_figure(x.evidence, collection, f"{name}: residual")
        for name, x in added
    ]
    faults = [
        ": ".join(filter(None, (v.joint, v.reason)))
        for v in loop.verdicts
        if not v.good
    ]
    loops = {"before": loop.before, "after": loop.after}
    errors = {
        style: {x: own.rmse for x, own in joints.items()}
        for style, joints in loops.items()
    }
    measured = words.listed([words.short_path(path) for path in loop.evaluated_on])
    group = Group(
        "loop-errors",
        (
            f"Added: {words.listed([name for name, _ in added])}"
            if added
            else nothing_added(loop)
        ),
        lead="; ".join([*unconfirmed(loop), *not_kept(loop), *faults]),
        badge="poor" if loop.verdict == "poor" else "",
        figures=[
            _over_floor("RMS error on held-out logs", errors, loop.noise_floor),
            *shown,
        ],
        tables=[
            Table(
                "RMS error on the held-out logs",
                tables.loop_errors(loop, collection.robot),
            ),
            Table("What was tried", tables.rounds(loop)),
            *(_tried(f"in place of {name}", x.rivals) for name, x in added),
        ],
        notes=[*([f"Measured on {measured}."] if measured else []), *loop.notes],
        unfolded=True,
    )
    return Section("loop", title, lead, [group])


def _tried(what: str, terms: Sequence[RivalEntry]) -> Table:
    return Table(f"Tried {what}", tables.rivals(terms), folded=True)


def _over_floor(
    title: str,
    errors: Mapping[str, Mapping[str, float | None]],
    floors: Mapping[str, float],
) -> Figure | None:
    """Draw the errors of each joint (by style) as multiples of its noise floor."""
    rows = {
        name: [
            (style, x / floor) for style, own in errors.items() if (x := own.get(name))
        ]
        for name, floor in floors.items()
        if floor > 0.0
    }
    shown = {name: points for name, points in rows.items() if points}
    legend = {**{style: style for style in errors}, "floor": "noise floor"}
    return dots(title, shown, "RMS as a multiple of the noise floor", legend, mark=1.0)


def evidence_figure(
    shown: EvidenceEntry | None, collection: Collection, what: str = "Residual"
) -> Figure | None:
    """Draw a joint's residual over the effect's quantity, before and after it is taken off."""
    if shown is None or len(shown.x) < 2 or not min(shown.x) < max(shown.x):
        return None
    unit = collection.place(shown.joint).unit
    quantity, sided = over_words(shown), " times direction" if shown.sided else ""
    curves = {"before": ("residual", "faint", shown.before, shown.before_spread)}
    if shown.after:
        curves["after"] = ("predicted", "cut0", shown.after, shown.after_spread)
    edges = {
        name: (np.subtract(y, d), np.add(y, d)) for name, (*_, y, d) in curves.items()
    }
    ends = np.concatenate(
        [np.zeros(1), *(edge for both in edges.values() for edge in both)]
    )
    x_range, y_range = (min(shown.x), max(shown.x)), padded(ends)
    x, y_title = (quantity, words.unit_text(shown.unit)), f"residual{sided}, {unit}"
    panel = small_panel(x, x_range, y_title, y_range)
    for name, (_, band, *_) in curves.items():
        panel.band(shown.x, *edges[name], band)
    for name, (style, _, y, _) in curves.items():
        panel.line(shown.x, y, style, name=name, unit=unit)
    title = f"{what} of {shown.joint} over {quantity}"
    text = (
        "Means of bins, in bands of one standard deviation, on blocks left out of the"
        " fit."
    )
    legend = {style: f"{name} it is taken off" for name, (style, *_) in curves.items()}
    none = [None] * len(shown.x)
    after = (shown.after or none, shown.after_spread or none)
    rows = zip(
        shown.x, shown.count, shown.before, shown.before_spread, *after, strict=True
    )
    heads = (
        "{quantity} [{x}] | samples | before [{y}] | spread [{y}] | after [{y}] |"
        " spread [{y}]"
    )
    kinds, names = (
        "number count number number number number",
        {"x": shown.unit, "y": unit},
    )
    bins = table(title, heads, kinds, rows, quantity=quantity, **names)
    drawn = figure([panel], title, text, legend, bins, note=text)
    return replace(drawn, joint=shown.joint)
