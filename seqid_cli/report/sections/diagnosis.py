"""Effects that the model lacks with their evidence; errors around a refinement."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from seqid_cli.effects.registry import CATALOGUE
from seqid_cli.params.evidence_schema import (
    EvidenceEntry,
    RefinementRound,
    RivalEntry,
)
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
from seqid_cli.params.schema import ClosedLoop
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
from seqid_cli.typing import Array

_MOST_EVENTS = 200
_VERDICTS = {
    "nothing_missing": ("good", "nothing is missing"),
    "effect_found": ("open", "the model lacks an effect"),
    "unexplained": ("open", "a part fits no known effect"),
    "values_changed": ("open", "the file's values do not hold"),
    "too_short": ("open", "the logs are too short to tell"),
    "nothing_seen": ("poor", "of some joint nothing could be seen"),
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
        groups.append(_diagnosis_group(f"diagnosis-{place}", item, collection))
        for number, finding in enumerate(item.content.findings, start=1):
            key = f"finding-{place}-{number}"
            groups.append(_finding_group(key, finding, collection))
    return Section(id="diagnosis", title=title, lead=lead, groups=groups)


def _diagnosis_group(
    key: str, item: Source[DiagnosisFile], collection: Collection
) -> Group:
    """Return the group on one diagnosis as a whole."""
    file = item.content
    robot = collection.robot
    badge, badge_text = _badge_of(file, collection)
    logs = words.listed([words.short_path(log.path) for log in file.inputs])

    figures = [
        evidence_figure(part.evidence, collection, "Unexplained torque")
        for part in file.unexplained
    ]
    floors = {name: joint.noise_floor or 0.0 for name, joint in file.joints.items()}
    errors = {"before": {name: joint.rmse for name, joint in file.joints.items()}}
    if file.findings:
        errors["after"] = {
            name: joint.rmse_explained for name, joint in file.joints.items()
        }
    figures.append(
        _over_floor("Residual without and with the findings", errors, floors)
    )

    # A joint's own attempts stand in place of those on its unexplained part.
    tried = {
        f"what is unexplained at {part.joint}": part.rivals for part in file.unexplained
    }
    tried |= {name: joint.tried for name, joint in file.joints.items()}
    n_left_out = len(file.events) - _MOST_EVENTS
    return Group(
        id=key,
        title=words.short_path(item.path),
        lead=f"{words.plural(len(file.inputs), 'log')}: {logs}",
        badge=badge,
        badge_text=badge_text,
        figures=figures,
        tables=[
            Table(
                caption="Residual per joint",
                values=tables.joint_residuals(file.joints, robot),
            ),
            Table(
                caption="Joints at which the file's values do not hold",
                values=tables.changed_values(file.changed, robot),
            ),
            *(_tried(f"for {subject}", rivals) for subject, rivals in tried.items()),
            Table(
                caption="Events",
                values=tables.events(file.events[:_MOST_EVENTS]),
                note=f"and {n_left_out} more" if n_left_out > 0 else "",
            ),
            Table(
                caption="Effects that these motions cannot show",
                values=tables.hidden(file.hidden),
            ),
        ],
        notes=[
            *(f"{unexplained(part)}." for part in file.unexplained),
            *(values_at(changed) for changed in file.changed),
            *file.notes,
        ],
    )


def _badge_of(file: DiagnosisFile, collection: Collection) -> tuple[str, str]:
    """Return the badge of a diagnosis, and its text."""
    effects_of_model = known_effects(collection)
    findings = [(finding.effect, finding.joint) for finding in file.findings]
    if findings and effects_of_model.issuperset(findings):
        return "good", "found, and in the refined model"
    if file.verdict == "nothing_missing" and file.leaves_more:
        return "open", "no effect was found, but more than noise is left"
    return _VERDICTS[file.verdict]


def _finding_group(key: str, finding: FindingEntry, collection: Collection) -> Group:
    """Return the group on one finding."""
    title = words.effect_at(finding.effect, finding.joint or "the whole arm")
    is_known = (finding.effect, finding.joint) in known_effects(collection)
    rows = value_rows(finding)

    # One finding is all that its group is about: its tables stand open.
    return Group(
        id=key,
        title=title,
        lead=_first_line_on(finding.effect),
        joint=finding.joint or "",
        badge="good" if is_known else "open",
        badge_text="in the refined model" if is_known else "not in the model",
        facts=[
            ("confidence", words.percent(finding.confidence, 0)),
            ("explains", words.percent(finding.explains, 0)),
        ],
        figures=[evidence_figure(finding.evidence, collection)],
        tables=[
            Table(caption=f"Parameters of {title}", values=Values(VALUE_HEADS, rows)),
            _tried("in its place", finding.rivals),
        ],
        notes=_notes_on(finding, is_determined=bool(rows)),
        unfolded=True,
    )


def _first_line_on(effect: str) -> str:
    """Return the first line that an effect of the catalogue says of itself."""
    if effect not in CATALOGUE:
        return ""
    text = CATALOGUE[effect].__doc__ or ""
    return text.strip().partition("\n")[0]


def _notes_on(finding: FindingEntry, *, is_determined: bool) -> list[str]:
    """Return what else the finding could be, and what to record to make sure."""
    notes = []
    if not is_determined:
        notes.append("These logs do not determine its parameters.")
    if finding.confusable_with:
        names = [words.effect_words(name) for name in finding.confusable_with]
        notes.append(f"Could also be {words.listed(names, 12)}.")
    if finding.separate_by:
        aim = "To tell them apart" if finding.confusable_with else "To make sure"
        notes.append(f"{aim}, record {finding.separate_by}.")
    if finding.note:
        notes.append(finding.note)
    return notes


def closed_loop(collection: Collection) -> Section:
    """Return the section on refinement."""
    title = "Before and after refinement"
    loops = [
        model.file.closed_loop for model in collection.models if model.file.closed_loop
    ]
    if not loops:
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
    group = _loop_group(loops[0], collection)
    return Section(id="loop", title=title, lead=lead, groups=[group])


def _loop_group(loop: ClosedLoop, collection: Collection) -> Group:
    """Return the group on one refinement."""
    names = [_name_of(item) for item in loop.rounds]
    errors = {
        "before": {name: joint.rmse for name, joint in loop.before.items()},
        "after": {name: joint.rmse for name, joint in loop.after.items()},
    }
    figures = [
        _over_floor("RMS error on held-out logs", errors, loop.noise_floor),
        *(
            evidence_figure(item.evidence, collection, f"{_name_of(item)}: residual")
            for item in loop.rounds
        ),
    ]

    faults = []
    for verdict in loop.verdicts:
        if not verdict.good:
            parts = [text for text in (verdict.joint, verdict.reason) if text]
            faults.append(": ".join(parts))

    measured_on = words.listed([words.short_path(path) for path in loop.evaluated_on])
    notes = list(loop.notes)
    if measured_on:
        notes.insert(0, f"Measured on {measured_on}.")
    return Group(
        id="loop-errors",
        title=f"Added: {words.listed(names)}" if names else nothing_added(loop),
        lead="; ".join([*unconfirmed(loop), *not_kept(loop), *faults]),
        badge="poor" if loop.verdict == "poor" else "",
        figures=figures,
        tables=[
            Table(
                caption="RMS error on the held-out logs",
                values=tables.loop_errors(loop, collection.robot),
            ),
            Table(caption="What was tried", values=tables.rounds(loop)),
            *(
                _tried(f"in place of {_name_of(item)}", item.rivals)
                for item in loop.rounds
            ),
        ],
        notes=notes,
        unfolded=True,
    )


def _name_of(item: RefinementRound) -> str:
    """Return the effect of a round with its place."""
    return words.effect_at(item.effect, item.joint)


def _tried(subject: str, rivals: Sequence[RivalEntry]) -> Table:
    """Return a table of what was tried for a subject."""
    return Table(caption=f"Tried {subject}", values=tables.rivals(rivals), folded=True)


def _over_floor(
    title: str,
    errors: Mapping[str, Mapping[str, float | None]],
    floors: Mapping[str, float],
) -> Figure | None:
    """Draw the errors of each joint (by style) as multiples of its noise floor."""
    rows = {}
    for name, floor in floors.items():
        if not floor > 0.0:
            continue
        points = []
        for style, error_of_joint in errors.items():
            error = error_of_joint.get(name)
            if error:
                points.append((style, error / floor))
        if points:
            rows[name] = points
    legend = {style: style for style in errors} | {"floor": "noise floor"}
    return dots(title, rows, "RMS as a multiple of the noise floor", legend, mark=1.0)


@dataclass(frozen=True, kw_only=True)
class _Curve:
    """Means of the residual in bins (K,), with their standard deviations."""

    name: str
    line_style: str
    band_style: str
    mean: Array
    spread: Array


def evidence_figure(
    evidence: EvidenceEntry | None, collection: Collection, subject: str = "Residual"
) -> Figure | None:
    """Draw a joint's residual over the effect's quantity, with and without the effect.

    Parameters
    ----------
    evidence : EvidenceEntry, optional
    collection : Collection
    subject : str
        What the title begins with.

    Returns
    -------
    Figure or None
        None where there is no evidence, or at one value of the quantity alone.
    """
    if evidence is None or len(evidence.x) < 2:
        return None
    least_x = min(evidence.x)
    largest_x = max(evidence.x)
    if not least_x < largest_x:
        return None

    curves = _curves_of(evidence)
    edges = [np.zeros(1)]
    for curve in curves:
        edges += [curve.mean - curve.spread, curve.mean + curve.spread]
    unit = collection.place(evidence.joint).unit
    quantity = over_words(evidence)
    sided = " times direction" if evidence.sided else ""
    panel = small_panel(
        (quantity, words.unit_text(evidence.unit)),
        (least_x, largest_x),
        f"residual{sided}, {unit}",
        padded(np.concatenate(edges)),
    )
    # All lines above all bands.
    for curve in curves:
        low = curve.mean - curve.spread
        high = curve.mean + curve.spread
        panel.band(evidence.x, low, high, curve.band_style)
    for curve in curves:
        panel.line(evidence.x, curve.mean, curve.line_style, name=curve.name, unit=unit)

    title = f"{subject} of {evidence.joint} over {quantity}"
    text = (
        "Means of bins, in bands of one standard deviation, on blocks left out of the"
        " fit."
    )
    legend = {curve.line_style: f"{curve.name} it is taken off" for curve in curves}
    bins = _bins_table(evidence, title, quantity, unit)
    drawn = figure([panel], title, text, legend, bins, note=text)
    return replace(drawn, joint=evidence.joint)


def _curves_of(evidence: EvidenceEntry) -> list[_Curve]:
    """Return the residual before the effect is taken off and, if known, after."""
    without_effect = _Curve(
        name="before",
        line_style="residual",
        band_style="faint",
        mean=np.array(evidence.before),
        spread=np.array(evidence.before_spread),
    )
    if not evidence.after:
        return [without_effect]
    with_effect = _Curve(
        name="after",
        line_style="predicted",
        band_style="cut0",
        mean=np.array(evidence.after),
        spread=np.array(evidence.after_spread),
    )
    return [without_effect, with_effect]


def _bins_table(evidence: EvidenceEntry, title: str, quantity: str, unit: str) -> Table:
    """Return the bins of the evidence; `unit` is that of the residual."""
    # Older files have no residual after, or no spread.
    unknown = [None] * len(evidence.x)
    rows = zip(
        evidence.x,
        evidence.count,
        evidence.before,
        evidence.before_spread,
        evidence.after or unknown,
        evidence.after_spread or unknown,
        strict=True,
    )
    return table(
        title,
        "{quantity} [{x}] | samples | before [{y}] | spread [{y}] | after [{y}] |"
        " spread [{y}]",
        "number count number number number number",
        rows,
        quantity=quantity,
        x=evidence.unit,
        y=unit,
    )
