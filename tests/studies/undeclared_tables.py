"""The tables of the study of undeclared effects, made from its records."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from seqid_cli.params.results.diagnosis import DiagnosisFile
from tests.plants.drawn import JOINTS
from tests.plants.undeclared import CATALOGUE, OTHER_LAWS, OUTSIDE
from tests.studies.tables import number, table
from tests.studies.undeclared_cases import (
    CHANGES,
    SENSORS,
    SIZES,
    Condition,
    Truth,
    built,
    declared,
    in_the_model,
)
from tests.studies.undeclared_run import Record
from tests.studies.undeclared_score import (
    INVISIBLE,
    LOOSE,
    SURE,
    Score,
    both_found,
    loud,
    right,
    score,
    visible,
)
from tests.unit.params.documents import diagnosis_of

_RIGS = ("two", "six")
FAILED = diagnosis_of("effect_found")  # neither quiet nor right
BINS = (0.0, 0.5, 0.7, 0.8, 0.9, 0.95, 0.99, 1.0)


@dataclass(frozen=True)
class Judged:
    """A case, its diagnosis and its truth; `scores` is per effect, one where clean."""

    record: Record
    condition: Condition
    diagnosis: DiagnosisFile
    truths: tuple[Truth, ...]
    scores: tuple[Score, ...]

    @property
    def score(self) -> Score:
        """Of the only effect, or of none."""
        return self.scores[0]

    @property
    def seen(self) -> bool:
        """Whether all effects leave something to find."""
        names = [name for name, _, _ in self.condition.effects]
        missing = all(not in_the_model(self.condition, name) for name in names)
        return missing and all(map(visible, self.record.excess))

    @property
    def first_right(self) -> bool:
        """Whether the first finding is one of the true effects."""
        first = self.diagnosis.findings[0]
        return any(right(first, truth) for truth in self.truths)


Select = Callable[[Judged], bool]


def judged(records: Sequence[Record]) -> list[Judged]:
    """Judge every record; one without a diagnosis is wrong in every respect."""
    found = []
    for record in records:
        diagnosis = record.diagnosis or FAILED
        _, truths = built(record.condition)
        scores = tuple(score(diagnosis, truths, k) for k in range(max(len(truths), 1)))
        found.append(Judged(record, record.condition, diagnosis, truths, scores))
    return found


def percent(hits: int, of: int) -> str:
    """Share and count, "-" of none."""
    return f"{100 * hits / of:.0f} % of {of}" if of else "-"


def share(cases: Sequence[Judged], hit: Select) -> str:
    """Share of the cases that a condition holds for."""
    return percent(sum(map(hit, cases)), len(cases))


def tables(records: Sequence[Record], wanted: int) -> str:
    """All tables; `wanted` is the number of cases of the study."""
    cases = judged(records)
    failed = [r for r in records if r.diagnosis is None]
    parts = [
        f"{len(records)} of {wanted} cases; {len(failed)} failed, which counts as wrong.",
        _seconds(records),
        _section("Alone, by kind", kinds(cases)),
        _section("Effects that leave nothing to find", invisible(cases)),
        _section("Clean", clean(cases)),
        _section("Two at once", pairs(cases)),
        _section("Outside the catalogue", outside(cases)),
        _section("Other laws", other_laws(cases)),
        _section("Other files to start from", starts(cases)),
        _section("Arms that nothing was set on", other_arms(cases)),
        _section("What the stated confidence is worth", reliability(cases)),
        "\n".join(f"- failed: {r.key}: {r.error}" for r in failed),
    ]
    return "\n\n".join(part for part in parts if part)


def _section(title: str, content: str) -> str:
    return f"#### {title}\n\n{content}" if content else ""


def _seconds(records: Sequence[Record]) -> str:
    parts = []
    for rig, name in (("two", "two joints"), ("six", "six joints")):
        spent = [r.seconds["diagnose"] for r in records if _diagnosed(r) and r.condition.rig == rig]
        if spent:
            longest = number(max(spent))
            parts.append(f"{name}: median {number(float(np.median(spent)))} s, longest {longest} s")
    return f"Time of a diagnosis: {'; '.join(parts)}." if parts else ""


def _diagnosed(record: Record) -> bool:
    return "diagnose" in record.seconds


def _mistaken(cases: Sequence[Judged], hit: Select) -> str:
    """What the first finding says most often where it is wrong."""
    names = [_said(c) for c in cases if not hit(c)]
    return ", ".join(f"{name} {count}" for name, count in Counter(names).most_common(2)) or "-"


def _said(case: Judged) -> str:
    if case.record.diagnosis is None:
        return "failed"
    findings = case.diagnosis.findings
    return findings[0].effect if findings else case.diagnosis.verdict


def _right(case: Judged) -> bool:
    return case.score.right


def _sure_and_wrong(case: Judged) -> bool:
    return case.score.sure_and_wrong


def _loud(case: Judged) -> bool:
    return any(map(loud, case.record.excess))


def kinds(cases: Sequence[Judged]) -> str:
    """Per kind: how often the first finding has kind and joint."""
    alone = [c for c in cases if c.condition.group == "catalogue" and c.seen]
    tight = [c for c in alone if c.truths[0].kind != "backlash"]
    loose = [c for c in alone if c.truths[0].kind == "backlash"]
    groups = {name: [c for c in tight if c.truths[0].kind == name] for name in CATALOGUE}
    groups["all of these"] = tight
    groups["backlash, RMSE half above"] = [c for c in loose if _loud(c)]
    groups["backlash, less than that"] = [c for c in loose if not _loud(c)]
    rows = [[name, *_kind_cells(group)] for name, group in groups.items() if group]
    columns = [f"{rig}, size {size:g}" for rig in ("two joints", "six joints") for size in SIZES]
    header = ["effect", *columns, "all", "by its own name", "kind without joint", "found at all"]
    if not rows:
        return ""
    note = (
        "Right: the first finding has the kind, or says that it may be that, and the joint. Of "
        f"cases in which the effect raises some joint's held-out RMSE by {100 * INVISIBLE:.0f} % "
        f"or more (backlash: by {100 * LOOSE:.0f} %)."
    )
    header += [f"wrong and above {SURE:g}", "if not right"]
    return f"{note}\n\n{table(header, rows)}"


def _kind_cells(group: Sequence[Judged]) -> list[str]:
    def part(rig: str, size: float) -> str:
        return share(
            [c for c in group if c.condition.rig == rig and c.condition.effects[0][2] == size],
            _right,
        )

    return [
        *(part(rig, size) for rig in ("two", "six") for size in SIZES),
        share(group, _right),
        share(group, lambda c: c.score.own_name),
        share(group, lambda c: c.score.kind_right),
        share(group, lambda c: c.score.anywhere),
        share(group, _sure_and_wrong),
        _mistaken(group, _right),
    ]


def invisible(cases: Sequence[Judged]) -> str:
    """Effects that the file's own parameters absorb: nothing should be found in them."""
    rows = []
    groups = ("catalogue", "other_laws", "outside", "starts")
    hidden = [c for c in cases if c.condition.group in groups and not c.seen]
    for name in sorted({c.truths[0].name for c in hidden}):
        group = [c for c in hidden if c.truths[0].name == name]
        cells = [
            share(group, lambda c: c.score.quiet),
            share(group, _right),
            share(group, lambda c: c.score.alarm and not c.score.right),
            share(group, _sure_and_wrong),
            share(group, _called_hidden),
        ]
        rows.append([name, str(len(group)), *cells])
    header = ["invisible on these logs", "cases", "nothing missing", "right", "wrong finding"]
    return table([*header, f"wrong and above {SURE:g}", "listed as hidden"], rows) if rows else ""


