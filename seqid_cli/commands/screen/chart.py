"""A curve as a few lines of text, for terminals and logs of pipelines."""

from __future__ import annotations

from collections.abc import Sequence

from seqid_cli.commands.screen.render import number

_COLUMNS = 56
_ROWS = 7


def text_chart(
    x: Sequence[float],
    y: Sequence[float],
    after: Sequence[float] = (),
    *,
    x_label: str,
    y_label: str,
) -> list[str]:
    """Draw y (`*`) and what it is `after` something (`o`) over x, with the ranges at the axes.

    Nothing below two points. Points that fall into one column are averaged; x need not be even or
    sorted.
    """
    if len(x) < 2 or min(x) == max(x):
        return []
    curves = [("o", _column_means(x, after))] if after else []
    curves.append(("*", _column_means(x, y)))
    every = [value for _, means in curves for value in means.values()]
    low, high = min(every), max(every)
    rows = [[" "] * _COLUMNS for _ in range(_ROWS)]
    for mark, means in curves:
        for column, value in means.items():
            share = (value - low) / (high - low) if high > low else 0.5
            rows[_ROWS - 1 - round(share * (_ROWS - 1))][column] = mark
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
