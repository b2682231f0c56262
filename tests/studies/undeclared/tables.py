"""The tables of the study of undeclared effects, made from its records."""

from collections.abc import Callable, Sequence
from itertools import pairwise
from operator import attrgetter

import numpy as np

from tests.plants.effects.registry import CATALOGUE, OUTSIDE
from tests.studies.tables import counted, grouped, number
from tests.studies.undeclared.cases import CHANGES, SENSORS, SIZES
from tests.studies.undeclared.judged import (
    Cases,
    Judged,
    by_name,
    judged,
    mistaken,
    of_group,
    of_rig,
    share,
)
from tests.studies.undeclared.run import Record
from tests.studies.undeclared.score import INVISIBLE, LOOSE, SURE, both_found, loud

_right, _alarm, _quiet, _anywhere, _explained_away, _sure_and_wrong = (
    attrgetter(f"score.{name}")
    for name in ("right", "alarm", "quiet", "anywhere", "explained_away", "sure_and_wrong")
)
WRONG = f"wrong and above {SURE:g}"
RIGS = {"two": "two joints", "six": "six joints"}
BINS = (0.0, 0.5, 0.7, 0.8, 0.9, 0.95, 0.99, 1.0)


def tables(records: Sequence[Record], wanted: int) -> str:
    """All tables; `wanted` is the number of cases of the study."""
    cases = judged(records)
    failed = [r for r in records if r.diagnosis is None]
    parts = [
        f"{len(records)} of {wanted} cases; {len(failed)} failed, which counts as wrong.",
        _seconds(records),
        _section("Alone, by kind", kinds(cases)),
        _section("Clean", clean(cases)),
        _section("Two at once", pairs(cases)),
        _section("Outside the catalogue", outside(cases)),
        _section("Other files to start from", starts(cases)),
        _section("What the stated confidence is worth", reliability(cases)),
        "\n".join(f"- failed: {r.condition.key}: {r.error}" for r in failed),
    ]
    return "\n\n".join(part for part in parts if part)


def _section(title: str, content: str) -> str:
    return f"#### {title}\n\n{content}" if content else ""


def _seconds(records: Sequence[Record]) -> str:
    parts = []
    for rig, name in RIGS.items():
        spent = [r.seconds["diagnose"] for r in records if _diagnosed(r) and r.condition.rig == rig]
        if spent:
            longest = number(max(spent))
            parts.append(f"{name}: median {number(float(np.median(spent)))} s, longest {longest} s")
    return f"Time of a diagnosis: {'; '.join(parts)}." if parts else ""


def _diagnosed(record: Record) -> bool:
    return "diagnose" in record.seconds


def _loud(case: Judged) -> bool:
    return any(map(loud, case.record.excess))


def kinds(cases: Cases) -> str:
    """Per kind: how often the first finding has kind and joint."""
    alone = of_group(cases, "catalogue")
    tight = [c for c in alone if c.truths[0].kind != "backlash"]
    loose = [c for c in alone if c.truths[0].kind == "backlash"]
    groups: dict[str, Cases] = {
        name: [c for c in tight if c.truths[0].kind == name] for name in CATALOGUE
    }
    groups["all of these"] = tight
    groups["backlash, RMSE half above"] = [c for c in loose if _loud(c)]
    groups["backlash, less than that"] = [c for c in loose if not _loud(c)]
    content = grouped(
        "effect",
        groups,
        {
            f"{name}, size {size:g}": share(
                _right,
                lambda c, rig=rig, size=size: (  # type: ignore[misc]
                    c.condition.rig == rig and c.condition.effects[0][2] == size
                ),
            )
            for rig, name in RIGS.items()
            for size in SIZES
        }
        | {
            "all": share(_right),
            "by its own name": share(attrgetter("score.own_name")),
            "kind without joint": share(attrgetter("score.kind_right")),
            "found at all": share(_anywhere),
            WRONG: share(_sure_and_wrong),
            "if not right": mistaken(_right),
        },
    )
    note = (
        "Right: the first finding has the kind, or says that it may be that, and the joint. Of "
        f"cases in which the effect raises some joint's held-out RMSE by {100 * INVISIBLE:.0f} % "
        f"or more (backlash: by {100 * LOOSE:.0f} %)."
    )
    return content and f"{note}\n\n{content}"


