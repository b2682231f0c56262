"""Text and tables that fit the screen, whatever the names from logs and files in them hold.

Lines break at words, no number is cut, and nothing steers the terminal.
"""

import os
import re
import shutil
import textwrap
from collections.abc import Sequence
from itertools import zip_longest
from typing import TextIO

Row = Sequence[str]
GAP = "  "
NARROWEST, NAME = 40, 16  # characters of a screen; of text that gives way to numbers
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
    columns: Row, rows: Sequence[Row], *, width: int | None = None, color: bool = False
) -> str:
    """Return aligned columns: text to the left, numbers to the right.

    `width`: characters in a line. The widest texts give way, names in their middle and sentences at
    their words; columns that still have no room come in a further table, with the first columns
    that tell the rows apart.
    """
    lines = [columns, *rows]
    numeric, widths, least = [], [], []
    for head, *cells in zip(*lines, strict=True):
        longest, words = max(map(len, cells)), max(map(len, head.split()), default=0)
        numeric.append(all(map(is_number, cells)))
        widths.append(max(longest, len(head)))
        least.append(max(words, longest if numeric[-1] else min(longest, NAME)))
    keys = 1 if len({row[0] for row in rows}) == len(rows) else 2
    while width is not None and sum(widths) + len(GAP) * (len(widths) - 1) > width:
        wide = [(widths[k], k) for k in range(len(widths)) if widths[k] > least[k]]
        if wide:
            widths[max(wide)[1]] -= 1
        elif len(widths) > keys + 1:
            del widths[-1], least[-1]
        else:
            break
    kept = len(widths)
    text = "".join(_line(x[:kept], widths, numeric, color, k == 0) for k, x in enumerate(lines))
    if kept == len(columns):
        return text
    more = [[*line[:keys], *line[kept:]] for line in lines]
    return f"{text}\n{format_table(more[0], more[1:], width=width, color=color)}"


def is_number(cell: str) -> bool:
    """Whether a cell is a number, with its unit or percent sign, or the dash for none."""
    return cell == "-" or cell.rstrip(" %").replace(".", "", 1).lstrip("+-<> ")[:1].isdigit()


def _line(
    cells: Row, widths: Sequence[int], numeric: Sequence[bool], color: bool, head: bool
) -> str:
    parts = [_wrapped(cell, width) for cell, width in zip(cells, widths, strict=True)]
    codes = [_code(cell, head) if color else "" for cell in cells]
    text = ""
    for pieces in zip_longest(*parts, fillvalue=""):
        padded = [
            piece.rjust(width) if right else piece.ljust(width)
            for piece, width, right in zip(pieces, widths, numeric, strict=False)
        ]
        padded[-1] = padded[-1].rstrip()
        shown = [f"{c}{p}\x1b[0m" if c else p for c, p in zip(codes, padded, strict=True)]
        text += GAP.join(shown).rstrip() + "\n"
    return text


def _code(cell: str, head: bool) -> str:
    """Return what colours a cell."""
    if head:
        return "\x1b[1m"
    if cell == "good":
        return "\x1b[32m"
    return "\x1b[33m" if cell.startswith(("usable", "poor")) else ""


def _wrapped(text: str, width: int, indent: str = "") -> list[str]:
    if len(text) <= width:
        return [text]
    if not indent:
        text = " ".join(shortened(word, width) for word in text.split(" "))
    return textwrap.wrap(
        text, width, subsequent_indent=indent, break_long_words=False, break_on_hyphens=False
    )


def visible(text: str) -> str:
    """Return a text with such characters written out as JSON does, by their number."""
    return _STEERING.sub(lambda found: f"\\u{ord(found[0]):04x}", text)


def visible_cell(text: str) -> str:
    """Return a text that is one line of a table as well."""
    return visible(text).replace("\n", "\\n").replace("\t", "\\t")
