"""Figures of a page as files that stand alone: SVG, and PDF by vl-convert.

A drawing on the page has its colours from the page's style sheet and its legend beside
it. A file has both inside, in the colours of the light page on white paper. SVG is
converted to PDF by an extra, as its parts (fonts, a renderer) are large.
"""

import re
from collections.abc import Callable, Sequence
from pathlib import Path

from markupsafe import Markup

from seqid_cli.logs.given import warn
from seqid_cli.params.files import replacing, write_text_atomic, writing
from seqid_cli.report.chart import element, label
from seqid_cli.report.views import Figure, Legend, Page, resource
from seqid_cli.visible import visible

EXTRA = "seqid[figures]"
_FONT = 'text{font-family:Helvetica,Arial,"Liberation Sans",sans-serif}'
_PALETTE = re.compile(r":root\{(.*?)\}", re.DOTALL)
_COLOUR = re.compile(r"--([\w-]+):(#\w+)")
_DARK = re.compile(r"^@media \(prefers-color-scheme:dark\).*?\}\}$", re.DOTALL | re.M)
_VIEW_BOX = re.compile(r'viewBox="0 0 ([0-9]+) ([0-9]+)"')
# Marks of the legend that are areas; the others are lines.
_AREAS = frozenset(
    ["band-residual", "faint", "event", "unused", "before", "after", "plus", "minus"],
)
# Of the legend, in units of the drawing: a line of text, a mark, what lies between.
_LINE, _MARK, _SPACE = 18.0, 18.0, 6.0
_LETTER = 6.2  # mean width of a letter of 12 units


def write_figures(page: Page, folder: Path) -> list[Path]:
    """Write each figure of a page as SVG, and as PDF where the extra is installed.

    Parameters
    ----------
    page : Page
    folder : Path
        Made where it is not there. Names tell the group and the title of a figure.

    Returns
    -------
    list of Path
        The files, in the order of the page.

    Raises
    ------
    UsageError
        The folder cannot be made or written.
    """
    with writing(folder):
        folder.mkdir(parents=True, exist_ok=True)
    to_pdf = _converter()
    paths: list[Path] = []
    for section in page.sections:
        for group in section.groups:
            for figure in filter(None, group.figures):
                path = _free(folder / f"{_slug(group.id, figure.title)}.svg", paths)
                svg = standalone(figure)
                write_text_atomic(path, svg)
                paths.append(path)
                if to_pdf is not None:
                    printed = path.with_suffix(".pdf")
                    with replacing(printed) as temporary, writing(printed):
                        temporary.write_bytes(to_pdf(svg))
                    paths.append(printed)
    if to_pdf is None and paths:
        warn(f"figures are SVG alone; for PDF: pip install '{EXTRA}'")
    return paths


def standalone(figure: Figure) -> str:
    """Return a figure as the text of an SVG file, with its colours and its legend."""
    match = _VIEW_BOX.search(figure.drawing)
    assert match is not None
    width, height = float(match[1]), float(match[2])
    rows = _legend_rows(figure.legend, width)
    total = height + _LINE * len(rows)
    marks: list[str] = []
    for number, row in enumerate(rows):
        marks += _legend_marks(row, y=height + _LINE * number)
    svg = element(
        "svg",
        element("style", Markup(_style())),
        element("rect", width=width, height=total, fill="#ffffff"),
        element("svg", figure.drawing, width=width, height=height),
        *marks,
        xmlns="http://www.w3.org/2000/svg",
        viewBox=f"0 0 {width:.0f} {total:.0f}",
        width=width,
        height=total,
    )
    return visible(f"{svg}\n")


def _style() -> str:
    """Return the style sheet of drawings with the colours of the light page."""
    text = _DARK.sub("", resource("drawing.css"))
    palette = _PALETTE.search(text)
    assert palette is not None
    for name, colour in _COLOUR.findall(palette[1]):
        text = text.replace(f"var(--{name})", colour)
    return _FONT + _PALETTE.sub("", text)


def _legend_rows(legend: Legend, width: float) -> list[list[tuple[str, str]]]:
    """Return the legend's marks and texts in rows that the drawing has place for."""
    rows: list[list[tuple[str, str]]] = []
    left = 0.0
    for style, text in legend.items():
        needed = _width_of(text)
        if not rows or left + needed > width:
            rows.append([])
            left = 0.0
        rows[-1].append((style, text))
        left += needed
    return rows


def _legend_marks(row: Sequence[tuple[str, str]], *, y: float) -> list[Markup]:
    """Draw a row of the legend with its top at y."""
    marks = []
    left = _SPACE
    middle = y + _LINE / 2.0
    for style, text in row:
        if style in _AREAS or style.startswith("heat"):
            mark = element(
                "rect",
                class_=f"key {style}",
                x=left,
                y=middle - 5.0,
                width=_MARK,
                height=10.0,
                fill="currentColor",
            )
        else:
            mark = element(
                "line",
                class_=f"key {style}",
                x1=left,
                y1=middle,
                x2=left + _MARK,
                y2=middle,
                stroke="currentColor",
                stroke_width=4.0 if style == "measured" else 2.0,
                stroke_dasharray="4 3" if style in ("floor", "line-mark") else "",
            )
        marks += [mark, label(left + _MARK + _SPACE, middle + 4.0, text)]
        left += _width_of(text)
    return marks


def _width_of(text: str) -> float:
    """Return the width of a mark of the legend with its text."""
    return _MARK + 3.0 * _SPACE + _LETTER * len(text)


def _slug(*words: str) -> str:
    """Return a name of a file: letters, digits and single dashes."""
    name = re.sub(r"[^a-z0-9]+", "-", "-".join(words).lower())
    return name.strip("-")[:80] or "figure"


def _free(path: Path, taken: Sequence[Path]) -> Path:
    """Return a path that no earlier figure of the page has."""
    free = path
    number = 2
    while free in taken:
        free = path.with_stem(f"{path.stem}-{number}")
        number += 1
    return free


def _converter() -> Callable[[str], bytes] | None:
    """Return what turns SVG into PDF; None where the extra is not installed."""
    try:
        import vl_convert
    except ImportError:
        return None
    # Nothing is fetched for a figure, whatever a name in it looks like.
    return lambda svg: bytes(vl_convert.svg_to_pdf(svg))
