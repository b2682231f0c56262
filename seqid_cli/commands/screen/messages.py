"""Warnings and errors on stderr, their label in colour on a terminal.

The command group needs this before any command is imported, so it imports little.
"""

import sys

from seqid_cli.commands.screen.layout import Label, folded
from seqid_cli.visible import visible


def write_warning(command: str, message: str, *, color: bool) -> None:
    """Write a warning of a command, broken at words on a narrow screen."""
    begin = f"{command}: "
    text = folded(visible(f"{begin}warning: {message}"), sys.stderr)
    _write(text, "warning", at=len(begin), color=color)


def write_error(command: str, message: str, hint: str = "", *, color: bool) -> None:
    """Write an error of a command and what to do.

    Lines stay as long as they are, so that the commands in them can be copied.
    """
    begin = f"{command}: "
    text = visible(f"{begin}error: {message}")
    _write(text, "error", at=len(begin), color=color)
    if hint:
        sys.stderr.write(visible(f"  hint: {hint}\n"))


def _write(text: str, label: Label, *, at: int, color: bool) -> None:
    if color:
        from seqid_cli.commands.screen.drawing import with_colored_label

        text = with_colored_label(text, label, start=at)
    sys.stderr.write(f"{text}\n")
