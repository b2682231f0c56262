"""Drawings as SVG text: panels with axes, and charts with a row per name.

A drawing is one `<svg role="img">` with title and description; every value in it is
escaped. Coordinates are user units of the drawing, y downwards; colours come from the
classes of the page's style sheet, so that one drawing serves light and dark. Lines
carry their name, unit and the values at both ends of their axis, from which the page's
script reads values back.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np
from markupsafe import Markup, escape

from seqid_cli.report.views import Figure, Legend, Table
from seqid_cli.report.words import MINUS, number
from seqid_cli.typing import Array

FULL, WIDE, SMALL = 1160.0, 580.0, 372.0  # widths of drawings
_LEFT, _RIGHT, _TOP, _FOOT = 62.0, 12.0, 26.0, 44.0  # around a panel
_POINT = 2.0  # radius of a measured point
_ROW, _NAMES, _LONGEST = 28.0, 150.0, 20  # height, width and letters of a row's name
Numbers = Sequence[float] | Array
# style and value, by the name of the row
Dots = Mapping[str, Sequence[tuple[str, float]]]


def element(name: str, /, *children: str, **attributes: str | float) -> Markup:
    """Return one element; text is escaped, children made by this function are not.

    Parameters
    ----------
    name : str
        It and the attributes' names (`class_`, `text_anchor`) come from the program,
        never from a file.
    *children : str
    **attributes : str or float
        One without text is left out.

    Returns
    -------
    Markup
    """
    start = f"<{name}"
    for key, value in attributes.items():
        text = value if isinstance(value, str) else short(value)
        if text:
            start += f' {key.rstrip("_").replace("_", "-")}="{escape(text)}"'
    inside = "".join(map(escape, children))
    return Markup(f"{start}>{inside}</{name}>" if children else f"{start}/>")


def line(style: str, x1: float, y1: float, x2: float, y2: float) -> Markup:
    """Return a straight line from (x1, y1) to (x2, y2)."""
    return element("line", class_=style, x1=x1, y1=y1, x2=x2, y2=y2)


def label(
    x: float, y: float, text: str, anchor: str = "start", style: str = ""
) -> Markup:
    """Return a piece of text at (x, y)."""
    return element("text", text, x=x, y=y, text_anchor=anchor, class_=style)


def short(value: float) -> str:
    """Return a coordinate to a tenth of a unit."""
    return f"{value:.1f}".removesuffix(".0")


def padded(values: Numbers, share: float = 0.05) -> tuple[float, float]:
    """Return limits wider than the values by a share; their width is never zero."""
    low = float(np.min(values, initial=np.inf))
    high = float(np.max(values, initial=-np.inf))
    if not (math.isfinite(low) and math.isfinite(high)):
        return -1.0, 1.0
    span = high - low
    largest = max(abs(low), abs(high))
    if span <= 1e-12 * largest:
        span = largest or 1.0
    return low - share * span, high + share * span


@dataclass(frozen=True, kw_only=True)
class Scale:
    """A map from values to coordinates of a drawing, straight or by decades.

    Parameters
    ----------
    low, high : float
        Values at both ends.
    start, end : float
        Coordinates there.
    log : bool
        Whether it goes by decades.
    """

    low: float
    high: float
    start: float
    end: float
    log: bool = False

    def __call__(self, value: float) -> float:
        """Return the coordinate of a value; values beyond the ends are held there."""
        low = self.low
        high = self.high
        if self.log:
            low = math.log10(low)
            high = math.log10(high)
            value = math.log10(max(value, 1e-300))
        share = (value - low) / (high - low) if high > low else 0.5
        return self.start + min(max(share, 0.0), 1.0) * (self.end - self.start)

    def ticks(self, count: int) -> list[tuple[float, str]]:
        """Return about so many round values inside, or decades, and their texts."""
        if not count:
            return []
        values = self._decades() if self.log else self._round_values(count)
        return [(value, f"{value:.10g}".replace("-", MINUS)) for value in values]

    def _decades(self) -> list[float]:
        """Return six powers of ten at most."""
        first = math.ceil(math.log10(self.low) - 1e-9)
        last = math.floor(math.log10(self.high) + 1e-9)
        stride = max(1, math.ceil((last - first + 1) / 6))
        return [10.0**k for k in range(first, last + 1, stride)]

    def _round_values(self, count: int) -> list[float]:
        """Return multiples of 1, 2 or 5 times a power of ten."""
        wanted_step = (self.high - self.low) / max(count, 1)
        # Beyond these sizes powers of ten are not exact, or not finite.
        if not 1e-290 < wanted_step < 1e290:
            return [self.low, self.high]
        power = 10.0 ** math.floor(math.log10(wanted_step))
        step = 10.0 * power
        for round_step in (power, 2.0 * power, 5.0 * power):
            if round_step >= wanted_step * (1 - 1e-9):
                step = round_step
                break
        first = math.ceil(self.low / step - 1e-9)
        last = math.floor(self.high / step + 1e-9)
        return [k * step for k in range(first, last + 1)]

    @property
    def ends(self) -> str:
        """Values and coordinates of both ends, by which the page's script reads."""
        kind = "log" if self.log else "lin"
        return f"{self.low:.9g}|{self.high:.9g}|{self.start:.1f}|{self.end:.1f}|{kind}"


