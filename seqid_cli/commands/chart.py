"""A curve as a few lines of text, for terminals and logs of pipelines."""

from __future__ import annotations

from collections.abc import Sequence

from seqid_cli.commands.render import number

_COLUMNS = 56
_ROWS = 7


def text_chart(x: Sequence[float], y: Sequence[float], *, x_label: str, y_label: str) -> list[str]:
    """Draw y over x, with the ranges of both at the axes; nothing below two points.

    Points that fall into one column are averaged; x need not be even or sorted.
    """
    if len(x) < 2 or min(x) == max(x):
        return []
    means = _column_means(x, y)
    low, high = min(means.values()), max(means.values())
    rows = [[" "] * _COLUMNS for _ in range(_ROWS)]
    for column, value in means.items():
        share = (value - low) / (high - low) if high > low else 0.5
        rows[_ROWS - 1 - round(share * (_ROWS - 1))][column] = "*"
    labels = [number(high), *[""] * (_ROWS - 2), number(low)]
    width = max(map(len, labels))
    left, right = number(min(x)), number(max(x))
    margin = " " * (width + 2)
    return [
        f"{margin}{y_label}",
        *(
            f"{label.rjust(width)} |{''.join(row)}".rstrip()
            for label, row in zip(labels, rows, strict=True)
        ),
        f"{' ' * width} +{'-' * _COLUMNS}",
        f"{margin}{left}{right.rjust(_COLUMNS - len(left))}  {x_label}",
    ]


def _column_means(x: Sequence[float], y: Sequence[float]) -> dict[int, float]:
    left, span = min(x), max(x) - min(x)
    columns: dict[int, list[float]] = {}
    for at, value in zip(x, y, strict=True):
        columns.setdefault(round((at - left) / span * (_COLUMNS - 1)), []).append(value)
    return {column: sum(values) / len(values) for column, values in columns.items()}
