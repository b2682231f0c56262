"""The tables of `docs/evidence/outside.md`: answers by group and by effect, and stated
confidences.
"""

from collections.abc import Callable, Mapping, Sequence
from functools import partial

import numpy as np

from seqid_cli.shares import percent
from tests.studies.outside.effects import KINDS
from tests.studies.outside.questions import LOUD, NAMED, answers_to
from tests.studies.outside.score import (
    MANY_FLOORS,
    Row,
    finding_is,
    label,
    one_step,
    overlooked,
    silent,
    surely_wrong,
)
from tests.studies.tables import counted, grouped, number, table

LABELS = {
    "right": "right name",
    "alike": "told as like it",
    "family": "right family",
    "quantity": "right quantity",
    "other": "other answer",
    "little left": "silent, little left",
    "silent": "silent",
}
GROUPS: Mapping[str, Callable[[Row], bool]] = {
    "one effect, later": lambda row: len(row["kinds"]) == 1 and row["flow"] == "late",
    "one effect, from the start": lambda row: (
        len(row["kinds"]) == 1 and row["flow"] == "early"
    ),
    "two effects": lambda row: len(row["kinds"]) == 2,
    "one-step file": one_step,
    "one log of 20 s": lambda row: row["flow"] == "single",
    "published arms": lambda row: row["arm"] != "drawn",
    "with IMUs": lambda row: row["imu"],
    "without IMUs": lambda row: not row["imu"],
    "all": lambda row: True,
}
BINS = (
    (0.0, 0.8),
    (0.8, 0.9),
    (0.9, 0.97),
    (0.97, 0.99),
    (0.99, np.nextafter(1.0, 2.0)),
)
Rows = Sequence[Row]


def tables(rows: Rows, group: str = "mixed") -> str:
    """Return the tables of a group's answers."""
    makers = (question_table, sort_table, confidence_table, cost_line)
    if group == "mixed":
        makers = (
            asked_table,
            clean_table,
            group_table,
            effect_table,
            confidence_table,
            cost_line,
        )
    return "\n\n".join(filter(None, (make(rows) for make in makers)))


def question_table(rows: Rows) -> str:
    """How often an answer was what a group asks for, and what must not be."""
    well = _well(rows)
    answers = [answers_to(row) for row in well]
    questions = dict.fromkeys(question for each in answers for question in each)
    asked = {
        question: [each[question] for each in answers if question in each]
        for question in questions
    }
    asked |= _never(well)
    lines = [
        [what, str(len(own)), str(sum(own)), _share(own)] for what, own in asked.items()
    ]
    return table(["of all", "cases", "so many", "share"], lines)


def _never(well: Rows) -> dict[str, list[bool]]:
    """What must not be, or hardly ever, whatever a group asks for."""
    return {
        f"a wrong name above {LOUD:g}": [surely_wrong(row, LOUD) for row in well],
        f"`nothing_missing` beside more than {MANY_FLOORS:g} noise floors": [
            overlooked(row) for row in well
        ],
    }


def sort_table(rows: Rows) -> str:
    """The same by what a group has several sorts of: effects, lengths, changes."""
    sorts = dict.fromkeys(_sort(row) for row in rows)
    groups = {sort: [row for row in rows if _sort(row) == sort] for sort in sorts}
    questions = dict.fromkeys(x for row in _well(rows) for x in answers_to(row))

    def share_of(question: str, own: Rows) -> str:
        answers = [answers_to(row) for row in _well(own)]
        met = [each[question] for each in answers if question in each]
        return f"{sum(met)} of {len(met)}" if met else ""

    def wrong(own: Rows) -> str:
        return str(sum(surely_wrong(row, LOUD) for row in _well(own)) or "")

    def size(own: Rows) -> str:
        shares = [share for row in own for share in row["shares"]]
        return percent(float(np.median(shares)), 1) if any(shares) else ""

    columns = {
        "cases": counted,
        "size": size,
        **{question: partial(share_of, question) for question in questions},
        f"a wrong name above {LOUD:g}": wrong,
        "failed": _failed,
    }
    return grouped("sort", dict(sorted(groups.items())), columns)


def _sort(row: Row) -> str:
    return row["variant"] or " and ".join(row["kinds"]) or f"clean, {row['flow']}"


def cost_line(rows: Rows) -> str:
    """CPU seconds of diagnosing, and of whole cases, simulation and stages included."""
    asked = [row["diagnose_seconds"] for row in rows if "diagnose_seconds" in row]
    if not asked:
        return ""
    whole = number(float(np.median([row["seconds"] for row in rows])))
    return (
        f"Diagnosing takes {number(float(np.median(asked)))} CPU s (median),"
        f" {number(max(asked))} at most; a case with its simulation and its stages"
        f" {whole}."
    )


