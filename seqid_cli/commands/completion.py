"""`seqid completion`: scripts, made from the parsers, that complete without starting Python."""

import re
import sys
from collections.abc import Mapping
from functools import partial
from typing import Annotated, Literal, NamedTuple

import typer
from typer.core import TyperArgument, TyperOption

from seqid_cli.commands.options import command


class Flag(NamedTuple):
    """One option: all its spellings, its help, the words it takes (none: any file)."""

    spellings: tuple[str, ...]
    help: str
    takes_value: bool = False
    choices: tuple[str, ...] = ()

    @property
    def spelled(self) -> str:
        """All spellings as words."""
        return " ".join(self.spellings)


class Words(NamedTuple):
    """What can follow a command's name."""

    help: str
    flags: tuple[Flag, ...]
    choices: tuple[str, ...]  # of its first argument, if it takes no files


@command(
    "shell",
    "seqid completion bash > ~/.local/share/bash-completion/completions/seqid",
    "seqid completion fish > ~/.config/fish/completions/seqid.fish",
)
def completion(
    context: typer.Context,
    shell: Annotated[
        Literal["bash", "zsh", "fish"], typer.Argument(metavar="bash|zsh|fish", help="Which shell.")
    ],
) -> int:
    """Print the completion script of a shell."""
    sys.stdout.write(script(shell, all_words()))
    return 0


def all_words() -> dict[str, Words]:
    """Return what every command offers, asked of its parser."""
    from seqid_cli.commands.app import COMMANDS, load_command

    words = {}
    for name, entry in COMMANDS.items():
        flags, firsts = [], []
        for param in load_command(name).params:
            choices = tuple(getattr(param.type, "choices", ()))
            if isinstance(param, TyperOption):
                flags.append(Flag(tuple(param.opts), param.help or "", not param.is_flag, choices))
            elif isinstance(param, TyperArgument):
                firsts.append(choices)
        flags.append(Flag(("-h", "--help"), "Show the help."))
        words[name] = Words(entry.help, tuple(flags), firsts[0])
    return words


def script(shell: str, words: Mapping[str, Words]) -> str:
    """Return a script for a shell, of what every command offers."""
    from seqid_cli.templates import filled

    valued = [flag for own in words.values() for flag in own.flags if flag.takes_value]
    unique = {flag.spellings: flag for flag in valued}.values()
    content = {"commands": words, "valued": list(unique)}
    filters = {
        "quoted": lambda text: "'" + text.replace("'", "'\\''") + "'",
        "zsh_text": partial(re.sub, r"([\[\]:\\])", r"\\\1"),
    }
    return filled("seqid_cli.commands", f"completion.{shell}.j2", content, filters=filters)
