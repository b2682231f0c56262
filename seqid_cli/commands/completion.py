"""`seqid completion`: scripts, made from the parsers, that complete without starting Python."""

import re
import sys
from collections.abc import Mapping, Sequence
from functools import partial
from typing import Any, Literal

import typer
from typer.core import TyperOption

from seqid_cli.commands.options import command


@command(
    "shell",
    "seqid completion bash > ~/.local/share/bash-completion/completions/seqid",
    "seqid completion fish > ~/.config/fish/completions/seqid.fish",
)
def completion(
    context: typer.Context,
    shell: Literal["bash", "zsh", "fish"] = typer.Argument(
        ..., metavar="bash|zsh|fish", help="Which shell."
    ),
) -> int:
    """Print the completion script of a shell."""
    sys.stdout.write(script(shell, all_words()))
    return 0


def all_words() -> dict[str, dict[str, Any]]:
    """Return what every command offers, asked of its parser.

    For each command its help, its flags (spellings, help, whether they take a value,
    and which: any file where there are no choices), and the choices of its first
    argument.
    """
    from seqid_cli.commands.app import COMMANDS, load_command

    words = {}
    for name, (_, text) in COMMANDS.items():
        flags, firsts = [], []
        for param in load_command(name).params:
            choices = tuple(getattr(param.type, "choices", ()))
            if isinstance(param, TyperOption):
                flags.append(
                    _flag(param.opts, param.help or "", not param.is_flag, choices)
                )
            else:
                firsts.append(choices)
        flags.append(_flag(["-h", "--help"], "Show the help."))
        words[name] = {"help": text, "flags": flags, "choices": firsts[0]}
    return words


def _flag(
    spellings: Sequence[str],
    text: str,
    takes_value: bool = False,
    choices: Sequence[str] = (),
) -> dict[str, Any]:
    return {
        "spellings": spellings,
        "help": text,
        "takes_value": takes_value,
        "choices": choices,
    }


def script(shell: str, words: Mapping[str, Mapping[str, Any]]) -> str:
    """Return a script for a shell, of what every command offers."""
    from seqid_cli.templates import filled

    flags = [
        flag for own in words.values() for flag in own["flags"] if flag["takes_value"]
    ]
    unique = {tuple(flag["spellings"]): flag for flag in flags}
    content = {"commands": words, "valued": list(unique.values())}
    filters = {
        "quoted": lambda text: "'" + text.replace("'", "'\\''") + "'",
        "zsh_text": partial(re.sub, r"([\[\]:\\])", r"\\\1"),
    }
    return filled(
        "seqid_cli.commands", f"completion.{shell}.j2", content, filters=filters
    )
