"""The tables of the study of undeclared effects, made from its records."""

from collections import Counter
from collections.abc import Callable, Iterable, Mapping, Sequence
from itertools import pairwise, product
from operator import attrgetter

import numpy as np

from tests.plants.effects.registry import CATALOGUE, OUTSIDE
from tests.studies.tables import counted, grouped, number
from tests.studies.undeclared.cases import CHANGES, SENSORS, SIZES, Record
from tests.studies.undeclared.score import INVISIBLE, LOOSE, SURE, Judged, judged

RIGS = {"two": "two joints", "six": "six joints"}
BINS = (0.0, 0.5, 0.7, 0.8, 0.9, 0.95, 0.99, 1.0)
Select = Callable[[Judged], bool]
Cases = Sequence[Judged]
Cell = Callable[[Cases], str]


def share(hit: str | Select, only: Select = lambda case: True) -> Cell:
    """A cell: the share of the cases that a condition, or what is judged, holds for, of
    some.
    """
    holds = attrgetter(hit) if isinstance(hit, str) else hit

    def cell(cases: Cases) -> str:
        own = [holds(c) for c in cases if only(c)]
        return f"{100 * sum(own) / len(own):.0f} % of {len(own)}" if own else "-"

    return cell


def by_rig(label: str, hit: str) -> dict[str, Cell]:
    return {
        f"{label}, {name}": share(hit, _where(rig=rig)) for rig, name in RIGS.items()
    }


def mistaken(hit: str) -> Cell:
    """A cell: what the first finding says most often where it is wrong."""

    def said(case: Judged) -> str:
        if case.record.diagnosis is None:
            return "failed"
        return case.first[0].effect if case.first else case.diagnosis.verdict

    def cell(cases: Cases) -> str:
        names = Counter(said(case) for case in cases if not getattr(case, hit))
        return (
            ", ".join(f"{name} {count}" for name, count in names.most_common(2)) or "-"
        )

    return cell


def _where(**asked: object) -> Select:
    return lambda case: all(
        getattr(case.condition, k) == value for k, value in asked.items()
    )


def _chosen(cases: Cases, **asked: object) -> list[Judged]:
    return list(filter(_where(**asked), cases))


def _seen(cases: Cases, group: str) -> list[Judged]:
    return [case for case in _chosen(cases, group=group) if case.seen]


def _by_name(cases: Cases, names: Iterable[str]) -> dict[str, Cases]:
    return {name: [c for c in cases if c.truth.name == name] for name in names}


SURELY: Mapping[str, Cell] = {f"wrong and above {SURE:g}": share("sure_and_wrong")}
USUAL: Mapping[str, Cell] = {
    "found at all": share("found"),
    **SURELY,
    "if not right": mistaken("right"),
}


def tables(records: Sequence[Record], wanted: int) -> str:
    cases = [judged(record) for record in records]
    failed = [r for r in records if r.diagnosis is None]
    sections = {
        "Alone, by kind": kinds(cases),
        "Clean": clean(cases),
        "Two at once": pairs(cases),
        "Outside the catalogue": outside(cases),
        "Other files to start from": starts(cases),
        "What the stated confidence is worth": reliability(cases),
    }
    parts = [
        (
            f"{len(records)} of {wanted} cases; {len(failed)} failed, which counts as"
            " wrong."
        ),
        _seconds(records),
        *(
            f"#### {title}\n\n{content}"
            for title, content in sections.items()
            if content
        ),
        "\n".join(f"- failed: {r.condition.key}: {r.error}" for r in failed),
    ]
    return "\n\n".join(filter(None, parts))


def _seconds(records: Sequence[Record]) -> str:
    parts = []
    for rig, name in RIGS.items():
        if spent := [
            r.seconds for r in records if r.condition.rig == rig and r.diagnosis
        ]:
            middle, longest = number(float(np.median(spent))), number(max(spent))
            parts.append(f"{name}: median {middle} s, longest {longest} s")
    return f"Time of a diagnosis: {'; '.join(parts)}." if parts else ""


