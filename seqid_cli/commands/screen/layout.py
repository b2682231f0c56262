"""Text and tables that fit the screen, whatever the names from logs and files in them hold.

Lines break at words, no number is cut, and nothing steers the terminal.
"""

import os
import re
import shutil
import textwrap
from collections.abc import Callable, Sequence
from itertools import zip_longest
from typing import TextIO

Row = Sequence[str]
GAP = "  "
NARROWEST, NAME, SENTENCE = 40, 20, 12  # characters of a screen; of what gives way to numbers
REASON = 2  # lines of a cell, beyond which a reason stands below
# Controls but for tab and new line, marks that turn the direction of text, halves of characters.
_STEERING = re.compile(
    "[\x00-\x08\x0b-\x1f\x7f-\x9f\u061c\u200b-\u200f\u2028-\u202e\u2060-\u2069\ufeff\ud800-\udfff]"
)


def width_of(stream: TextIO) -> int | None:
    """Characters in a line, by COLUMNS or the terminal; None where nothing limits it."""
    given = os.environ.get("COLUMNS", "")
    if given.isdigit():
        return max(NARROWEST, int(given))
    return max(NARROWEST, shutil.get_terminal_size().columns) if stream.isatty() else None


def folded(line: str, width: int | None) -> str:
    """Break a line at words, the rest of it indented."""
    if width is None or len(line) <= width:
        return line
    indent = line[: len(line) - len(line.lstrip())]
    return "\n".join(_wrapped(line, width, indent + GAP * 2))


def shortened(text: str, width: int) -> str:
    """Leave out the middle of a name that is too long."""
    if len(text) <= width:
        return text
    begin = (width - 3) // 4  # names of logs differ at their ends
    return f"{text[:begin]}...{text[len(text) - (width - 3 - begin) :]}"


def format_table(
    columns: Row,
    rows: Sequence[Row],
    *,
    width: int | None = None,
    style: Callable[[str, bool], str] | None = None,
) -> str:
    """Return aligned columns: text to the left, numbers to the right.

    `width`: characters in a line. Names give way in their middle, sentences and heads at their
    words, long reasons at the end stand below their line; columns that still have no room come in a
    further table, with the first columns that tell the rows apart. `style`: turns the text of a
    cell, and whether it is a head, into the codes put before it.
    """
    numeric = [all(is_number(row[i]) for row in rows) for i in range(len(columns))]
    full = [max(len(line[i]) for line in (columns, *rows)) for i in range(len(columns))]
    need = [_need(columns[i], [row[i] for row in rows], numeric[i]) for i in range(len(columns))]
    if width is None or _total(full) <= width:
        widths, kept = full, len(columns)
    else:
        least = min(_keys(rows) + 1, len(columns))
        kept = next((k for k in range(len(need), least, -1) if _total(need[:k]) <= width), least)
        widths = _given(need[:kept], full[:kept], width)
    text = "".join(
        _line(line[:kept], widths, numeric, [style(c, k == 0) for c in line] if style else [])
        for k, line in enumerate([columns, *rows])
    )
    if kept == len(columns):
        return text
    keys = min(_keys(rows), kept - 1)
    more = [[*line[:keys], *line[kept:]] for line in (columns, *rows)]
    return f"{text}\n{format_table(more[0], more[1:], width=width, style=style)}"


def _keys(rows: Sequence[Row], *, most: int = 2) -> int:
    """How many first columns tell the rows apart, up to `most`."""
    for count in range(1, most):
        if len({tuple(row[:count]) for row in rows}) == len(rows):
            return count
    return most


def is_number(cell: str) -> bool:
    """Whether a cell is a number, with its unit or percent sign, or the dash for none."""
    return cell == "-" or cell.rstrip(" %").replace(".", "", 1).lstrip("+-<> ")[:1].isdigit()


def _total(widths: Sequence[int]) -> int:
    return sum(widths) + len(GAP) * (len(widths) - 1)


def _need(head: str, cells: Sequence[str], numeric: bool) -> int:
    longest = max((len(cell) for cell in cells), default=0)
    words = max((len(word) for word in head.split()), default=0)
    sentence = any(" " in cell and "/" not in cell and "." not in cell for cell in cells)
    least = SENTENCE if sentence else NAME
    return max(words, longest if numeric else min(longest, least))


def _given(need: Sequence[int], full: Sequence[int], width: int) -> list[int]:
    """Share the room that is left, to those first that lack least."""
    widths, spare = list(need), width - _total(need)
    for i in sorted(range(len(need)), key=lambda i: full[i] - need[i]):
        more = max(0, min(spare, full[i] - need[i]))
        widths[i] += more
        spare -= more
    return widths


def _line(cells: Row, widths: Sequence[int], numeric: Sequence[bool], codes: Sequence[str]) -> str:
    below, at, reason = "", *cells[-1].partition(": ")[::2]
    if len(reason) > REASON * widths[-1]:
        indent = GAP * 2
        below = folded(f"{indent}{reason}", _total(widths)) + "\n"
        cells = [*cells[:-1], f"{at}:"]
    parts = [_wrapped(cell, width) for cell, width in zip(cells, widths, strict=True)]
    text = ""
    for pieces in zip_longest(*parts, fillvalue=""):
        padded = [
            piece.rjust(width) if right else piece.ljust(width)
            for piece, width, right in zip(pieces, widths, numeric, strict=False)
        ]
        padded[-1] = padded[-1].rstrip()
        if codes:
            padded = [f"{c}{p}\x1b[0m" if c else p for c, p in zip(codes, padded, strict=False)]
        text += GAP.join(padded).rstrip() + "\n"
    return text + below


def _wrapped(text: str, width: int, indent: str = "") -> list[str]:
    if len(text) <= width:
        return [text]
    return textwrap.wrap(
        " ".join(shortened(word, width) if not indent else word for word in text.split(" ")),
        width,
        subsequent_indent=indent,
        break_long_words=False,
        break_on_hyphens=False,
    )


def visible(text: str) -> str:
    """Return a text with such characters written out as JSON does, by their number."""
    return _STEERING.sub(lambda found: f"\\u{ord(found[0]):04x}", text)


def visible_cell(text: str) -> str:
    """Return a text that is one line of a table as well."""
    return visible(text).replace("\n", "\\n").replace("\t", "\\t")