class Box(NamedTuple):
    """Place of a panel in its drawing."""

    left: float
    top: float
    right: float
    bottom: float


@dataclass(kw_only=True)
class Panel:
    """One pair of axes to draw into; `x` and `y` map values to the drawing.

    Parameters
    ----------
    box : Box
    x_range, y_range : pair of float
        Values at the ends of the axes.
    x_title, y_title : str
    y_log : bool
        Whether the y axis goes by decades.
    x_ticks, y_ticks : int
        About how many ticks the axes have.
    show_x : bool
        Whether ticks of the x axis have texts.
    hover : str
        Name and unit of x for the script, such as "t|s"; without it the panel is not
        read.
    marks : list of Markup
        What is drawn inside.
    words : list of Markup
        What is written beside.
    """

    box: Box
    x_range: tuple[float, float]
    y_range: tuple[float, float]
    x_title: str = ""
    y_title: str = ""
    y_log: bool = False
    x_ticks: int = 6
    y_ticks: int = 4
    show_x: bool = True
    hover: str = ""
    marks: list[Markup] = field(default_factory=list)
    words: list[Markup] = field(default_factory=list)

    def __post_init__(self) -> None:
        """Fix the scales."""
        self.x = Scale(
            low=self.x_range[0],
            high=self.x_range[1],
            start=self.box.left,
            end=self.box.right,
        )
        self.y = Scale(
            low=self.y_range[0],
            high=self.y_range[1],
            start=self.box.bottom,
            end=self.box.top,
            log=self.y_log,
        )

    def line(
        self, x: Numbers, y: Numbers, style: str, *, name: str = "", unit: str = ""
    ) -> None:
        """Draw a line through points.

        Parameters
        ----------
        x, y : (N,) float
        style : str
            Class of the line in the style sheet.
        name, unit : str
            With a name the script reads values from the line.
        """
        if not len(x):
            return
        data = {"data_name": name, "data_unit": unit or " "} if name else {}
        mark = element(
            "polyline", class_=f"line {style}", points=self._points(x, y), **data
        )
        self.marks.append(mark)

    def band(self, x: Numbers, low: Numbers, high: Numbers, style: str) -> None:
        """Fill between two lines over the same x."""
        if not len(x):
            return
        points = self._points([*x, *reversed(x)], [*low, *reversed([*high])])
        self.marks.append(element("polygon", class_=f"band {style}", points=points))

    def span(self, low: float, high: float, style: str, tooltip: str = "") -> None:
        """Shade an interval of x over the whole height.

        Parameters
        ----------
        low, high : float
            Ends of the interval.
        style : str
            Class of the interval in the style sheet.
        tooltip : str
            Shows when the interval is pointed at.
        """
        left = self.x(low)
        titles = [element("title", tooltip)] if tooltip else []
        mark = element(
            "rect",
            *titles,
            class_=f"span {style}",
            x=left,
            y=self.box.top,
            width=max(self.x(high) - left, 1.0),
            height=self.box.bottom - self.box.top,
        )
        self.marks.append(mark)

    def points(self, x: Numbers, y: Numbers, half: Numbers, style: str) -> None:
        """Draw measured points with their error bars.

        Parameters
        ----------
        x, y : (N,) float
        half : (N,) float
            Half the length of each bar.
        style : str
            Class of points and bars in the style sheet.
        """
        for at_x, at_y, bar in zip(x, y, half, strict=True):
            centre_x = self.x(float(at_x))
            low, high = self.y(float(at_y - bar)), self.y(float(at_y + bar))
            self.marks.append(line(f"bar-of {style}", centre_x, low, centre_x, high))
            mark = element(
                "circle",
                class_=f"point {style}",
                cx=centre_x,
                cy=self.y(float(at_y)),
                r=_POINT,
            )
            self.marks.append(mark)

    def upright(self, value: float, style: str) -> None:
        """Draw a vertical line at a value of x."""
        at = self.x(value)
        self.marks.append(line(f"rule {style}", at, self.box.top, at, self.box.bottom))

    def render(self) -> Markup:
        """Return axes and marks, with what the page's script reads values by."""
        marks = Markup("").join(self.marks)
        if not self.hover:
            return element("g", *self._axes(), marks, *self.words, class_="panel")

        # A drawing of its own over the panel: another view box zooms into it.
        left, top, right, bottom = self.box
        width = right - left
        height = bottom - top
        zoomable = element(
            "svg",
            marks,
            class_="marks",
            viewBox=f"{left:.1f} {top:.1f} {width:.1f} {height:.1f}",
            preserveAspectRatio="none",
            x=left,
            y=top,
            width=width,
            height=height,
        )
        return element(
            "g",
            *self._axes(),
            zoomable,
            *self.words,
            class_="panel",
            data_x=f"{self.hover}|{self.x.ends}",
            data_y=self.y.ends,
        )

    def _points(self, x: Numbers, y: Numbers) -> str:
        """Return the coordinates of points (N,) as a polyline has them."""
        points = []
        for x_value, y_value in zip(x, y, strict=True):
            at_x = short(self.x(float(x_value)))
            at_y = short(self.y(float(y_value)))
            points.append(f"{at_x},{at_y}")
        return " ".join(points)

    def _axes(self) -> list[Markup]:
        """Return the axes with their ticks and titles."""
        box = self.box
        y_marks = []
        for tick, text in self.y.ticks(self.y_ticks):
            at = self.y(tick)
            style = "grid zero" if tick == 0.0 else "grid"
            y_marks.append(line(style, box.left, at, box.right, at))
            y_marks.append(label(box.left - 6, at + 4, text, "end"))

        x_marks = []
        for place, (tick, text) in enumerate(self.x.ticks(self.x_ticks)):
            at = self.x(tick)
            x_marks.append(line("tick", at, box.bottom, at, box.bottom + 4))
            if self.show_x:
                # On a small screen the style sheet hides every other text.
                style = "odd" if place % 2 else ""
                x_marks.append(label(at, box.bottom + 18, text, "middle", style))
        return [
            element("g", *y_marks, class_="ticks-y"),
            element("g", *x_marks, class_="ticks-x"),
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
    readable: bool = True,
    y_log: bool = False,
) -> Panel:
    """Return the axes of a small drawing.

    Parameters
    ----------
    x : pair of str
        Name and unit of x.
    x_range : pair of float
    y_title : str
    y_range : pair of float
    height : float
        Of the panel.
    readable : bool
        Whether the page's script reads values from its lines.
    y_log : bool
        Whether the y axis goes by decades.

    Returns
    -------
    Panel
    """
    return Panel(
        box=Box(_LEFT, _TOP, SMALL - _RIGHT, _TOP + height),
        x_range=x_range,
        y_range=y_range,
        x_title=", ".join(text for text in x if text),
        y_title=y_title,
        y_log=y_log,
        x_ticks=4,
        hover="|".join(x) if readable else "",
    )


