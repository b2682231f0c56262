"""Text that suits a stream: lines of its width, names that do not steer its terminal.

Nothing here draws: `drawing` does, with rich, which is imported when something is
drawn.
"""

import os
import shutil
import textwrap
from typing import Literal, TextIO

from seqid_cli.visible import visible

Label = Literal["error", "warning"]  # what a message begins with, in colour

# Below so many characters no table is readable, so the terminal breaks the lines.
NARROWEST = 40
HANGING_INDENT = " " * 4  # of the second and further lines of a sentence


def width_of(stream: TextIO) -> int | None:
    """Return the characters in a line, by COLUMNS or the terminal.

    None where nothing limits a line: no terminal shows it and COLUMNS does not ask for
    it.
    """
    columns = os.environ.get("COLUMNS", "")
    if columns.isdigit():
        return max(NARROWEST, int(columns))
    if not stream.isatty():
        return None
    return max(NARROWEST, shutil.get_terminal_size().columns)


def can_be_steered(stream: TextIO) -> bool:
    """Whether colours and controls of a terminal may be written to a stream.

    A terminal has to listen, and neither NO_COLOR nor a TERM of `dumb` may forbid it.
    """
    forbidden = os.environ.get("NO_COLOR") or os.environ.get("TERM") == "dumb"
    return stream.isatty() and not forbidden


def folded(text: str, stream: TextIO) -> str:
    """Break the lines of a text that are too long for a stream at words.

    No word is broken or cut, as rich would do with those longer than a line: they are
    paths, and commands to copy.
    """
    width = width_of(stream)
    if width is None:
        return text
    return "\n".join(_folded_line(line, width) for line in text.split("\n"))


def _folded_line(line: str, width: int) -> str:
    if len(line) <= width:
        return line
    indent = line[: len(line) - len(line.lstrip())]
    pieces = textwrap.wrap(
        line,
        width,
        subsequent_indent=indent + HANGING_INDENT,
        break_long_words=False,
        break_on_hyphens=False,
    )
    return "\n".join(pieces)


def shortened(text: str, width: int) -> str:
    """Leave out the middle of a text that is longer than `width`."""
    if len(text) <= width:
        return text
    dots = "..."
    begin = (width - len(dots)) // 4  # more of the end: names of logs differ there
    end = width - len(dots) - begin
    return f"{text[:begin]}{dots}{text[len(text) - end :]}"


def visible_cell(text: str) -> str:
    """Return a text that steers nothing and is one line of a table."""
    return visible(text).replace("\n", "\\n").replace("\t", "\\t")
