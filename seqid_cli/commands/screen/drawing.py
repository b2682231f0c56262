"""Tables and coloured labels, drawn by rich into text.

Import this module where something is drawn, not before: rich takes a twentieth of a
second.

rich writes into a text and never to a stream. Its console ends the process where a
reader has left, and the commands answer that themselves. Names from logs and files are
given as `rich.text.Text`, in which brackets are brackets: rich reads markup in plain
strings alone.
"""

import io
from collections.abc import Mapping, Sequence

from rich.cells import cell_len
from rich.console import Console, RenderableType
from rich.table import Column, Table
from rich.text import Text

from seqid_cli.commands.screen.layout import Label

GAP = 2  # characters between two columns
# A name from a file that is longer than this is broken on a narrow terminal, so that
# the numbers beside it have room.
UNBROKEN = 16

HEAD_STYLE = "bold"
LABEL_STYLES: Mapping[Label, str] = {"error": "bold red", "warning": "yellow"}


def table_text(
    heads: Sequence[str],
    rows: Sequence[Sequence[str]],
    *,
    width: int | None = None,
    whole_words: bool = True,
    color: bool = False,
) -> str:
    """Return aligned columns: text to the left, numbers to the right.

    The widest texts give way and are broken at their words; no number is broken.
    Columns that still have no room come in a further table, behind the first columns,
    which tell the rows apart.

    Parameters
    ----------
    heads : sequence of str
        The heads of the columns, K of them.
    rows : sequence of sequences of str
        K cells each; at least one row.
    width : int, optional
        Characters in a line; None where nothing limits it.
    whole_words : bool
        Break no word, so that paths can be searched for and copied. Else words of more
        than `UNBROKEN` characters are broken where room is short.
    color : bool
        Write the codes of a terminal: bold heads, verdicts in colour.

    Returns
    -------
    str
        The lines of the table, each with its end.
    """
    cells_of_columns = list(zip(*rows, strict=True))
    numeric = [all(map(is_number, cells)) for cells in cells_of_columns]
    natural, least = [], []
    for head, cells, is_numeric in zip(heads, cells_of_columns, numeric, strict=True):
        natural.append(max(map(cell_len, (head, *cells))))
        least.append(_least_width(head, cells, is_numeric, whole_words))

    # Rows are told apart by the first column, or by the first two where it repeats.
    key_count = 1 if len(set(cells_of_columns[0])) == len(rows) else 2
    shown_count = len(heads)
    if width is not None:
        while shown_count > key_count + 1 and _table_width(least[:shown_count]) > width:
            shown_count -= 1
    widths = _narrowed(natural[:shown_count], least[:shown_count], width)

    columns = [
        Column(
            header=Text(head),
            header_style=HEAD_STYLE,
            justify="right" if is_numeric else "left",
            overflow="fold",
            width=column_width,
        )
        for head, is_numeric, column_width in zip(heads, numeric, widths, strict=False)
    ]
    table = Table(*columns, box=None, padding=(0, GAP // 2), pad_edge=False)
    for row in rows:
        table.add_row(*(Text(cell, cell_style(cell)) for cell in row[:shown_count]))
    text = _drawn(table, width=_table_width(widths), color=color)
    if shown_count == len(heads):
        return text

    further_heads, *further_rows = (
        [*line[:key_count], *line[shown_count:]] for line in (heads, *rows)
    )
    further = table_text(
        further_heads,
        further_rows,
        width=width,
        whole_words=whole_words,
        color=color,
    )
    return f"{text}\n{further}"


def is_number(cell: str) -> bool:
    """Return whether a cell is a number, maybe with its unit, or the dash for none."""
    digits = cell.rstrip(" %").replace(".", "", 1).lstrip("+-<> ")
    return cell == "-" or digits[:1].isdigit()


def cell_style(cell: str) -> str:
    """Return the style of a cell: verdicts have a colour."""
    if cell == "good":
        return "green"
    return "yellow" if cell.startswith(("usable", "poor")) else ""


def with_colored_label(text: str, label: Label, *, start: int) -> str:
    """Return a message with the `label` that begins at `start` in its colour.

    Lines stay as long as they are: a terminal wraps them itself, and copies them whole.
    """
    text = text.expandtabs()  # as rich does, so that the width is that of what it draws
    drawn = Text(text)
    drawn.stylize(LABEL_STYLES[label], start, start + len(label))
    longest_line = max(map(cell_len, text.split("\n")))
    return _drawn(drawn, width=longest_line, color=True).removesuffix("\n")


def _least_width(
    head: str, cells: Sequence[str], is_numeric: bool, whole_words: bool
) -> int:
    """Return the width below which a column is not to be narrowed."""
    longest_cell = max(map(cell_len, cells))
    least = longest_cell if is_numeric else min(longest_cell, UNBROKEN)
    if whole_words:
        least = max(least, *(_longest_word(cell) for cell in cells))
    return max(least, _longest_word(head))


def _longest_word(text: str) -> int:
    return max(map(cell_len, text.split()), default=0)


def _table_width(widths: Sequence[int]) -> int:
    return sum(widths) + GAP * (len(widths) - 1)


def _narrowed(
    natural: Sequence[int], least: Sequence[int], width: int | None
) -> list[int]:
    """Return the widths of columns in a line of `width`, taken from the widest first.

    rich narrows columns as well, but below their longest word, which it then cuts.
    """
    widths = list(natural)
    while width is not None and _table_width(widths) > width:
        can_give = [k for k in range(len(widths)) if widths[k] > least[k]]
        if not can_give:
            break
        widest = max(can_give, key=lambda k: (widths[k], k))
        widths[widest] -= 1
    return widths


def _drawn(content: RenderableType, *, width: int, color: bool) -> str:
    """Return what rich draws, without the blanks that it fills lines up with."""
    stream = io.StringIO()
    _console(stream, width=width, color=color).print(content)
    return "".join(f"{line.rstrip()}\n" for line in stream.getvalue().split("\n")[:-1])


def _console(stream: io.StringIO, *, width: int, color: bool) -> Console:
    """Return a console that asks neither the environment nor the terminal."""
    return Console(
        file=stream,
        width=width,
        force_terminal=color,
        force_jupyter=False,
        color_system="standard" if color else None,
        no_color=not color,
        legacy_windows=False,
        markup=False,
        emoji=False,
        highlight=False,
    )
