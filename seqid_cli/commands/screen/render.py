"""What the user sees: results on stdout, everything else on stderr."""

import sys
from collections.abc import Sequence
from dataclasses import dataclass, field

from seqid_cli import shares
from seqid_cli.commands.screen import layout
from seqid_cli.commands.screen.messages import write_error, write_warning
from seqid_cli.params.encode import encode
from seqid_cli.params.results.tables import Values
from seqid_cli.visible import visible


@dataclass(frozen=True, kw_only=True)
class Screen:
    """How one command talks to its user.

    With `json`, stdout carries one JSON document and nothing else. `color` is of
    stdout, `color_messages` of stderr. `already_said` are the warnings and remarks,
    each of which is said once.
    """

    command: str
    quiet: bool = False
    verbose: bool = False
    json: bool = False
    color: bool = False
    color_messages: bool = False
    already_said: set[str] = field(default_factory=set)

    def table(self, columns: Sequence[str], rows: Sequence[Sequence[str]]) -> None:
        """Print a result as a table."""
        if self.json or not rows:
            return
        from seqid_cli.commands.screen.drawing import table_text

        visible_rows = []
        for row in rows:
            visible_rows.append([layout.visible_cell(cell) for cell in row])
        text = table_text(
            [layout.visible_cell(head) for head in columns],
            visible_rows,
            width=layout.width_of(sys.stdout),
            whole_words=not sys.stdout.isatty(),
            color=self.color,
        )
        sys.stdout.write(text)

    def values(self, values: Values) -> None:
        """Print values under their heads."""
        heads = [f"{head.title} {head.unit}".rstrip() for head in values.heads]
        self.table(heads, values.cells(number, percent))

    def result(self, line: str) -> None:
        """Print one line of the result."""
        if not self.json:
            sys.stdout.write(f"{layout.folded(visible(line), sys.stdout)}\n")

    def document(self, document: object) -> None:
        """Print the result as JSON where that was asked for."""
        if self.json:
            sys.stdout.write(visible(encode(document)))

    def warn(self, message: str) -> None:
        """Say what may be wrong, once."""
        if message in self.already_said:
            return
        self.already_said.add(message)
        write_warning(f"seqid {self.command}", message, color=self.color_messages)

    def error(self, message: str, hint: str) -> None:
        """Say why a command could not run, and what to do."""
        name = f"seqid {self.command}"
        write_error(name, message, hint, color=self.color_messages)

    def remark(self, *messages: str) -> None:
        """Say what a result remarks, unless it was said before."""
        for message in messages:
            if message not in self.already_said:
                self.already_said.add(message)
                line = visible(f"note: {message}")
                self.note(layout.folded(line, sys.stderr))

    def note(self, message: str) -> None:
        """Say what is good to know; commands to copy stay in one line."""
        if not self.quiet:
            sys.stderr.write(f"{visible(message)}\n")

    def detail(self, message: str) -> None:
        """Say what only `-v` asks for."""
        if self.verbose:
            sys.stderr.write(f"{visible(message)}\n")


def screen_for(
    command: str, *, quiet: bool, verbose: bool, json: bool, no_color: bool
) -> Screen:
    """Return the screen that a command's flags and the environment ask for."""
    colorful = not no_color
    return Screen(
        command=command,
        quiet=quiet,
        verbose=verbose,
        json=json,
        color=colorful and layout.can_be_steered(sys.stdout),
        color_messages=colorful and layout.can_be_steered(sys.stderr),
    )


def number(value: float | None, digits: int = 3) -> str:
    """Return a number for people, with a dash where there is none."""
    return "-" if value is None else f"{value:.{digits}g}"


def percent(share: float | None) -> str:
    """Return a share in percent."""
    return "-" if share is None else shares.percent(share)