def clean(cases: Cases) -> str:
    """False alarms."""
    alone = [c for c in cases if c.condition.group == "clean"]
    usual = [c for c in alone if c.condition.start == "simultaneous"]
    groups = {name: [c for c in usual if c.condition.sensors == name] for name in SENSORS}
    for start in ("sequential", "before"):
        groups[f"file: {start}"] = [c for c in alone if c.condition.start == start]
    return grouped(
        "nothing undeclared",
        groups | {"all": alone},
        {f"finding, {name}": share(_alarm, of_rig(rig)) for rig, name in RIGS.items()}
        | {
            "verdict not nothing_missing": share(lambda c: not c.score.quiet),
            f"finding above {SURE:g}": share(_sure_and_wrong),
            "most often": mistaken(_quiet),
        },
    )


def pairs(cases: Cases) -> str:
    """Two effects at once."""
    alone = [c for c in cases if c.condition.group == "pairs"]

    def same(case: Judged) -> bool:
        (_, one, _), (_, two, _) = case.condition.effects
        return one == two

    groups = {name: [c for c in alone if of_rig(rig)(c)] for rig, name in RIGS.items()} | {
        "on one joint": [c for c in alone if same(c)],
        "on different joints": [c for c in alone if not same(c)],
        "all": alone,
        "both visible": [c for c in alone if c.seen],
    }
    return grouped(
        "pairs",
        groups,
        {
            "both found": share(lambda c: both_found(c.diagnosis, c.truths)),
            "one at least": share(lambda c: any(s.anywhere for s in c.scores)),
            "first finding right": share(lambda c: bool(c.diagnosis.findings) and c.first_right),
            WRONG: share(_sure_and_wrong),
        },
    )


def outside(cases: Cases) -> str:
    """What the catalogue does not have."""
    return grouped(
        "outside the catalogue",
        by_name(of_group(cases, "outside"), OUTSIDE),
        {
            "unexplained, right quantity and joint": share(_explained_away),
            "all quantities": share(lambda c: c.score.all_quantities),
            "unexplained": share(lambda c: c.diagnosis.verdict == "unexplained"),
            "some effect named": share(_alarm),
            f"named above {SURE:g}": share(_sure_and_wrong),
            "most often": mistaken(lambda c: not c.score.alarm),
        },
    )


def starts(cases: Cases) -> str:
    """Files other than those of the same logs."""
    alone = of_group(cases, "starts")
    before = [c for c in alone if c.condition.start == "before"]
    groups: dict[str, Cases] = {
        f"{name}, file of before": [c for c in before if c.truths[0].name == name]
        for name in CHANGES
    }
    groups["changes, all"] = before
    labels = {"sequential": "sequential file without it", "sequential_with": "with it"}
    for start, label in labels.items():
        groups[label] = [c for c in alone if c.condition.start == start]
    return grouped(
        "effect and file",
        groups,
        {f"right, {name}": share(_right, of_rig(rig)) for rig, name in RIGS.items()}
        | {
            "found at all": share(_anywhere),
            WRONG: share(_sure_and_wrong),
            "if not right": mistaken(_right),
        },
    )


def reliability(cases: Cases) -> str:
    """Stated confidence of the first finding against how often it is right."""
    firsts = [(c, c.diagnosis.findings[0]) for c in cases if _alarm(c)]
    of_class = [(f.confidence, c.first_right) for c, f in firsts]
    of_name = [
        (f.name_confidence or 0.0, c.score.own_name) for c, f in firsts if len(c.truths) == 1
    ]
    parts = [
        _reliability("confidence of the first finding", "right", of_class),
        _reliability("confidence in its name", "name right", of_name),
    ]
    return "\n\n".join(part for part in parts if part)


def _reliability(title: str, right: str, stated: Sequence[tuple[float, bool]]) -> str:
    groups = {
        f"{low:g} to {high:g}": [
            (p, ok) for p, ok in stated if low <= p < high or p == high == BINS[-1]
        ]
        for low, high in pairwise(BINS)
    }

    def mean(k: int) -> Callable[[Sequence[tuple[float, bool]]], str]:
        return lambda own: f"{100 * np.mean([one[k] for one in own]):.0f} %"

    return grouped(title, groups, {"cases": counted, "stated, mean": mean(0), right: mean(1)})
