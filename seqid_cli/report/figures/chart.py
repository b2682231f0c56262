"""Panels with axes, the base of every plot of the report.

A drawing is one `<svg role="img">` with title and description. Lines carry their name, unit and
the values at both ends of their axis, from which the page's script reads values back.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field

from markupsafe import Markup

from seqid_cli.report.figures.svg import (
    Attributes,
    Point,
    Scale,
    element,
    joined,
    label,
    line,
    points_text,
    rect,
    tick_texts,
)


@dataclass(frozen=True)
class Box:
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

    def line(self, points: Iterable[Point], style: str, *, name: str = "", unit: str = "") -> None:
        """Draw a line through value points; with a name the script reads values from it."""
        text = points_text((self.x(x), self.y(y)) for x, y in points)
        if not text:
            return
        data = {"data-name": name, "data-unit": unit} if name else {}
        self._marks.append(element("polyline", {"class": f"line {style}", "points": text, **data}))

    def band(self, low: Sequence[Point], high: Sequence[Point], style: str) -> None:
        """Fill between two lines."""
        if not low:
            return
        around = [*low, *reversed(high)]
        text = points_text((self.x(x), self.y(y)) for x, y in around)
        self._marks.append(element("polygon", {"class": f"band {style}", "points": text}))

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
        marks = joined(self._marks)
        if self.hover:
            attributes["data-x"] = f"{self.hover}|{_ends(self.x)}"
            attributes["data-y"] = _ends(self.y)
            marks = self._window(marks)
        return element("g", attributes, *self._axes(), marks, *self._words)

    def _window(self, marks: Markup) -> Markup:
        """Return a drawing of its own over the panel: another view box zooms into it."""
        box = self.box
        sides = {"x": box.left, "y": box.top, "width": box.width, "height": box.height}
        view = " ".join(f"{side:.1f}" for side in sides.values())
        inside = {"class": "marks", "viewBox": view, "preserveAspectRatio": "none"}
        return element("svg", {**inside, **sides}, marks)

    def _axes(self) -> list[Markup]:
        box, up, along = self.box, [], []
        y_ticks = self.y.ticks(self.y_ticks) if self.y_ticks else []
        for tick, text in zip(y_ticks, _texts(y_ticks, self.y_log), strict=True):
            at = self.y(tick)
            up.append(line("grid zero" if tick == 0.0 else "grid", box.left, at, box.right, at))
            up.append(label(box.left - 6, at + 4, text, "end"))
        x_ticks = self.x.ticks(self.x_ticks)
        for place, (tick, text) in enumerate(zip(x_ticks, _texts(x_ticks, False), strict=True)):
            at = self.x(tick)
            along.append(line("tick", at, box.bottom, at, box.bottom + 4))
            if self.show_x:
                along.append(label(at, box.bottom + 18, text, "middle", "odd" if place % 2 else ""))
        parts = [
            element("g", {"class": "ticks-y"}, *up),
            element("g", {"class": "ticks-x"}, *along),
        ]
        parts.append(line("axis", box.left, box.bottom, box.right, box.bottom))
        if self.x_title and self.show_x:
            parts.append(label(box.right, box.bottom + 37, self.x_title, "end", "axis-title"))
        if self.y_title:
            parts.append(label(box.left - 6, box.top - 9, self.y_title, "start", "axis-title"))
        return parts


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
    }
    if readable:
        attributes["tabindex"] = "0"
    inside = [panel.render() if isinstance(panel, Panel) else panel for panel in panels]
    named = [element("title", {}, title), element("desc", {}, description)]
    return element("svg", attributes, joined([*named, *inside]))


def _ends(scale: Scale) -> str:
    kind = "log" if scale.log else "lin"
    return f"{scale.low:.9g}|{scale.high:.9g}|{scale.start:.1f}|{scale.end:.1f}|{kind}"


def _texts(ticks: Sequence[float], log: bool) -> list[str]:
    texts = [f"{tick:g}" for tick in ticks] if log else tick_texts(ticks)
    return [text.replace("-", "\u2212") for text in texts]
