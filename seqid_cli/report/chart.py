"""Drawings as SVG text: panels with axes, the base of every plot, and charts with a row per name.

A drawing is one `<svg role="img">` with title and description; every value in it is
escaped. Coordinates are user units of the drawing, y downwards; colours come from the
classes of the page's style sheet, so that one drawing serves light and dark. Lines
carry their name, unit and the values at both ends of their axis, from which the page's
script reads values back.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, NamedTuple

import numpy as np
from markupsafe import Markup, escape

from seqid_cli.report.views import Figure, Legend, Table
from seqid_cli.report.words import MINUS, number
from seqid_cli.typing import Array

WIDE, SMALL = 580.0, 372.0  # widths of drawings
_LEFT, _RIGHT, _TOP, _FOOT = 62.0, 12.0, 26.0, 44.0  # around a panel
_ROW, _NAMES, _LONGEST = 28.0, 150.0, 20  # height, width and letters of a row's name
Numbers = Sequence[float] | Array
# style and value, by the name of the row
Dots = Mapping[str, Sequence[tuple[str, float]]]


def element(name: str, /, *children: str, **attributes: str | float) -> Markup:
    """Return one element; text is escaped, children made by this function are not again.

    `name` and the attributes' names (`class_`, `text_anchor`) come from the program,
    never from a file; an attribute without text is left out.
    """
    start = f"<{name}"
    for key, value in attributes.items():
        text = value if isinstance(value, str) else short(value)
        if text:
            start += f' {key.rstrip("_").replace("_", "-")}="{escape(text)}"'
    inside = "".join(map(escape, children))
    return Markup(f"{start}>{inside}</{name}>" if children else f"{start}/>")


def line(style: str, x1: float, y1: float, x2: float, y2: float) -> Markup:
    """Return a straight line."""
    return element("line", class_=style, x1=x1, y1=y1, x2=x2, y2=y2)


def label(
    x: float, y: float, text: str, anchor: str = "start", style: str = ""
) -> Markup:
    """Return a piece of text."""
    return element("text", text, x=x, y=y, text_anchor=anchor, class_=style)


def short(value: float) -> str:
    """Return a coordinate to a tenth of a unit."""
    return f"{value:.1f}".removesuffix(".0")


def padded(values: Numbers, share: float = 0.05) -> tuple[float, float]:
    """Return limits a little wider than the values; their width is never zero."""
    low, high = (
        float(np.min(values, initial=np.inf)),
        float(np.max(values, initial=-np.inf)),
    )
    if not (math.isfinite(low) and math.isfinite(high)):
        return -1.0, 1.0
    span = high - low
    if span <= 1e-12 * max(abs(low), abs(high)):
        span = max(abs(low), abs(high)) or 1.0
    return low - share * span, high + share * span


@dataclass(frozen=True)
class Scale:
    """Maps values `low`..`high` to drawing coordinates `start`..`end`, straight or by decades."""

    low: float
    high: float
    start: float
    end: float
    log: bool = False

    def __call__(self, value: float) -> float:
        """Return the coordinate of a value; values beyond the ends are held there."""
        low, high, at = self.low, self.high, value
        if self.log:
            low, high, at = (
                math.log10(low),
                math.log10(high),
                math.log10(max(value, 1e-300)),
            )
        share = (at - low) / (high - low) if high > low else 0.5
        return self.start + min(max(share, 0.0), 1.0) * (self.end - self.start)

    def ticks(self, count: int) -> list[tuple[float, str]]:
        """Return about `count` round values inside (decades if logarithmic), and as text."""
        low, high = self.low, self.high
        if self.log:
            first, last = (
                math.ceil(math.log10(low) - 1e-9),
                math.floor(math.log10(high) + 1e-9),
            )
            every = max(1, math.ceil((last - first + 1) / 6))
            found = [10.0**k for k in range(first, last + 1, every)]
        elif not 1e-290 < (raw := (high - low) / max(count, 1)) < 1e290:
            found = [low, high]
        else:
            power = 10.0 ** math.floor(math.log10(raw))
            steps = (power, 2.0 * power, 5.0 * power)
            step = next(
                (step for step in steps if step >= raw * (1 - 1e-9)), 10.0 * power
            )
            first, last = math.ceil(low / step - 1e-9), math.floor(high / step + 1e-9)
            found = [k * step for k in range(first, last + 1)]
        return [(tick, f"{tick:.10g}".replace("-", MINUS)) for tick in found if count]

    @property
    def ends(self) -> str:
        """What the page's script reads values by."""
        kind = "log" if self.log else "lin"
        return f"{self.low:.9g}|{self.high:.9g}|{self.start:.1f}|{self.end:.1f}|{kind}"