def _share(test: Sequence[bool]) -> str:
    return percent(sum(test) / len(test), 0) if test else "-"


def _well(rows: Rows) -> list[Row]:
    return [row for row in rows if not row["error"]]


def _failed(rows: Rows) -> str:
    return str(len(rows) - len(_well(rows)))


def _found(rows: Rows) -> list[list[str]]:
    return [[label(row, k) for k in range(len(row["kinds"]))] for row in _well(rows)]


def asked_table(rows: Rows) -> str:
    well, found = _well(rows), _found(rows)
    alone = [own[0] for own in found if len(own) == 1]
    pairs = [set(own) for own in found if len(own) == 2]
    both = [own for own in pairs if "little left" not in own]
    asked = {
        "clean arm: nothing told": [silent(row) for row in well if not row["kinds"]],
        "one effect that shows: its name, or told as like it": [
            x in NAMED for x in alone if x != "little left"
        ],
        "one effect, whether or not it shows": [x in NAMED for x in alone],
        "two effects that both show: both": [own <= NAMED for own in both],
        "two effects that both show: at least one": [bool(NAMED & own) for own in both],
        "two effects, whether or not they show: both": [own <= NAMED for own in pairs],
    } | _never(well)
    lines = [
        [what, str(len(own)), str(sum(own)), _share(own)] for what, own in asked.items()
    ]
    return table(["of all", "cases", "so many", "share"], lines)


def clean_table(rows: Rows) -> str:
    clean = [row for row in rows if not row["kinds"]]
    names = {"clean, sequential": False, "clean, one-step": True}
    groups = {
        name: [row for row in clean if one_step(row) is x] for name, x in names.items()
    }
    columns = {
        "cases": counted,
        "silent": lambda own: _share([silent(row) for row in _well(own)]),
        "a wrong name, surely": lambda own: str(sum(map(surely_wrong, _well(own)))),
        "failed": _failed,
    }
    return grouped("group", groups, columns)


def group_table(rows: Rows) -> str:
    hidden = [row for row in rows if row["kinds"]]

    def share_of(key: str, own: Rows) -> str:
        hits = [x == key for found in _found(own) for x in found]
        return _share(hits) if any(hits) else ""

    groups = {
        name: [row for row in hidden if chosen(row)] for name, chosen in GROUPS.items()
    }
    columns = {
        "cases": counted,
        "effects": lambda own: str(sum(map(len, _found(own)))),
        **{name: partial(share_of, key) for key, name in LABELS.items()},
        "a wrong name, surely": lambda own: _share(
            [surely_wrong(row) for row in _well(own)]
        ),
        "failed": _failed,
    }
    return grouped("group", groups, columns)


def effect_table(rows: Rows) -> str:
    every = [(row, k) for row in _well(rows) for k in range(len(row["kinds"]))]

    def count_of(key: str, own: Sequence[tuple[Row, int]]) -> str:
        return str(sum(label(row, k) == key for row, k in own) or "")

    groups = {
        kind: [(row, k) for row, k in every if row["kinds"][k] == kind]
        for kind in KINDS
    }
    columns = {
        "times": counted,
        "size": lambda own: percent(
            float(np.median([r["shares"][k] for r, k in own])), 1
        ),
        **{name: partial(count_of, key) for key, name in LABELS.items()},
    }
    return grouped("effect", groups, columns)


def confidence_table(rows: Rows) -> str:
    findings = [
        (item, finding_is(row, item)) for row in _well(rows) for item in row["findings"]
    ]
    lines = []
    for low, high in BINS:
        own = [
            (f["confidence"], worth)
            for f, worth in findings
            if low <= f["confidence"] < high
        ]
        named = [
            worth
            for f, worth in findings
            if low <= (f["name_confidence"] or 0.0) < high
        ]
        cells = [
            percent(float(np.mean([stated for stated, _ in own])), 0) if own else "-",
            _share([worth in NAMED for _, worth in own]),
            _share([worth != "wrong" for _, worth in own]),
            str(len(named)),
            _share([worth == "right" for worth in named]),
        ]
        lines.append([f"{low:g} to {high:g}", str(len(own)), *cells])
    header = ["confidence", "findings", "stated, mean", "right or told as like it"]
    header += ["or right family", "by the name's confidence", "right name"]
    return table(header, lines)
