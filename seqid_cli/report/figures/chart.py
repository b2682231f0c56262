"""Panels with axes, the base of every plot of the report, and charts with a row per name.

A drawing is one `<svg role="img">` with title and description. Lines carry their name, unit and
the values at both ends of their axis, from which the page's script reads values back.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, NamedTuple

from markupsafe import Markup

from seqid_cli.report.figures.svg import (
    Attributes,
    Scale,
    circle,
    element,
    label,
    line,
    padded,
    rect,
    short,
)
from seqid_cli.report.views import Figure, Key, Table
from seqid_cli.robot.types import Array

WIDE, SMALL = 580.0, 372.0  # widths of drawings
_LEFT, _RIGHT, _TOP, _FOOT = 62.0, 12.0, 26.0, 44.0  # around a panel
_ROWS_WIDTH, _ROWS_LEFT, _ROWS_TOP, _ROW = 640.0, 150.0, 8.0, 28.0
_LONGEST = 20  # letters of a row's name
Numbers = Sequence[float] | Array


class Box(NamedTuple):
    """Where a panel lies in its drawing."""

    left: float
    top: float
    width: float
    height: float

    @property
    def right(self) -> float:
        """Its right edge."""
        return self.left + self.width

    @property
    def bottom(self) -> float:
        """Its lower edge."""
        return self.top + self.height


@dataclass
class Panel:
    """One pair of axes to draw into; `x` and `y` map values to the drawing."""

    box: Box
    x_range: tuple[float, float]
    y_range: tuple[float, float]
    x_title: str = ""
    y_title: str = ""
    y_log: bool = False
    x_ticks: int = 6
    y_ticks: int = 4
    show_x: bool = True
    hover: str = ""  # name and unit of x for the script, such as "t|s"
    _marks: list[Markup] = field(default_factory=list)
    _words: list[Markup] = field(default_factory=list)

    def __post_init__(self) -> None:
        """Fix the scales."""
        self.x = Scale(*self.x_range, self.box.left, self.box.right)
        self.y = Scale(*self.y_range, self.box.bottom, self.box.top, self.y_log)

    def line(self, x: Numbers, y: Numbers, style: str, *, name: str = "", unit: str = "") -> None:
        """Draw a line through points; with a name the script reads values from it."""
        text = self._points(x, y)
        if text:
            data = {"data-name": name, "data-unit": unit} if name else {}
            self.add(element("polyline", {"class": f"line {style}", "points": text, **data}))

    def band(self, x: Numbers, low: Numbers, high: Numbers, style: str) -> None:
        """Fill between two lines over the same x."""
        if len(x):
            text = self._points([*x, *reversed(x)], [*low, *reversed([*high])])
            self.add(element("polygon", {"class": f"band {style}", "points": text}))

    def span(self, low: float, high: float, style: str, title: str = "") -> None:
        """Shade an interval of x over the whole height."""
        left, right = self.x(low), self.x(high)
        width = max(right - left, 1.0)
        self.add(rect(f"span {style}", left, self.box.top, width, self.box.height, tooltip=title))

    def upright(self, value: float, style: str, text: str = "") -> None:
        """Draw a vertical line at a value, with a word at its upper end."""
        at = self.x(value)
        self.add(line(f"rule {style}", at, self.box.top, at, self.box.bottom))
        if text:
            right = at < self.box.left + 0.7 * self.box.width
            where = at + 3 if right else at - 3
            self.text(where, self.box.top + 11, text, "start" if right else "end", "mark")

    def text(self, x: float, y: float, text: str, anchor: str = "start", style: str = "") -> None:
        """Write a word at drawing coordinates."""
        self._words.append(label(x, y, text, anchor, style))

    def add(self, mark: Markup) -> None:
        """Add a finished mark."""
        self._marks.append(mark)

    def render(self) -> Markup:
        """Return axes and marks; what the page's script reads values by, and what it zooms."""
        attributes: Attributes = {"class": "panel"}
        marks = Markup("").join(self._marks)
        if self.hover:
            attributes["data-x"] = f"{self.hover}|{_ends(self.x)}"
            attributes["data-y"] = _ends(self.y)
            # A drawing of its own over the panel: another view box zooms into it.
            view = " ".join(f"{side:.1f}" for side in self.box)
            inside = {"class": "marks", "viewBox": view, "preserveAspectRatio": "none"}
            sides = dict(zip(("x", "y", "width", "height"), self.box, strict=True))
            marks = element("svg", {**inside, **sides}, marks)
        return element("g", attributes, *self._axes(), marks, *self._words)

    def _points(self, x: Numbers, y: Numbers) -> str:
        points = ((self.x(float(a)), self.y(float(b))) for a, b in zip(x, y, strict=True))
        return " ".join(f"{short(a)},{short(b)}" for a, b in points)

    def _axes(self) -> list[Markup]:
        box, up, along = self.box, [], []
        for tick, text in self.y.ticks(self.y_ticks):
            at = self.y(tick)
            up.append(line("grid zero" if tick == 0.0 else "grid", box.left, at, box.right, at))
            up.append(label(box.left - 6, at + 4, text, "end"))
        for place, (tick, text) in enumerate(self.x.ticks(self.x_ticks)):
            at = self.x(tick)
            along.append(line("tick", at, box.bottom, at, box.bottom + 4))
            if self.show_x:
                along.append(label(at, box.bottom + 18, text, "middle", "odd" if place % 2 else ""))
        parts = [
            element("g", {"class": "ticks-y"}, *up),
            element("g", {"class": "ticks-x"}, *along),
            line("axis", box.left, box.bottom, box.right, box.bottom),
        ]
        if self.x_title and self.show_x:
            parts.append(label(box.right, box.bottom + 37, self.x_title, "end", "axis-title"))
        if self.y_title:
            parts.append(label(box.left - 6, box.top - 9, self.y_title, "start", "axis-title"))
        return parts


