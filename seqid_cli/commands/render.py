"""What the user sees: results on stdout, everything else on stderr."""

from __future__ import annotations

import os
import sys
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field

import typer

from seqid_cli import shares
from seqid_cli.commands.options import screen_flag
from seqid_cli.commands.visible import visible, visible_cell
from seqid_cli.params.encode import encode

Row = Sequence[str]


@dataclass(frozen=True)
class Screen:
    """How one command talks to its user.

    With `json`, stdout carries one JSON document and nothing else.
    """

    command: str
    quiet: bool = False
    verbose: bool = False
    json: bool = False
    color: bool = False
    said: set[str] = field(default_factory=set)  # of warnings and remarks, each once

    def table(self, columns: Row, rows: Sequence[Row]) -> None:
        """Print a result as a table."""
        if self.json or not rows:
            return
        cells = [[visible_cell(cell) for cell in row] for row in rows]
        sys.stdout.write(rich_table(columns, cells) if self.color else plain_table(columns, cells))

    def result(self, line: str) -> None:
        """Print one line of the result."""
        if not self.json:
            sys.stdout.write(visible(line) + "\n")

    def document(self, document: object) -> None:
        """Print the result as JSON where that was asked for."""
        if self.json:
            sys.stdout.write(visible(encode(document)))

    def warn(self, message: str) -> None:
        """Say what may be wrong, once."""
        if message not in self.said:
            self.said.add(message)
            sys.stderr.write(f"seqid {self.command}: warning: {visible(message)}\n")

    def knows(self, messages: Iterable[str]) -> None:
        """Keep messages from being said: they were, in other words."""
        self.said.update(messages)

    def remark(self, message: str) -> None:
        """Say what a result remarks, unless it was said before."""
        if message not in self.said:
            self.said.add(message)
            self.note(f"note: {message}")

    def note(self, message: str) -> None:
        """Say what is good to know."""
        if not self.quiet:
            sys.stderr.write(f"{visible(message)}\n")

    def detail(self, message: str) -> None:
        """Say what only `-v` asks for."""
        if self.verbose:
            sys.stderr.write(f"{visible(message)}\n")


def screen_of(context: typer.Context) -> Screen:
    """Return the screen that the command line and the environment ask for, or a caller's own."""
    if isinstance(context.obj, Screen):
        return context.obj
    return Screen(
        command=context.info_name or "",
        quiet=screen_flag(context, "quiet"),
        verbose=screen_flag(context, "verbose"),
        json=screen_flag(context, "json"),
        color=not screen_flag(context, "no_color") and _terminal_has_color(),
    )


def number(value: float | None, digits: int = 3) -> str:
    """Return a number for people, with a dash where there is none."""
    return "-" if value is None else f"{value:.{digits}g}"


def limits(interval: Sequence[float]) -> str:
    """Return an interval for people, with a dash where there is none."""
    return f"{number(interval[0])} to {number(interval[1])}" if interval else "-"


def percent(share: float | None) -> str:
    """Return a share in percent."""
    return "-" if share is None else shares.percent(share)


def plain_table(columns: Row, rows: Sequence[Row]) -> str:
    """Return aligned columns: text to the left, numbers to the right."""
    lines = [columns, *rows]
    widths = [max(len(line[i]) for line in lines) for i in range(len(columns))]
    numeric = [all(_is_number(row[i]) for row in rows) for i in range(len(columns))]
    text = ""
    for line in lines:
        cells = zip(line, widths, numeric, strict=True)
        padded = [cell.rjust(width) if right else cell.ljust(width) for cell, width, right in cells]
        text += "  ".join(padded).rstrip() + "\n"
    return text


def rich_table(columns: Row, rows: Sequence[Row]) -> str:
    """Return the same table for a terminal with colours."""
    from rich.console import Console
    from rich.table import Table
    from rich.text import Text

    table = Table(box=None, pad_edge=False, header_style="bold")
    for index, column in enumerate(columns):
        right = all(_is_number(row[index]) for row in rows)
        table.add_column(Text(column), justify="right" if right else "left")
    for row in rows:
        table.add_row(*(Text(cell, style=_style(cell)) for cell in row))
    console = Console(force_terminal=True)
    with console.capture() as capture:
        console.print(table)
    return capture.get()


def _style(cell: str) -> str:
    if cell == "good":
        return "green"
    return "yellow" if cell.startswith("poor") else ""


def _is_number(cell: str) -> bool:
    return cell == "-" or cell.rstrip(" %").replace(".", "", 1).lstrip("+-<> ")[:1].isdigit()


def _terminal_has_color() -> bool:
    if os.environ.get("NO_COLOR") or os.environ.get("TERM") == "dumb":
        return False
    return sys.stdout.isatty()