def _called_hidden(case: Judged) -> bool:
    truth = case.truths[0]
    return any(h.effect == truth.kind and h.joint in truth.joints for h in case.diagnosis.hidden)


def clean(cases: Sequence[Judged]) -> str:
    """False alarms."""
    alone = [c for c in cases if c.condition.group == "clean"]
    usual = [c for c in alone if c.condition.start == "simultaneous"]
    groups = {name: [c for c in usual if c.condition.sensors == name] for name in SENSORS}
    for start in ("sequential", "before"):
        groups[f"file: {start}"] = [c for c in alone if c.condition.start == start]
    groups["all"] = alone
    rows = [
        [
            name,
            *(share([c for c in group if c.condition.rig == rig], _alarm) for rig in _RIGS),
            share(group, lambda c: not c.score.quiet),
            share(group, _sure_and_wrong),
            _mistaken(group, lambda c: c.score.quiet),
        ]
        for name, group in groups.items()
        if group
    ]
    header = ["nothing undeclared", "finding, two joints", "finding, six joints"]
    header += ["verdict not nothing_missing", f"finding above {SURE:g}", "most often"]
    return table(header, rows) if rows else ""


def _alarm(case: Judged) -> bool:
    return case.score.alarm


def pairs(cases: Sequence[Judged]) -> str:
    """Two effects at once."""
    alone = [c for c in cases if c.condition.group == "pairs"]

    def same(case: Judged) -> bool:
        (_, one, _), (_, two, _) = case.condition.effects
        return one == two

    groups = {
        "two joints": [c for c in alone if c.condition.rig == "two"],
        "six joints": [c for c in alone if c.condition.rig == "six"],
        "on one joint": [c for c in alone if same(c)],
        "on different joints": [c for c in alone if not same(c)],
        "all": alone,
        "both visible": [c for c in alone if c.seen],
    }
    rows = [
        [
            name,
            share(group, lambda c: both_found(c.diagnosis, c.truths)),
            share(group, lambda c: any(s.anywhere for s in c.scores)),
            share(group, lambda c: c.first_right if c.diagnosis.findings else False),
            share(group, _sure_and_wrong),
        ]
        for name, group in groups.items()
        if group
    ]
    header = ["pairs", "both found", "one at least", "first finding right"]
    return table([*header, f"wrong and above {SURE:g}"], rows) if rows else ""


