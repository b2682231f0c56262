"""The program `seqid`: it imports the command that runs, and answers whatever happens.

A module of commands imports what its commands need, so only the module of the chosen
command is imported. The overview of `seqid --help` is written from the table below.
"""

import difflib
import json
import os
import sys
import traceback
from collections.abc import Mapping, Sequence
from importlib import import_module
from itertools import pairwise
from typing import Annotated, NamedTuple, cast

import typer
from typer.core import TyperCommand, TyperGroup

from seqid_cli import __version__
from seqid_cli.commands.options import command_app
from seqid_cli.commands.screen.layout import can_be_steered, shortened
from seqid_cli.commands.screen.messages import write_error
from seqid_cli.commands.screen.streams import cannot_be_written, to_nowhere
from seqid_cli.errors import EXIT_BUG, EXIT_INTERRUPTED, SeqidError, UsageError

HELP_WIDTH = 100  # characters, where the terminal has so many
_LONGEST_MESSAGE = 4000  # characters: names from files have any length
_NO_MEMORY_MESSAGES = ("cannot allocate memory", "failed to map segment")


class CommandEntry(NamedTuple):
    """The module in which a command is defined, and its line in `seqid --help`."""

    module: str
    summary: str


_COMPARISON = "seqid_cli.commands.comparison"
_DRIVES = "seqid_cli.commands.drives"
_LOGS = "seqid_cli.commands.logs"
_MODELS = "seqid_cli.commands.models"
_STAGES = "seqid_cli.commands.stages"
COMMANDS: Mapping[str, CommandEntry] = {
    "init": CommandEntry(
        _LOGS, "Write a robot file from a log and a URDF, to be completed."
    ),
    "inspect": CommandEntry(
        _LOGS, "Look through logs: what is in them and what is wrong."
    ),
    "run": CommandEntry(
        "seqid_cli.commands.run",
        "Run every stage on a folder of logs, then predict and report.",
    ),
    "friction": CommandEntry(
        _STAGES, "Identify joint friction from constant-velocity moves."
    ),
    "gravity": CommandEntry(
        _STAGES, "Identify the gravity parameters, given the friction."
    ),
    "imu-calib": CommandEntry(
        _STAGES, "Find how accelerometers and IMUs are mounted on the links."
    ),
    "inertia": CommandEntry(
        _STAGES, "Identify the inertia parameters, given friction and gravity."
    ),
    "predict": CommandEntry(
        _MODELS, "Predict joint torques and compare them with the measured ones."
    ),
    "diagnose": CommandEntry(_MODELS, "Find out which physical effects a model lacks."),
    "refine": CommandEntry(
        _MODELS, "Add the effects that a model lacks, checked on held-out logs."
    ),
    "simultaneous": CommandEntry(
        _STAGES, "Identify everything in one classical least squares."
    ),
    "plan": CommandEntry(
        "seqid_cli.commands.plan",
        "Plan what to record next, and the errors that it will give.",
    ),
    "payload": CommandEntry(
        _MODELS, "Identify the mass, centre and inertia that the flange carries."
    ),
    "drive": CommandEntry(
        _DRIVES, "Identify the joints' controllers from their commands."
    ),
    "replay": CommandEntry(
        _DRIVES, "Simulate the robot from its commands, against its logs."
    ),
    "trend": CommandEntry(
        _COMPARISON, "Find what changed over dates, beyond its error."
    ),
    "report": CommandEntry(
        "seqid_cli.commands.report",
        "Write the results as one HTML page, the verdict first.",
    ),
    "export": CommandEntry(
        "seqid_cli.commands.export",
        "Write an identified arm as URDF, MJCF, ROS 2 YAML or C.",
    ),
    "compare": CommandEntry(
        _COMPARISON, "Compare two results against their standard errors."
    ),
    "completion": CommandEntry(
        "seqid_cli.commands.completion", "Print the completion script of a shell."
    ),
}


# Typer leaves the lines behind \b as they are.
_ORDER_OF_WORK = """\b
Order of work:
  1. init LOG --urdf ARM -o robot.toml   then complete robot.toml
  2. inspect LOG... -r robot.toml        until nothing is wrong
  3. any motion: simultaneous; moves of single joints as well: run FOLDER, or
     friction, gravity, imu-calib, inertia one after the other
  4. predict and diagnose on logs that were not fitted, then refine
  5. report, export; plan says what to record next

Logs: MCAP, ROS 1 and 2 bags, Parquet, CSV, LeRobot data sets.
"""


def run(arguments: Sequence[str]) -> int:
    """Run a command line; whatever happens becomes a message and an exit code."""
    try:
        code = _answered(arguments)
        sys.stdout.flush()
    except OSError as error:
        to_nowhere(sys.stdout)
        # The reader has seen enough; the files are complete.
        if isinstance(error, BrokenPipeError):
            return 0
        sys.stderr.write(
            f"seqid: error: standard output cannot be written: {error.strerror}\n"
        )
        return UsageError.exit_code
    return code


def invoke(arguments: Sequence[str]) -> int:
    """Run a command line and return its exit code; errors are raised as they are."""
    words = list(arguments)
    if words[:1] == ["--"]:  # ends the options of `seqid` itself
        del words[0]

    command: TyperCommand | TyperGroup
    if words and words[0] in COMMANDS:
        name = words.pop(0)
        program = f"seqid {name}"
        command = load_command(name)
        if _settings_are_asked_for(command, words):
            from seqid_cli.commands.settings import show_settings

            return show_settings(command, name, words)
    else:
        program = "seqid"
        command = _overview(words)

    try:
        with command.make_context(
            program,
            words,
            help_option_names=["-h", "--help"],
            max_content_width=HELP_WIDTH,
        ) as context:
            return int(command.invoke(context) or 0)
    except typer.Exit as request:
        return request.exit_code