def small_panel(
    x: tuple[str, str],
    x_range: tuple[float, float],
    y_title: str,
    y_range: tuple[float, float],
    *,
    height: float = 150.0,
    read: bool = True,
    **more: Any,
) -> Panel:
    """Return the axes of a small drawing; `x` is name and unit, `read` whether it can be read."""
    return Panel(
        Box(_LEFT, _TOP, SMALL - _LEFT - _RIGHT, height),
        x_range,
        y_range,
        ", ".join(filter(None, x)),
        y_title,
        hover="|".join(x) if read else "",
        **{"x_ticks": 4, **more},
    )


def wide_box(top: float, height: float) -> Box:
    """Return the place of a panel in a wide drawing."""
    return Box(_LEFT, top, WIDE - _LEFT - _RIGHT, height)


def small_figure(
    panel: Panel, title: str, text: str, legend: Sequence[Key], table: Table, *, name: str = "",
    note: str = "",
) -> Figure:  # fmt: skip
    """Return a small drawing with its values; `name` is its short title."""
    svg = drawing(SMALL, panel.box.bottom + _FOOT, title, text, [panel])
    return Figure(name or title, svg, legend, table, note)


def drawing(
    width: float,
    height: float,
    title: str,
    description: str,
    panels: Sequence[Panel | Markup],
    *,
    style: str = "plot",
) -> Markup:
    """Return a whole drawing; the keyboard can reach it if it has panels to read."""
    readable = any(isinstance(panel, Panel) and panel.hover for panel in panels)
    attributes: Attributes = {
        "class": style + (" readable" if readable else ""),
        "viewBox": f"0 0 {width:.0f} {height:.0f}",
        "role": "img",
        **({"tabindex": "0"} if readable else {}),
    }
    inside = [panel.render() if isinstance(panel, Panel) else panel for panel in panels]
    named = (element("title", {}, title), element("desc", {}, description))
    return element("svg", attributes, *named, *inside)


class RowChart:
    """One row per name from the top, values to the right, up to `high`; x starts at zero."""

    def __init__(self, names: Sequence[str], high: float, x_title: str) -> None:
        self._height = _ROW * len(names)
        box = Box(_ROWS_LEFT, _ROWS_TOP, _ROWS_WIDTH - _ROWS_LEFT - 20, self._height)
        limits = (0.0, padded(0.0, high, 0.06)[1] if high > 0.0 else 1.0)
        self._panel = Panel(box, limits, (0.0, 1.0), x_title=x_title, y_ticks=0)
        for row, name in enumerate(names):
            text = name if len(name) <= _LONGEST else name[: _LONGEST - 1] + "\u2026"
            self._panel.text(_ROWS_LEFT - 10, self._y(row) + 4, text, "end", "row")

    def mark(self, value: float, style: str) -> None:
        """Draw a line through all rows at a value."""
        self._panel.upright(value, style)

    def bar(self, row: int, low: float, high: float, style: str, tooltip: str = "") -> None:
        """Draw a bar from one value to another; `tooltip` shows when it is pointed at."""
        left, right = self._panel.x(low), self._panel.x(high)
        width = max(right - left, 1.5)
        self._panel.add(rect(style, left, self._y(row) - 7, width, 14, tooltip=tooltip))

    def dots(self, row: int, values: Mapping[str, float] | Sequence[float]) -> None:
        """Draw dots at values, by their styles, and a line between the outermost."""
        points = values.items() if isinstance(values, Mapping) else [("after", x) for x in values]
        y, x = self._y(row), [self._panel.x(value) for _, value in points]
        if len(x) > 1:
            self._panel.add(line("dumbbell", min(x), y, max(x), y))
        for (style, _), at in zip(points, x, strict=True):
            self._panel.add(circle(style, at, y, 5))

    def figure(self, title: str, text: str, legend: Sequence[Key], *, name: str = "") -> Figure:
        """Return the drawing; `name` is its short title."""
        height = self._height + _ROWS_TOP + _FOOT
        svg = drawing(_ROWS_WIDTH, height, title, text, [self._panel])
        return Figure(name or title, svg, legend, wide=True)

    def _y(self, row: int) -> float:
        return _ROWS_TOP + _ROW * (row + 0.5)


def _ends(scale: Scale) -> str:
    kind = "log" if scale.log else "lin"
    return f"{scale.low:.9g}|{scale.high:.9g}|{scale.start:.1f}|{scale.end:.1f}|{kind}"
