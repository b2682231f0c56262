"""What the user sees: results on stdout, everything else on stderr."""

import os
import sys
from collections.abc import Sequence
from dataclasses import dataclass, field

import typer

from seqid_cli import shares
from seqid_cli.commands.screen import layout
from seqid_cli.params.encode import encode
from seqid_cli.params.results.tables import Values


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

    def table(self, columns: layout.Row, rows: Sequence[layout.Row]) -> None:
        """Print a result as a table."""
        if self.json or not rows:
            return
        cells = [[layout.visible_cell(cell) for cell in row] for row in rows]
        width = layout.width_of(sys.stdout)
        sys.stdout.write(layout.format_table(columns, cells, width=width, color=self.color))

    def values(self, found: Values) -> None:
        """Print values under their heads."""
        heads = [f"{head.title} {head.unit}".rstrip() for head in found.heads]
        self.table(heads, found.cells(number, percent))

    def result(self, line: str) -> None:
        """Print one line of the result."""
        if not self.json:
            shown = layout.folded(layout.visible(line), layout.width_of(sys.stdout))
            sys.stdout.write(f"{shown}\n")

    def document(self, document: object) -> None:
        """Print the result as JSON where that was asked for."""
        if self.json:
            sys.stdout.write(layout.visible(encode(document)))

    def warn(self, message: str) -> None:
        """Say what may be wrong, once."""
        if message not in self.said:
            self.said.add(message)
            line = f"seqid {self.command}: warning: {layout.visible(message)}"
            sys.stderr.write(layout.folded(line, layout.width_of(sys.stderr)) + "\n")

    def remark(self, *messages: str) -> None:
        """Say what a result remarks, unless it was said before."""
        for message in messages:
            if message not in self.said:
                self.said.add(message)
                self.note(layout.folded(f"note: {message}", layout.width_of(sys.stderr)))

    def note(self, message: str) -> None:
        """Say what is good to know."""
        if not self.quiet:
            sys.stderr.write(f"{layout.visible(message)}\n")

    def detail(self, message: str) -> None:
        """Say what only `-v` asks for."""
        if self.verbose:
            sys.stderr.write(f"{layout.visible(message)}\n")


def screen_of(context: typer.Context) -> Screen:
    """Return the screen that the command line and the environment ask for."""
    given = context.params
    plain = given["no_color"] or os.environ.get("NO_COLOR") or os.environ.get("TERM") == "dumb"
    flags = {name: given[name] for name in ("quiet", "verbose", "json")}
    return Screen(context.info_name or "", **flags, color=not plain and sys.stdout.isatty())


def number(value: float | None, digits: int = 3) -> str:
    """Return a number for people, with a dash where there is none."""
    return "-" if value is None else f"{value:.{digits}g}"


def percent(share: float | None) -> str:
    """Return a share in percent."""
    return "-" if share is None else shares.percent(share)