def load_command(name: str) -> TyperCommand:
    """Import the module of a command, and return the command."""
    of_module: typer.Typer = import_module(COMMANDS[name].module).app

    # It is built alone: to build its neighbours as well takes as long as a help page.
    alone = command_app()
    alone.registered_commands = [
        command for command in of_module.registered_commands if command.name == name
    ]
    return cast("TyperCommand", typer.main.get_command(alone))


def _overview(words: Sequence[str]) -> TyperGroup:
    """Return `seqid` without a command: it has help and a version, and imports nothing.

    Raises
    ------
    UsageError
        The first word is no option: it should have been a command.
    """
    if words and not words[0].startswith("-"):
        close = difflib.get_close_matches(words[0], COMMANDS)
        hint = f"Did you mean {' or '.join(close)}?" if close else "See seqid --help."
        raise UsageError(f"no such command: {words[0]}", hint=hint)

    app = typer.Typer(
        name="seqid",
        help="From recorded robot logs to a dynamic model that an engineer trusts.",
        epilog=_ORDER_OF_WORK,
        add_completion=False,
        rich_markup_mode=None,
        no_args_is_help=True,
    )
    app.callback()(_of_the_program)
    for name, entry in COMMANDS.items():
        app.command(name, short_help=entry.summary)(_command_behind_options)
    return cast("TyperGroup", typer.main.get_command(app))


def _show_version(is_asked_for: bool) -> None:
    if is_asked_for:
        sys.stdout.write(f"seqid {__version__}\n")
        raise typer.Exit


def _of_the_program(
    version: Annotated[
        bool,
        typer.Option(
            "--version",
            is_eager=True,
            callback=_show_version,
            help="Show the version.",
        ),
    ] = False,
) -> None:
    """Take the options of `seqid` itself."""
    del version  # its callback has answered


def _command_behind_options() -> None:
    """Stand for a command in the overview; its name has to come first to run it."""
    raise UsageError("the command has to come first", hint="See seqid --help.")


def _settings_are_asked_for(command: TyperCommand, words: Sequence[str]) -> bool:
    """Return whether a command is to show its settings, of which it has some.

    Not where another option is misspelt: then the command is run, which says so.
    """
    spellings = {"--help"}
    for param in command.params:
        spellings.update(param.opts, param.secondary_opts)
    options = [word.partition("=")[0] for word in words if word.startswith("--")]
    if not spellings.issuperset(options):
        return False
    return "--show-settings" in spellings.intersection(options)


def _answered(arguments: Sequence[str]) -> int:
    """Run a command line and return its exit code, also where it ends in an error."""
    name = "seqid"
    if arguments and arguments[0] in COMMANDS:
        name = f"seqid {arguments[0]}"
    try:
        # Where this variable is wrong, libraries fail while they are imported.
        if "SOURCE_DATE_EPOCH" in os.environ:
            from seqid_cli.params.dates import source_date_epoch

            source_date_epoch()
        return invoke(arguments)
    except (KeyboardInterrupt, typer.Abort):
        sys.stderr.write(f"{name}: interrupted\n")
        return EXIT_INTERRUPTED
    except typer.TyperException as error:
        message = error.format_message()
        if set(arguments) <= {"--"}:  # no command: the message is the overview
            sys.stderr.write(f"{message}\n")
            return error.exit_code
        problem: SeqidError = UsageError(message, hint=f"See {name} --help.")
    except SeqidError as error:
        problem = error
    except Exception as error:  # the last resort: a bug must not look like a verdict
        if isinstance(error, OSError) and cannot_be_written(error):
            raise
        problem = _unforeseen(error)
    return _report(name, problem, arguments)


def _unforeseen(error: Exception) -> SeqidError:
    """Return what is said of an error that nobody foresaw: no memory, or a bug."""
    text = str(error)
    lacks_memory = any(message in text.lower() for message in _NO_MEMORY_MESSAGES)
    if isinstance(error, MemoryError) or lacks_memory:
        return UsageError(
            f"there is too little memory ({text})",
            hint="Give the process more of it, or fewer logs and --jobs 1.",
        )
    bug = SeqidError(
        f"this is a bug in seqid: {type(error).__name__}: {text}",
        hint=(
            "Report it with the command line and the output of the same command with"
            " --debug."
        ),
    )
    bug.__cause__ = error
    bug.exit_code = EXIT_BUG
    return bug


def wants_json(arguments: Sequence[str]) -> bool:
    """Return whether a command line asks for one JSON document on stdout.

    Its words are looked at themselves: they may be what is wrong.
    """
    is_format = ("--format", "json") in pairwise(arguments)
    return is_format or not {"--json", "--format=json"}.isdisjoint(arguments)


def _report(name: str, problem: SeqidError, arguments: Sequence[str]) -> int:
    """Write an error as a message; return its exit code."""
    if "--debug" in arguments:
        traceback.print_exception(problem)
    write_error(
        name,
        shortened(str(problem), _LONGEST_MESSAGE),
        shortened(problem.hint, _LONGEST_MESSAGE),
        color=can_be_steered(sys.stderr) and "--no-color" not in arguments,
    )
    if wants_json(arguments):
        error = {
            "code": problem.exit_code,
            "message": problem.message,
            "hint": problem.hint,
            "where": problem.where,
        }
        sys.stdout.write(json.dumps({"error": error}, indent=2) + "\n")
    return problem.exit_code
