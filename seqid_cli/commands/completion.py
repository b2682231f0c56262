"""`seqid completion`: scripts, made from the parsers, that complete without starting Python."""

from __future__ import annotations

import re
import sys
from collections.abc import Mapping
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
    takes_value: bool
    choices: tuple[str, ...]


class Words(NamedTuple):
    """What can follow a command's name."""

    help: str
    flags: tuple[Flag, ...]
    choices: tuple[str, ...]  # of its first argument, if it takes no files


def run(shell: Shell) -> int:
    """Print the completion script of a shell."""
    render = {"bash": bash_script, "zsh": zsh_script, "fish": fish_script}[shell]
    sys.stdout.write(render(all_words()))
    return 0


def all_words() -> dict[str, Words]:
    """Return what every command offers, asked of its parser."""
    from seqid_cli.commands.app import COMMANDS, load_command

    words = {}
    for name, entry in COMMANDS.items():
        params = load_command(name).params
        flags = [_flag_from(param) for param in params if isinstance(param, typer.core.TyperOption)]
        help_flag = Flag(("-h", "--help"), "Show the help.", False, ())
        first = next((p for p in params if isinstance(p, typer.core.TyperArgument)), None)
        choices = tuple(getattr(first.type, "choices", ())) if first else ()
        words[name] = Words(entry.help, (*flags, help_flag), choices)
    return words


def bash_script(words: Mapping[str, Words]) -> str:
    """Return a script for bash."""
    cases = "".join(
        f'        {name}) words="{" ".join([*_spellings(entry), *entry.choices])}" ;;\n'
        for name, entry in words.items()
    )
    values = "".join(
        f'        {" | ".join(flag.spellings)}) words="{" ".join(flag.choices)}" ;;\n'
        for flag in _choosing(words)
    )
    return f"""_seqid() {{
    local current="${{COMP_WORDS[COMP_CWORD]}}" previous="${{COMP_WORDS[COMP_CWORD-1]}}" words=""
    case "${{COMP_WORDS[1]}}" in
{cases}    esac
    [[ $COMP_CWORD == 1 ]] && words="{" ".join(words)} --help --version"
    case "$previous" in
{values}        *) [[ $COMP_CWORD -gt 1 && $current != -* ]] && words="${{words##*--help}}" ;;
    esac
    COMPREPLY=( $(compgen -W "$words" -- "$current") )
}}
complete -o default -F _seqid seqid
"""


def zsh_script(words: Mapping[str, Words]) -> str:
    """Return a script for zsh."""
    commands = "\n".join(f"        {_quote(f'{n}:{w.help}')}" for n, w in words.items())
    cases = ""
    for name, entry in words.items():
        specs = [_zsh_spec(flag) for flag in entry.flags]
        last = f"1: :({' '.join(entry.choices)})" if entry.choices else "*:file:_files"
        lines = " \\\n            ".join([*specs, _quote(last)])
        cases += f"        {name})\n            _arguments -s {lines} ;;\n"
    return f"""#compdef seqid
_seqid() {{
    local -a commands=(
{commands}
    )
    if (( CURRENT == 2 )); then
        _describe command commands
        return
    fi
    local name="${{words[2]}}"
    shift words
    (( CURRENT-- ))
    case "$name" in
{cases}    esac
}}
compdef _seqid seqid
"""


def fish_script(words: Mapping[str, Words]) -> str:
    """Return a script for fish."""
    lines = []
    for name, entry in words.items():
        shown = f"-a {name} -d {_quote(entry.help)}"
        lines.append(f"complete -c seqid -f -n __fish_use_subcommand {shown}")
        when = f"-n '__fish_seen_subcommand_from {name}'"
        for flag in entry.flags:
            spelled = " ".join(_fish_spelling(word) for word in flag.spellings)
            value = " -r" if flag.takes_value else ""
            choices = f" -f -a '{' '.join(flag.choices)}'" if flag.choices else ""
            lines.append(
                f"complete -c seqid {when} {spelled}{value}{choices} -d {_quote(flag.help)}"
            )
        if entry.choices:
            lines.append(f"complete -c seqid -f {when} -a '{' '.join(entry.choices)}'")
    return "\n".join(lines) + "\n"


def _flag_from(option: typer.core.TyperOption) -> Flag:
    return Flag(
        spellings=tuple(option.opts),
        help=option.help or "",
        takes_value=not option.is_flag,
        choices=tuple(getattr(option.type, "choices", ())),
    )


def _spellings(entry: Words) -> list[str]:
    return [word for flag in entry.flags for word in flag.spellings]


def _choosing(words: Mapping[str, Words]) -> list[Flag]:
    flags = [flag for entry in words.values() for flag in entry.flags if flag.takes_value]
    return list({flag.spellings: flag for flag in flags}.values())


def _zsh_spec(flag: Flag) -> str:
    text = re.sub(r"([\[\]:\\])", r"\\\1", flag.help)
    value = ""
    if flag.takes_value:
        value = f":value:({' '.join(flag.choices)})" if flag.choices else ":file:_files"
    names = ",".join(flag.spellings)
    group = f"({' '.join(flag.spellings)})"
    if len(flag.spellings) == 1:
        return _quote(f"{names}[{text}]{value}")
    return f"{_quote(group)}{{{names}}}{_quote(f'[{text}]{value}')}"


def _fish_spelling(word: str) -> str:
    return f"-l {word[2:]}" if word.startswith("--") else f"-s {word[1:]}"


def _quote(text: str) -> str:
    return "'" + text.replace("'", "'\\''") + "'"
