"""Markdown tables, the statistics in them, and where they go in a document."""

import re
import sys
from collections.abc import Callable, Mapping, Sequence
from typing import TypeVar

import numpy as np
from numpy.typing import ArrayLike

from tests import ROOT

T = TypeVar("T")


def rms(values: ArrayLike) -> float:
    return float(np.sqrt(np.mean(np.square(np.asarray(values, dtype=np.float64)))))


def share_within(z: ArrayLike, limit: float) -> float:
    return float(np.mean(np.abs(np.asarray(z, dtype=np.float64)) <= limit))


def number(value: float, digits: int = 2) -> str:
    """A number with `digits` significant digits, without an exponent where that stays
    short.
    """
    if not np.isfinite(value):
        return "-"
    if value == 0.0:
        return "0"
    places = digits - 1 - int(np.floor(np.log10(abs(value))))
    return f"{value:.{max(places, 0)}f}" if places <= 6 else f"{value:.{digits - 1}e}"


def table(header: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    """A Markdown table; first column to the left, others to the right."""
    for row in rows:
        if len(row) != len(header):
            raise ValueError(
                f"row {row[0]!r} has {len(row)} cells, the header {len(header)}"
            )
    rule = ["---", *["---:"] * (len(header) - 1)]
    return "\n".join("| " + " | ".join(row) + " |" for row in [header, rule, *rows])


def grouped(
    title: str,
    groups: Mapping[str, Sequence[T]],
    columns: Mapping[str, Callable[[Sequence[T]], str]],
) -> str:
    """A table with a row per group that is not empty, a cell per column; "" without any
    row.
    """
    rows = [
        [name, *(cell(group) for cell in columns.values())]
        for name, group in groups.items()
        if group
    ]
    return table([title, *columns], rows) if rows else ""


def counted(cases: Sequence[T]) -> str:
    return str(len(cases))


def show(page: str, name: str, content: str, *, kept: bool) -> None:
    """Print the content of study `name`; where it is `kept`, put it into a page of
    docs/, such as evidence/coverage.md.
    """
    sys.stdout.write(content + "\n")
    if kept:
        path = ROOT / "docs" / page
        path.write_text(
            placed(path.read_text(encoding="utf-8"), name, content), encoding="utf-8"
        )


def placed(document: str, name: str, content: str) -> str:
    """The document with `content` between the markers of study `name`."""
    start, end = f"<!-- study:{name} -->", "<!-- /study -->"
    pattern = re.compile(
        re.escape(start) + r"(?:(?!<!-- study:).)*?" + re.escape(end), re.DOTALL
    )
    if document.count(start) != 1 or not pattern.search(document):
        raise ValueError(
            f"the document needs {start} and {end}, once, around the tables"
        )
    return pattern.sub(lambda _: f"{start}\n{content.strip()}\n{end}", document)
