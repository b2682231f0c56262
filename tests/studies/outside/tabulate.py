"""The tables of `docs/evidence/outside.md`: answers by group and by effect, and stated
confidences.
"""

from collections.abc import Callable, Mapping, Sequence
from functools import partial

import numpy as np

from seqid_cli.shares import percent
from tests.studies.outside.effects import KINDS
from tests.studies.outside.score import (
    Row,
    finding_is,
    label,
    one_step,
    silent,
    surely_wrong,
)
from tests.studies.tables import counted, grouped, table

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
# confidence from which a wrong name is counted: above 0.8
LOUD = np.nextafter(0.8, 1.0)
NAMED = {"right", "alike"}
Rows = Sequence[Row]


def tables(rows: Rows) -> str:
    makers = (asked_table, clean_table, group_table, effect_table, confidence_table)
    return "\n\n".join(filter(None, (make(rows) for make in makers)))


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
    loud = [surely_wrong(row, LOUD) for row in well]
    asked = {
        "clean arm: nothing told": [silent(row) for row in well if not row["kinds"]],
        "one effect that shows: its name, or told as like it": [
            x in NAMED for x in alone if x != "little left"
        ],
        "one effect, whether or not it shows": [x in NAMED for x in alone],
        "two effects that both show: both": [own <= NAMED for own in both],
        "two effects that both show: at least one": [bool(NAMED & own) for own in both],
        "two effects, whether or not they show: both": [own <= NAMED for own in pairs],
        f"a wrong name above {LOUD:g}": loud,
    }
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
