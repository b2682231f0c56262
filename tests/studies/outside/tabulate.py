"""The tables of `docs/outside.md`: answers by group and by effect, and stated confidences."""

from collections import Counter
from collections.abc import Callable, Mapping, Sequence

import numpy as np

from seqid_cli.shares import percent
from tests.studies.outside.plan import KINDS
from tests.studies.outside.score import Row, finding_is, label, one_step, silent, surely_wrong
from tests.studies.tables import table

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
    "one effect, from the start": lambda row: len(row["kinds"]) == 1 and row["flow"] == "early",
    "two effects": lambda row: len(row["kinds"]) == 2,
    "one-step file": one_step,
    "one log of 20 s": lambda row: row["flow"] == "single",
    "published arms": lambda row: row["arm"] != "drawn",
    "with IMUs": lambda row: row["imu"],
    "without IMUs": lambda row: not row["imu"],
    "all": lambda row: True,
}
BINS = ((0.0, 0.8), (0.8, 0.9), (0.9, 0.97), (0.97, 0.99), (0.99, 1.0))
LOUD = 0.8  # confidence above which a wrong name is counted
NAMED = ("right", "alike")


def tables(rows: Sequence[Row]) -> str:
    """Markdown: what is asked, clean cases, groups, effects, confidences."""
    makers = (asked_table, clean_table, group_table, effect_table, confidence_table)
    return "\n\n".join(make(rows) for make in makers)


def _share(test: Sequence[bool]) -> str:
    return percent(sum(test) / len(test), 0) if test else "-"


def asked_table(rows: Sequence[Row]) -> str:
    """What matters most, of all cases that did not fail."""
    well = [row for row in rows if not row["error"]]
    found = [[label(row, k) for k in range(len(row["kinds"]))] for row in well]
    alone = [own[0] for own in found if len(own) == 1]
    visible = [x in NAMED for x in alone if x != "little left"]
    pairs = [own for own in found if len(own) == 2]
    both = [own for own in pairs if "little left" not in own]
    loud = [
        any(f["confidence"] > LOUD and finding_is(row, f) == "wrong" for f in row["findings"])
        for row in well
    ]
    asked: list[tuple[str, list[bool]]] = [
        ("clean arm: nothing told", [silent(row) for row in well if not row["kinds"]]),
        ("one effect that shows: its name, or told as like it", visible),
        ("one effect, whether or not it shows", [x in NAMED for x in alone]),
        ("two effects that both show: both", [set(own) <= set(NAMED) for own in both]),
        ("two effects that both show: at least one", [bool({*NAMED} & {*own}) for own in both]),
        ("two effects, whether or not they show: both", [set(own) <= set(NAMED) for own in pairs]),
        (f"a wrong name above {LOUD:g}", loud),
    ]
    lines = [[what, str(len(own)), str(sum(own)), _share(own)] for what, own in asked]
    return table(["of all", "cases", "so many", "share"], lines)


def clean_table(rows: Sequence[Row]) -> str:
    """How often nothing is told of arms that lack nothing."""
    clean = [row for row in rows if not row["kinds"]]
    lines = []
    for name, steps in (("sequential", False), ("one-step", True)):
        own = [row for row in clean if one_step(row) == steps]
        well = [row for row in own if not row["error"]]
        cells = [_share([silent(row) for row in well]), str(sum(map(surely_wrong, well)))]
        lines.append([f"clean, {name}", str(len(own)), *cells, str(len(own) - len(well))])
    return table(["group", "cases", "silent", "a wrong name, surely", "failed"], lines)


def _cells(found: Sequence[str]) -> list[str]:
    counts = Counter(found)
    return [_share([x == key for x in found]) if counts[key] else "" for key in LABELS]


def group_table(rows: Sequence[Row]) -> str:
    """Shares of hidden effects by how well they were found, per group of cases."""
    lines = []
    for name, chosen in GROUPS.items():
        own = [row for row in rows if row["kinds"] and chosen(row)]
        well = [row for row in own if not row["error"]]
        found = [label(row, k) for row in well for k in range(len(row["kinds"]))]
        wrong = _share([surely_wrong(row) for row in well])
        counts = [str(len(own)), str(len(found))]
        lines.append([name, *counts, *_cells(found), wrong, str(len(own) - len(well))])
    header = ["group", "cases", "effects", *LABELS.values(), "a wrong name, surely", "failed"]
    return table(header, lines)


def effect_table(rows: Sequence[Row]) -> str:
    """The same per effect, with its median share of the torque."""
    lines = []
    for kind in KINDS:
        pairs = [
            (row, k)
            for row in rows
            if not row["error"]
            for k, x in enumerate(row["kinds"])
            if x == kind
        ]
        if pairs:
            size = percent(float(np.median([row["shares"][k] for row, k in pairs])), 1)
            found = [label(row, k) for row, k in pairs]
            counts = [str(sum(x == key for x in found) or "") for key in LABELS]
            lines.append([kind, str(len(pairs)), size, *counts])
    return table(["effect", "times", "size", *LABELS.values()], lines)


def confidence_table(rows: Sequence[Row]) -> str:
    """Stated confidences against how often they were right."""
    findings = [(row, item) for row in rows if not row["error"] for item in row["findings"]]
    lines = []
    for low, high in BINS:
        here = [(row, item) for row, item in findings if _in(item["confidence"], low, high)]
        own = [finding_is(row, item) for row, item in here]
        stated = [item["confidence"] for _, item in here]
        named = [
            finding_is(row, item)
            for row, item in findings
            if _in(item["name_confidence"] or 0.0, low, high)
        ]
        lines.append(
            [
                f"{low:g} to {high:g}",
                str(len(own)),
                percent(float(np.mean(stated)), 0) if stated else "-",
                _share([x in NAMED for x in own]),
                _share([x != "wrong" for x in own]),
                str(len(named)),
                _share([x == "right" for x in named]),
            ]
        )
    return table(
        [
            "confidence",
            "findings",
            "stated, mean",
            "right or told as like it",
            "or right family",
            "by the name's confidence",
            "right name",
        ],
        lines,
    )


def _in(value: float, low: float, high: float) -> bool:
    return low <= value < high or (high == 1.0 and value >= 1.0)
