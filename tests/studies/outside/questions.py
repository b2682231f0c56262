"""What each group asks of an answer, as questions that are met or not."""

from typing import Any

import numpy as np

from tests.studies.outside.score import (
    Row,
    finding_is,
    here,
    label,
    of_position,
    silent,
)

LOUD = float(np.nextafter(0.8, 1.0))  # confidence of wrong names that count: above 0.8
NAMED = {"right", "alike"}
EDGE_S = 0.3  # by which an edge of a push may be off
EDGE_SHARE = 0.15  # or this share of its length, where that is more
CONTACT = "external_contact"


def answers_to(row: Row) -> dict[str, bool]:
    """Return the questions of a row's group that apply, and whether each is met."""
    if not row["kinds"]:
        return {"clean arm: nothing told": silent(row)}
    asked = {"pushes": _of_pushes, "changes": _of_changes, "foreign": _of_foreign}
    return asked.get(row["group"], _of_one_effect)(row)


def _of_one_effect(row: Row) -> dict[str, bool]:
    worth = label(row, 0)
    shown = {"one effect that shows: its name, or told as like it": worth in NAMED}
    return (shown if worth != "little left" else {}) | {
        "one effect, whether or not it shows": worth in NAMED
    }


def _of_changes(row: Row) -> dict[str, bool]:
    worth = label(row, 0)
    met = worth in NAMED or among_causes(row)
    shown = {"a change that shows: its name, told as like it, or a cause": met}
    return (shown if worth != "little left" else {}) | {
        "a change, whether or not it shows": met
    }


def among_causes(row: Row) -> bool:
    """Whether the values have changed, with the hidden effect among the causes."""
    (kind,), (joint,) = row["kinds"], row["joints"]
    return row["verdict"] == "values_changed" and any(
        effect == kind and here(at, joint) for _, effect, at, _ in row["causes"]
    )


def _of_foreign(row: Row) -> dict[str, bool]:
    worth = label(row, 0)
    unexplained = row["verdict"] == "unexplained" and worth == "quantity"
    wrong = any(finding_is(row, finding) == "wrong" for finding in row["findings"])
    shown = {"a law that shows: unexplained, over the right quantity": unexplained}
    return (shown if worth != "little left" else {}) | {
        "unexplained over the right quantity, or nothing named wrong": (
            unexplained or not wrong
        )
    }


def _of_pushes(row: Row) -> dict[str, bool]:
    named = any(finding["effect"] == CONTACT for finding in row["findings"])
    others = [item for item in row["findings"] if finding_is(row, item) == "wrong"]
    others += [part for part in row["unexplained"] if not of_position(row, part[1])]
    events = [_interval(event) for event in row["events"]]
    seen = [any(_overlaps(push, event) for event in events) for push in row["pushes"]]
    exact = [any(_is_when(push, event) for event in events) for push in row["pushes"]]
    beside = [e for e in events if not any(_overlaps(p, e) for p in row["pushes"])]
    return {
        "every push told, with its start and its end": named and all(exact),
        "every push told": named and all(seen),
        "nothing told beside": not (others or beside),
    }


def _interval(event: list[Any]) -> tuple[str, float, float]:
    log, start, end, _ = event
    return str(log).rpartition("/")[2], start, end


def _overlaps(push: list[Any], event: tuple[str, float, float]) -> bool:
    (log, start, end), (name, begin, stop) = push, event
    return bool(log == name and begin < end and start < stop)


def _is_when(push: list[Any], event: tuple[str, float, float]) -> bool:
    """Whether an event has a push's log, start and end."""
    (log, start, end), (name, begin, stop) = push, event
    off = max(EDGE_S, EDGE_SHARE * (end - start))
    return bool(log == name and abs(begin - start) <= off and abs(stop - end) <= off)