class Box(NamedTuple):
    """Where a panel lies in its drawing."""

    left: float
    top: float
    right: float
    bottom: float


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
    marks: list[Markup] = field(default_factory=list)
    words: list[Markup] = field(default_factory=list)

    def __post_init__(self) -> None:
        """Fix the scales."""
        self.x = Scale(*self.x_range, self.box.left, self.box.right)
        self.y = Scale(*self.y_range, self.box.bottom, self.box.top, self.y_log)

    def line(
        self, x: Numbers, y: Numbers, style: str, *, name: str = "", unit: str = ""
    ) -> None:
        """Draw a line through points; with a name the script reads values from it."""
        if len(x):
            own = {"class_": f"line {style}", "points": self._points(x, y)}
            named = {"data_name": name, "data_unit": unit or " "} if name else {}
            self.marks.append(element("polyline", **own, **named))

    def band(self, x: Numbers, low: Numbers, high: Numbers, style: str) -> None:
        """Fill between two lines over the same x."""
        if len(x):
            text = self._points([*x, *reversed(x)], [*low, *reversed([*high])])
            self.marks.append(element("polygon", class_=f"band {style}", points=text))

    def span(self, low: float, high: float, style: str, tooltip: str = "") -> None:
        """Shade an interval of x over the whole height; `tooltip` shows when it is pointed at."""
        x, y, height = self.x(low), self.box.top, self.box.bottom - self.box.top
        inside = [element("title", tooltip)] if tooltip else []
        own = {"x": x, "y": y, "width": max(self.x(high) - x, 1.0), "height": height}
        self.marks.append(element("rect", *inside, class_=f"span {style}", **own))

    def upright(self, value: float, style: str) -> None:
        """Draw a vertical line at a value."""
        at = self.x(value)
        self.marks.append(line(f"rule {style}", at, self.box.top, at, self.box.bottom))

    def render(self) -> Markup:
        """Return axes and marks; what the page's script reads values by, and what it zooms."""
        marks, data = Markup("").join(self.marks), {}
        if self.hover:
            data = {"data_x": f"{self.hover}|{self.x.ends}", "data_y": self.y.ends}
            # A drawing of its own over the panel: another view box zooms into it.
            x, y, right, bottom = self.box
            sides = {"x": x, "y": y, "width": right - x, "height": bottom - y}
            view = " ".join(f"{side:.1f}" for side in sides.values())
            inside = {"class_": "marks", "viewBox": view, "preserveAspectRatio": "none"}
            marks = element("svg", marks, **inside, **sides)
        return element("g", *self._axes(), marks, *self.words, class_="panel", **data)

    def _points(self, x: Numbers, y: Numbers) -> str:
        points = (
            (self.x(float(a)), self.y(float(b))) for a, b in zip(x, y, strict=True)
        )
        return " ".join(f"{short(a)},{short(b)}" for a, b in points)

    def _axes(self) -> list[Markup]:
        box, up, along = self.box, [], []
        for tick, text in self.y.ticks(self.y_ticks):
            at = self.y(tick)
            up.append(
                line(
                    "grid zero" if tick == 0.0 else "grid", box.left, at, box.right, at
                )
            )
            up.append(label(box.left - 6, at + 4, text, "end"))
        for place, (tick, text) in enumerate(self.x.ticks(self.x_ticks)):
            at = self.x(tick)
            along.append(line("tick", at, box.bottom, at, box.bottom + 4))
            if self.show_x:
                along.append(
                    label(
                        at, box.bottom + 18, text, "middle", "odd" if place % 2 else ""
                    )
                )
        return [
            element("g", *up, class_="ticks-y"),
            element("g", *along, class_="ticks-x"),
            line("axis", box.left, box.bottom, box.right, box.bottom),
            label(box.right, box.bottom + 37, self.x_title, "end", "axis-title"),
            label(box.left - 6, box.top - 9, self.y_title, "start", "axis-title"),
        ]


def small_panel(
    x: tuple[str, str],
    x_range: tuple[float, float],
    y_title: str,
    y_range: tuple[float, float],
    *,
    height: float = 150.0,
    **more: Any,
) -> Panel:
    """Return the axes of a small drawing; `x` is name and unit."""
    box = Box(_LEFT, _TOP, SMALL - _RIGHT, _TOP + height)
    own = {"x_ticks": 4, "hover": "|".join(x), **more}
    return Panel(box, x_range, y_range, ", ".join(filter(None, x)), y_title, **own)


def wide_box(top: float, height: float) -> Box:
    """Return the place of a panel in a wide drawing."""
    return Box(_LEFT, top, WIDE - _RIGHT, top + height)


def figure(
    panels: Sequence[Panel],
    title: str,
    text: str,
    legend: Legend,
    table: Table | None,
    *,
    name: str = "",
    note: str = "",
) -> Figure:
    """Return a drawing of panels with its values; `name` is its short title."""
    box = panels[-1].box
    wide, readable = box.right + _RIGHT > SMALL, any(panel.hover for panel in panels)
    svg = element(
        "svg",
        element("title", title),
        element("desc", text),
        *(panel.render() for panel in panels),
        class_="plot readable" if readable else "plot",
        viewBox=f"0 0 {box.right + _RIGHT:.0f} {box.bottom + _FOOT:.0f}",
        role="img",
        tabindex="0" if readable else "",  # the keyboard reaches what can be read
    )
    return Figure(name or title, svg, legend, table, note, wide)


def dots(
    title: str, rows: Dots, x_title: str, legend: Legend, *, mark: float = 0.0
) -> Figure | None:
    """Draw a row of joined dots per name; a `mark` crosses all rows.

    None where there are none.
    """
    if not rows:
        return None
    far = max([mark, *(value for points in rows.values() for _, value in points)])
    box = Box(_NAMES, 8.0, WIDE - _RIGHT, 8.0 + _ROW * len(rows))
    panel = Panel(
        box, (0.0, padded([0.0, far or 1.0])[1]), (0.0, 1.0), x_title, y_ticks=0
    )
    if mark:
        panel.upright(mark, "floor")
    for k, (name, points) in enumerate(rows.items()):
        y, x = box.top + _ROW * (k + 0.5), [panel.x(value) for _, value in points]
        text = name if len(name) <= _LONGEST else f"{name[: _LONGEST - 1]}\u2026"
        panel.words.append(label(_NAMES - 10, y + 4, text, "end", "row"))
        panel.marks.append(line("dumbbell", min(x), y, max(x), y))
        for (style, _), at in zip(points, x, strict=True):
            panel.marks.append(element("circle", class_=style, cx=at, cy=y, r=5))
    said = (
        f"{name}: {', '.join(number(x) for _, x in own)}" for name, own in rows.items()
    )
    return figure([panel], title, "; ".join(said), legend, None)