def outside(cases: Sequence[Judged]) -> str:
    """What the catalogue does not have."""
    alone = [c for c in cases if c.condition.group == "outside" and c.seen]
    groups = {name: [c for c in alone if c.truths[0].name == name] for name in OUTSIDE}
    groups["all"] = alone
    rows = [
        [
            name,
            share(group, lambda c: c.score.explained_away),
            share(group, lambda c: c.score.all_quantities),
            share(group, lambda c: c.diagnosis.verdict == "unexplained"),
            share(group, _alarm),
            share(group, _sure_and_wrong),
            _mistaken(group, lambda c: not c.score.alarm),
        ]
        for name, group in groups.items()
        if group
    ]
    header = ["outside the catalogue", "unexplained, right quantity and joint", "all quantities"]
    header += ["unexplained", "some effect named", f"named above {SURE:g}", "most often"]
    return table(header, rows) if rows else ""


def other_laws(cases: Sequence[Judged]) -> str:
    """The right family by another law."""
    alone = [c for c in cases if c.condition.group == "other_laws" and c.seen]
    groups = {name: [c for c in alone if c.truths[0].name == name] for name in OTHER_LAWS}
    groups["all"] = alone
    rows = [
        [
            name,
            share(group, _family_or_quantity),
            share(group, _right),
            share(group, lambda c: c.score.explained_away),
            share(group, _sure_and_wrong),
            _mistaken(group, _family_or_quantity),
        ]
        for name, group in groups.items()
        if group
    ]
    header = ["another law", "family, or unexplained with a right quantity", "family and joint"]
    header += ["unexplained so", f"wrong and above {SURE:g}", "if not right"]
    return table(header, rows) if rows else ""


