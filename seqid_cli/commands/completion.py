"""`seqid completion`: scripts, made from the commands, that complete without Python."""

import re
import sys
from collections.abc import Mapping, Sequence
from functools import partial
from typing import Annotated, Any, Literal

import typer
from typer.core import TyperOption

from seqid_cli.commands.options import (
    DebugOption,
    JsonOption,
    NoColorOption,
    QuietOption,
    VerboseOption,
    command_app,
    examples,
)
from seqid_cli.commands.screen.render import screen_for

app = command_app()


@app.command(
    "completion",
    epilog=examples(
        "seqid completion bash > ~/.local/share/bash-completion/completions/seqid",
        "seqid completion fish > ~/.config/fish/completions/seqid.fish",
    ),
)
def completion(
    shell: Annotated[
        Literal["bash", "zsh", "fish"],
        typer.Argument(metavar="bash|zsh|fish", help="Which shell."),
    ],
    *,
    quiet: QuietOption = False,
    verbose: VerboseOption = False,
    json: JsonOption = False,
    no_color: NoColorOption = False,
    debug: DebugOption = False,
) -> int:
    """Print the completion script of a shell."""
    screen = screen_for(
        "completion", quiet=quiet, verbose=verbose, json=json, no_color=no_color
    )
    text = script(shell, all_words())
    if screen.json:
        screen.document({"shell": shell, "script": text})
    else:
        # As it is: what a shell reads is not folded.
        sys.stdout.write(text)
    return 0


def all_words() -> dict[str, dict[str, Any]]:
    """Return what every command offers.

    For each command its help, its flags (spellings, help, whether they take a value,
    and which: any file where there are no choices), and the choices of its first
    argument.
    """
    from seqid_cli.commands.app import COMMANDS, load_command

    words = {}
    for name, entry in COMMANDS.items():
        flags = []
        choices_of_arguments = []
        for param in load_command(name).params:
            choices = tuple(getattr(param.type, "choices", ()))
            if isinstance(param, TyperOption):
                flag = _flag(
                    param.opts,
                    param.help or "",
                    takes_value=not param.is_flag,
                    choices=choices,
                )
                flags.append(flag)
            else:
                choices_of_arguments.append(choices)
        flags.append(_flag(["-h", "--help"], "Show the help."))
        words[name] = {
            "help": entry.summary,
            "flags": flags,
            "choices": choices_of_arguments[0],
        }
    return words


def _flag(
    spellings: Sequence[str],
    help_text: str,
    *,
    takes_value: bool = False,
    choices: Sequence[str] = (),
) -> dict[str, Any]:
    return {
        "spellings": spellings,
        "help": help_text,
        "takes_value": takes_value,
        "choices": choices,
    }


def script(shell: str, words: Mapping[str, Mapping[str, Any]]) -> str:
    """Return a script for a shell, of what every command offers."""
    from seqid_cli.templates import filled

    # Options of several commands that are spelled alike take the same values.
    flags_with_values = {}
    for offered in words.values():
        for flag in offered["flags"]:
            if flag["takes_value"]:
                flags_with_values[tuple(flag["spellings"])] = flag

    content = {"commands": words, "valued": list(flags_with_values.values())}
    filters = {
        "quoted": lambda text: "'" + text.replace("'", "'\\''") + "'",
        "zsh_text": partial(re.sub, r"([\[\]:\\])", r"\\\1"),
    }
    return filled(
        "seqid_cli.commands", f"completion.{shell}.j2", content, filters=filters
    )