def full_box(top: float, height: float) -> Box:
    """Return the place of a panel in a drawing over the page's full width."""
    return Box(_LEFT, top, FULL - _RIGHT, top + height)


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
    """Return a drawing of panels with its values.

    Parameters
    ----------
    panels : sequence of Panel
        From top to bottom.
    title, text : str
        Title and description of the drawing, which a screen reader reads.
    legend : Legend
    table : Table, optional
        The values.
    name : str
        Short title on the page; `title` if left out.
    note : str
        Text below the drawing.

    Returns
    -------
    Figure
    """
    box = panels[-1].box
    width = box.right + _RIGHT
    is_readable = any(panel.hover for panel in panels)

    # Screen readers read title and description in place of the lines.
    svg = element(
        "svg",
        element("title", title),
        element("desc", text),
        *(panel.render() for panel in panels),
        class_="plot readable" if is_readable else "plot",
        viewBox=f"0 0 {width:.0f} {box.bottom + _FOOT:.0f}",
        role="img",
        tabindex="0" if is_readable else "",  # the keyboard reaches what can be read
    )
    return Figure(
        title=name or title,
        drawing=svg,
        legend=legend,
        table=table,
        note=note,
        width="full" if width > WIDE else "wide" if width > SMALL else "small",
    )


def dots(
    title: str, rows: Dots, x_title: str, legend: Legend, *, mark: float = 0.0
) -> Figure | None:
    """Draw a row of joined dots per name; None where there are none.

    Parameters
    ----------
    title : str
    rows : Dots
        Style and value of each dot, by the name of the row.
    x_title : str
    legend : Legend
    mark : float
        A line crosses all rows there; none at zero.

    Returns
    -------
    Figure or None
    """
    if not rows:
        return None
    values = [mark]
    for points in rows.values():
        values += [value for _, value in points]
    largest = max(values) or 1.0
    box = Box(_NAMES, 8.0, WIDE - _RIGHT, 8.0 + _ROW * len(rows))
    panel = Panel(
        box=box,
        x_range=(0.0, padded([0.0, largest])[1]),
        y_range=(0.0, 1.0),
        x_title=x_title,
        y_ticks=0,
    )
    if mark:
        panel.upright(mark, "floor")

    sentences = []
    for k, (name, points) in enumerate(rows.items()):
        y = box.top + _ROW * (k + 0.5)
        x = [panel.x(value) for _, value in points]
        text = name if len(name) <= _LONGEST else f"{name[: _LONGEST - 1]}\u2026"
        panel.words.append(label(_NAMES - 10, y + 4, text, "end", "row"))
        panel.marks.append(line("dumbbell", min(x), y, max(x), y))
        for (style, _), at in zip(points, x, strict=True):
            panel.marks.append(element("circle", class_=style, cx=at, cy=y, r=5))
        sentences.append(f"{name}: {', '.join(number(value) for _, value in points)}")
    return figure([panel], title, "; ".join(sentences), legend, None)