def other_arms(cases: Sequence[Judged]) -> str:
    """Arms drawn at random, by the number of their joints."""
    alone = [c for c in cases if c.condition.group == "other_arms"]
    counts = {c.record.key: declared(c.condition).arm.n for c in alone}
    turning, sliding = ([c for c in alone if _slides(c) == x] for x in (False, True))
    groups = {f"{n} joints": [c for c in turning if counts[c.record.key] == n] for n in JOINTS}
    groups["some that slide"] = sliding
    groups["all"] = alone
    rows = [[name, *_arm_cells(group)] for name, group in groups.items() if group]
    header = ["arms drawn at random", "clean: finding", "clean: verdict not nothing_missing"]
    header += ["one effect: right", "found at all", f"wrong and above {SURE:g}", "if not right"]
    return table(header, rows) if rows else ""


def _slides(case: Judged) -> bool:
    return bool(declared(case.condition).arm.slides)


def _arm_cells(group: Sequence[Judged]) -> list[str]:
    quiet = [c for c in group if not c.condition.effects]
    seen = [c for c in group if c.condition.effects and c.seen]
    return [
        share(quiet, _alarm),
        share(quiet, lambda c: not c.score.quiet),
        share(seen, _right),
        share(seen, lambda c: c.score.anywhere),
        share(seen, _sure_and_wrong),
        _mistaken(seen, _right),
    ]


def _family_or_quantity(case: Judged) -> bool:
    return case.score.right or case.score.explained_away


def starts(cases: Sequence[Judged]) -> str:
    """Files other than those of the same logs."""
    alone = [c for c in cases if c.condition.group == "starts" and c.seen]
    groups = {
        f"{name}, file of before": [
            c for c in alone if c.condition.start == "before" and c.truths[0].name == name
        ]
        for name in CHANGES
    }
    groups["changes, all"] = [c for c in alone if c.condition.start == "before"]
    labels = {"sequential": "sequential file without it", "sequential_with": "with it"}
    for start, label in labels.items():
        groups[label] = [c for c in alone if c.condition.start == start]
    rows = [
        [
            name,
            *(share([c for c in group if c.condition.rig == rig], _right) for rig in _RIGS),
            share(group, lambda c: c.score.anywhere),
            share(group, _sure_and_wrong),
            _mistaken(group, _right),
        ]
        for name, group in groups.items()
        if group
    ]
    header = ["effect and file", "right, two joints", "right, six joints", "found at all"]
    return table([*header, f"wrong and above {SURE:g}", "if not right"], rows) if rows else ""


def reliability(cases: Sequence[Judged]) -> str:
    """Stated confidence of the first finding against how often it is right."""
    alarms = [c for c in cases if _alarm(c)]
    firsts = [(c, c.diagnosis.findings[0]) for c in alarms]
    of_class = [(f.confidence, c.first_right) for c, f in firsts]
    of_name = [(f.name_confidence, c.score.own_name) for c, f in firsts if len(c.truths) == 1]
    parts = [
        _reliability("confidence of the first finding", "right", of_class),
        _reliability("confidence in its name", "name right", of_name),
    ]
    return "\n\n".join(part for part in parts if part)


def _reliability(title: str, right: str, stated: Sequence[tuple[float, bool]]) -> str:
    rows = []
    for low, high in pairwise(BINS):
        last = high == BINS[-1]
        inside = [(p, ok) for p, ok in stated if low <= p < high or (last and p == high)]
        if inside:
            p, ok = np.array(inside, dtype=np.float64).T
            cells = [str(len(p)), f"{100 * p.mean():.0f} %", f"{100 * ok.mean():.0f} %"]
            rows.append([f"{low:g} to {high:g}", *cells])
    return table([title, "cases", "stated, mean", right], rows) if rows else ""
