"""A chart with one row per joint or log, values to the right."""

from __future__ import annotations

from collections.abc import Sequence

from markupsafe import Markup

from seqid_cli.report.figures.chart import Box, Panel, drawing
from seqid_cli.report.figures.svg import circle, line, padded, rect

_WIDTH, _LEFT, _TOP, _ROW = 640.0, 150.0, 8.0, 28.0
_LONGEST = 20  # letters of a row's name


class RowChart:
    """Rows are numbered from the top; `high` is the largest value of x, which starts at zero."""

    def __init__(self, names: Sequence[str], high: float, x_title: str) -> None:
        self._height = _ROW * len(names)
        box = Box(_LEFT, _TOP, _WIDTH - _LEFT - 20, self._height)
        limits = (0.0, padded(0.0, high, 0.06)[1] if high > 0.0 else 1.0)
        self._panel = Panel(box, limits, (0.0, 1.0), x_title=x_title, y_ticks=0)
        for row, name in enumerate(names):
            text = name if len(name) <= _LONGEST else name[: _LONGEST - 1] + "\u2026"
            self._panel.text(_LEFT - 10, self._y(row) + 4, text, "end", "row")

    def mark(self, value: float, style: str) -> None:
        """Draw a line through all rows at a value."""
        x, box = self._panel.x(value), self._panel.box
        self._panel.add(line(f"rule {style}", x, box.top, x, box.bottom))

    def bar(self, row: int, low: float, high: float, style: str, tooltip: str = "") -> None:
        """Draw a bar from one value to another; `tooltip` shows when it is pointed at."""
        left, right = self._panel.x(low), self._panel.x(high)
        width = max(right - left, 1.5)
        self._panel.add(rect(style, left, self._y(row) - 7, width, 14, tooltip=tooltip))

    def dot(self, row: int, value: float, style: str) -> None:
        """Draw a dot at a value."""
        self._panel.add(circle(style, self._panel.x(value), self._y(row), 5))

    def link(self, row: int, low: float, high: float, style: str) -> None:
        """Draw a line between two values."""
        y = self._y(row)
        self._panel.add(line(style, self._panel.x(low), y, self._panel.x(high), y))

    def render(self, title: str, description: str) -> Markup:
        """Return the drawing."""
        return drawing(_WIDTH, self._height + _TOP + 44, title, description, [self._panel])

    def _y(self, row: int) -> float:
        return _TOP + _ROW * (row + 0.5)
