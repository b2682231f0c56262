"""SVG as text: elements whose every value is escaped, scales and their ticks.

Coordinates are user units of the drawing, y downwards; colours come from the classes of the page's
style sheet, so that one drawing serves light and dark.
"""

import itertools
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from markupsafe import Markup, escape

Value = str | float | int
Attributes = dict[str, Value]
Point = tuple[float, float]


def element(name: str, attributes: Mapping[str, Value], *children: str) -> Markup:
    """Return one element; text is escaped, children made by this function are not again.

    `name` and the attributes' names come from the program, never from a file.
    """
    texts = {key: x if isinstance(x, str) else short(x) for key, x in attributes.items()}
    parts = [f'{key}="{escape(text)}"' for key, text in texts.items()]
    start = " ".join([name, *parts])
    if not children:
        return Markup(f"<{start}/>")
    inside = "".join(escape(child) for child in children)
    return Markup(f"<{start}>{inside}</{name}>")


def line(style: str, x1: float, y1: float, x2: float, y2: float) -> Markup:
    """Return a straight line."""
    return element("line", {"class": style, "x1": x1, "y1": y1, "x2": x2, "y2": y2})


def circle(style: str, x: float, y: float, radius: float) -> Markup:
    """Return a circle."""
    return element("circle", {"class": style, "cx": x, "cy": y, "r": radius})


def rect(
    style: str, x: float, y: float, width: float, height: float, *, tooltip: str = ""
) -> Markup:
    """Return a rectangle; `tooltip` shows when it is pointed at."""
    inside = [element("title", {}, tooltip)] if tooltip else []
    corner: Attributes = {"class": style, "x": x, "y": y, "width": width, "height": height}
    return element("rect", corner, *inside)


def label(x: float, y: float, text: str, anchor: str = "start", style: str = "") -> Markup:
    """Return a piece of text."""
    attributes: Attributes = {"x": x, "y": y, "text-anchor": anchor}
    if style:
        attributes["class"] = style
    return element("text", attributes, text)


def short(value: float) -> str:
    """Return a coordinate to a tenth of a unit."""
    text = f"{value:.1f}"
    return text[:-2] if text.endswith(".0") else text


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
            low, high, at = math.log10(low), math.log10(high), math.log10(max(value, 1e-300))
        share = (at - low) / (high - low) if high > low else 0.5
        return self.start + min(max(share, 0.0), 1.0) * (self.end - self.start)

    def ticks(self, count: int) -> list[tuple[float, str]]:
        """Return about `count` round values inside (decades if logarithmic), and as text."""
        if not count:
            return []
        ticks = _decades(self.low, self.high) if self.log else _steps(self.low, self.high, count)
        texts = [f"{tick:g}" for tick in ticks] if self.log else _texts(ticks)
        return [
            (tick, text.replace("-", "\u2212")) for tick, text in zip(ticks, texts, strict=True)
        ]


def _steps(low: float, high: float, count: int) -> list[float]:
    """Multiples of 1, 2 or 5 times a power of ten between the limits."""
    raw = (high - low) / count
    if not high > low:
        return [low]
    if not 1e-290 < raw < 1e290:
        return [low, high]
    power = 10.0 ** math.floor(math.log10(raw))
    step = next((k * power for k in (1.0, 2.0, 5.0) if k * power >= raw * (1 - 1e-9)), 10 * power)
    first, last = math.ceil(low / step - 1e-9), math.floor(high / step + 1e-9)
    if last - first > 10 * count:  # so narrow beside its values that steps get lost in rounding
        return [low, high]
    return [k * step for k in range(first, last + 1)]


def _decades(low: float, high: float) -> list[float]:
    first, last = math.ceil(math.log10(low) - 1e-9), math.floor(math.log10(high) + 1e-9)
    whole = [10.0**k for k in range(first, last + 1, max(1, math.ceil((last - first + 1) / 6)))]
    if len(whole) >= 2:
        return whole
    between = [m * 10.0**k for k in range(first - 1, last + 2) for m in (1.0, 2.0, 5.0)]
    return [value for value in between if low <= value <= high] or [low, high]


def _texts(ticks: Sequence[float]) -> list[str]:
    """Ticks with the digits that separate the closest two."""
    gaps = [abs(b - a) for a, b in itertools.pairwise(ticks) if b != a]
    largest = max(map(abs, ticks))
    if not gaps or not largest:
        return [f"{tick:.3g}" for tick in ticks]
    digits = max(0, math.ceil(math.log10(largest / min(gaps)) - 1e-9))
    if largest < 1e-3 or (largest >= 1e5 and digits <= 3):
        return ["0" if not tick else f"{tick:.{digits}e}" for tick in ticks]
    decimals = max(0, -math.floor(math.log10(min(gaps)) + 1e-9))
    return [f"{tick:.{decimals}f}" for tick in ticks]


def padded(low: float, high: float, share: float = 0.05) -> tuple[float, float]:
    """Return limits a little wider than the values; their width is never zero."""
    if not (math.isfinite(low) and math.isfinite(high)):
        return -1.0, 1.0
    span = high - low
    if span <= 1e-12 * max(abs(low), abs(high)):
        span = max(abs(low), abs(high)) or 1.0
    return low - share * span, high + share * span