def kinds(cases: Cases) -> str:
    alone = _seen(cases, "catalogue")
    tight = [c for c in alone if c.truth.kind != "backlash"]
    loose = [c for c in alone if c.truth.kind == "backlash"]
    groups: dict[str, Cases] = {
        n: [c for c in tight if c.truth.kind == n] for n in CATALOGUE
    }
    groups["all of these"] = tight
    groups["backlash, RMSE half above"] = [c for c in loose if c.loud]
    groups["backlash, less than that"] = [c for c in loose if not c.loud]
    columns = {
        f"{name}, size {size:g}": share("right", _where(rig=rig, size=size))
        for (rig, name), size in product(RIGS.items(), SIZES)
    }
    columns |= {"all": share("right"), "by its own name": share("own_name")}
    columns["kind without joint"] = share("kind_right")
    content = grouped("effect", groups, columns | USUAL)
    note = (
        "Right: the first finding has the kind, or says that it may be that, and the"
        " joint. Of cases in which the effect raises some joint's held-out RMSE by"
        f" {100 * INVISIBLE:.0f} % or more (backlash: by {100 * LOOSE:.0f} %)."
    )
    return content and f"{note}\n\n{content}"


def clean(cases: Cases) -> str:
    alone = _chosen(cases, group="clean")
    usual = _chosen(alone, start="simultaneous")
    groups = {name: _chosen(usual, sensors=name) for name in SENSORS}
    groups |= {
        f"file: {start}": _chosen(alone, start=start)
        for start in ("sequential", "before")
    }
    columns = {
        "verdict not nothing_missing": share(lambda case: not case.quiet),
        f"finding above {SURE:g}": share("sure_and_wrong"),
        "most often": mistaken("quiet"),
    }
    groups["all"] = alone
    return grouped("nothing undeclared", groups, by_rig("finding", "alarm") | columns)


def pairs(cases: Cases) -> str:
    alone = _chosen(cases, group="pairs")
    groups = {
        **{name: _chosen(alone, rig=rig) for rig, name in RIGS.items()},
        "on one joint": _chosen(alone, joints=1),
        "on different joints": _chosen(alone, joints=2),
        "all": alone,
        "both visible": [c for c in alone if c.seen],
    }
    columns = {"both found": share("all_found"), "one at least": share("found")}
    columns["first finding right"] = share("first_right")
    return grouped("pairs", groups, columns | SURELY)


def outside(cases: Cases) -> str:
    own = _seen(cases, "outside")
    columns = {
        "unexplained, right quantity and joint": share("explained_away"),
        "all quantities": share("all_quantities"),
        "unexplained": share(lambda case: case.diagnosis.verdict == "unexplained"),
        "some effect named": share("alarm"),
        f"named above {SURE:g}": share("sure_and_wrong"),
        "most often": mistaken("silent"),
    }
    return grouped(
        "outside the catalogue", _by_name(own, OUTSIDE) | {"all": own}, columns
    )


def starts(cases: Cases) -> str:
    alone = _seen(cases, "starts")
    before = _chosen(alone, start="before")
    groups = {
        **{
            f"{name}, file of before": own
            for name, own in _by_name(before, CHANGES).items()
        },
        "changes, all": before,
        "sequential file without it": _chosen(alone, start="sequential"),
        "with it": _chosen(alone, start="sequential_with"),
    }
    return grouped("effect and file", groups, by_rig("right", "right") | USUAL)


def reliability(cases: Cases) -> str:
    """Stated confidence of the first finding against how often it is right."""
    firsts = [(c, f) for c in cases for f in c.first]
    of_class = [(f.confidence, c.first_right) for c, f in firsts]
    of_name = [
        (f.name_confidence or 0.0, c.own_name) for c, f in firsts if len(c.truths) == 1
    ]
    parts = [
        _reliability("confidence of the first finding", "right", of_class),
        _reliability("confidence in its name", "name right", of_name),
    ]
    return "\n\n".join(filter(None, parts))


def _reliability(title: str, right: str, stated: Sequence[tuple[float, bool]]) -> str:
    def mean(k: int) -> Callable[[Sequence[tuple[float, bool]]], str]:
        return lambda own: f"{100 * np.mean([one[k] for one in own]):.0f} %"

    groups = {
        f"{low:g} to {high:g}": [
            x for x in stated if low <= x[0] < high or x[0] == high == 1.0
        ]
        for low, high in pairwise(BINS)
    }
    return grouped(
        title, groups, {"cases": counted, "stated, mean": mean(0), right: mean(1)}
    )
