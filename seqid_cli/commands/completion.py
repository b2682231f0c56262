"""`seqid completion`: scripts, made from the parsers, that complete without starting Python."""

import re
import sys
from collections.abc import Mapping
from functools import partial
from typing import Annotated, Literal, NamedTuple

import typer

EXAMPLES = (
    "seqid completion bash > ~/.local/share/bash-completion/completions/seqid",
    "seqid completion fish > ~/.config/fish/completions/seqid.fish",
)

Shell = Annotated[
    Literal["bash", "zsh", "fish"], typer.Argument(metavar="bash|zsh|fish", help="Which shell.")
]


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


def run(shell: Shell) -> int:
    """Print the completion script of a shell."""
    sys.stdout.write(script(shell, all_words()))
    return 0


def all_words() -> dict[str, Words]:
    """Return what every command offers, asked of its parser."""
    from seqid_cli.commands.app import COMMANDS, load_command

    words = {}
    for name, entry in COMMANDS.items():
        params = load_command(name).params
        flags = [
            Flag(tuple(param.opts), param.help or "", not param.is_flag, _choices(param))
            for param in params
            if isinstance(param, typer.core.TyperOption)
        ]
        flags.append(Flag(("-h", "--help"), "Show the help."))
        arguments = (p for p in params if isinstance(p, typer.core.TyperArgument))
        words[name] = Words(entry.help, tuple(flags), _choices(next(arguments, None)))
    return words


def _choices(param: typer.core.TyperOption | typer.core.TyperArgument | None) -> tuple[str, ...]:
    return tuple(getattr(param.type, "choices", ())) if param else ()


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
