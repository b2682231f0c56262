"""The command group: commands are imported when chosen, errors become messages and exit codes."""

import difflib
import importlib
import json
import os
import sys
import traceback
from collections.abc import Mapping, Sequence
from typing import Any

import typer
from typer._click import Command, Context, HelpFormatter, Parameter
from typer._click.exceptions import ClickException, NoArgsIsHelpError
from typer.core import TyperCommand, TyperGroup, TyperOption

from seqid_cli import __version__
from seqid_cli.commands.screen.layout import can_be_steered, shortened
from seqid_cli.commands.screen.messages import write_error
from seqid_cli.commands.screen.streams import cannot_be_written, to_nowhere
from seqid_cli.errors import EXIT_INTERRUPTED, SeqidError, UsageError

EXIT_BUG = 70
_NO_ROOM = ("cannot allocate memory", "failed to map segment")
_BUG = "this is a bug in seqid"
_REPORT_IT = (
    "Report it with the command line and the output of the same command with --debug."
)
_LONGEST = 4000  # letters of a message: names from files have any length
_SETTINGS = {"help_option_names": ["-h", "--help"], "max_content_width": 100}


# Where each command lives, and its line in `seqid --help`.
COMMANDS: Mapping[str, tuple[str, str]] = {
    "init": ("logs", "Write a robot file from a log and a URDF, to be completed."),
    "inspect": ("logs", "Look through logs: what is in them and what is wrong."),
    "run": ("run", "Run every stage on a folder of logs, then predict and report."),
    "friction": ("stages", "Identify joint friction from constant-velocity moves."),
    "gravity": ("stages", "Identify the gravity parameters, given the friction."),
    "imu-calib": (
        "stages",
        "Find how accelerometers and IMUs are mounted on the links.",
    ),
    "inertia": (
        "stages",
        "Identify the inertia parameters, given friction and gravity.",
    ),
    "predict": (
        "models",
        "Predict joint torques and compare them with the measured ones.",
    ),
    "diagnose": ("models", "Find out which physical effects a model lacks."),
    "refine": (
        "models",
        "Add the effects that a model lacks, checked on held-out logs.",
    ),
    "simultaneous": ("stages", "Identify everything in one classical least squares."),
    "plan": ("plan", "Plan what to record next, and the errors that it will give."),
    "payload": (
        "models",
        "Identify the mass, centre and inertia that the flange carries.",
    ),
    "trend": ("files", "Find what changed over dates, beyond its error."),
    "report": ("files", "Write the results as one HTML page, the verdict first."),
    "export": ("files", "Write an identified arm as URDF, MJCF, ROS 2 YAML or C."),
    "compare": ("files", "Compare two results against their standard errors."),
    "completion": ("completion", "Print the completion script of a shell."),
}


class LazyGroup(TyperGroup):
    """The group `seqid`, which knows its commands by name and imports only the one that runs."""

    def resolve_command(
        self, ctx: Context, args: list[str]
    ) -> tuple[str | None, Command | None, list[str]]:
        """Find the command that the first word names; raises UsageError if there is none."""
        name = args[0]
        if name not in COMMANDS:
            close = difflib.get_close_matches(name, COMMANDS)
            hint = (
                f"Did you mean {' or '.join(close)}?" if close else "See seqid --help."
            )
            raise UsageError(f"no such command: {name}", hint=hint)
        return name, load_command(name), args[1:]

    def format_commands(self, ctx: Context, formatter: HelpFormatter) -> None:
        """Write the list of commands without importing any."""
        with formatter.section("Commands"):
            formatter.write_dl([(name, text) for name, (_, text) in COMMANDS.items()])


def command_function(name: str) -> Any:
    """Import the function of one command."""
    module = importlib.import_module(f"seqid_cli.commands.{COMMANDS[name][0]}")
    return getattr(module, name.replace("-", "_"))


def load_command(name: str) -> Command:
    """Build the parser of one command."""
    function = command_function(name)
    examples = "\n".join(f"  {example}" for example in function.examples)
    app = typer.Typer(
        add_completion=False, rich_markup_mode=None, pretty_exceptions_enable=False
    )
    kind: type[TyperCommand] = TyperCommand
    if function.settings is not None:
        from seqid_cli.commands.settings import command_with

        kind = command_with(function.settings)
    epilog = f"\b\nExamples:\n{examples}"
    app.command(name, cls=kind, context_settings=_SETTINGS, epilog=epilog)(function)
    return typer.main.get_command(app)


def run(arguments: Sequence[str]) -> int:
    """Run a command line; whatever happens becomes a message and an exit code."""
    try:
        code = _guarded(arguments)
        sys.stdout.flush()
    except OSError as error:
        to_nowhere(sys.stdout)
        # the reader has seen enough; the files are complete
        if isinstance(error, BrokenPipeError):
            return 0
        sys.stderr.write(
            f"seqid: error: standard output cannot be written: {error.strerror}\n"
        )
        return UsageError.exit_code
    return code


def _guarded(arguments: Sequence[str]) -> int:
    name = (
        f"seqid {arguments[0]}" if arguments and arguments[0] in COMMANDS else "seqid"
    )
    problem: SeqidError
    try:
        # where it is wrong, libraries fail to import
        if "SOURCE_DATE_EPOCH" in os.environ:
            from seqid_cli.params.dates import source_date_epoch

            source_date_epoch()
        return invoke(arguments)
    except NoArgsIsHelpError as error:
        error.show()
        return error.exit_code
    except (KeyboardInterrupt, typer.Abort):
        sys.stderr.write(f"{name}: interrupted\n")
        return EXIT_INTERRUPTED
    except ClickException as error:
        problem = UsageError(error.format_message(), hint=f"See {name} --help.")
    except SeqidError as error:
        problem = error
    except Exception as error:  # the last resort: a bug must not look like a verdict
        if isinstance(error, OSError) and cannot_be_written(error):
            raise
        if isinstance(error, MemoryError) or any(
            x in str(error).lower() for x in _NO_ROOM
        ):
            hint = "Give the process more of it, or fewer logs and --jobs 1."
            problem = UsageError(f"there is too little memory ({error})", hint=hint)
        else:
            problem = SeqidError(
                f"{_BUG}: {type(error).__name__}: {error}", hint=_REPORT_IT
            )
            problem.__cause__, problem.exit_code = error, EXIT_BUG
    return _report(name, problem, arguments)


def invoke(arguments: Sequence[str]) -> int:
    """Run a command line; errors are raised as they are."""
    version = TyperOption(
        param_decls=["version", "--version"],
        is_flag=True,
        is_eager=True,
        expose_value=False,
        callback=_show_version,
        help="Show the version.",
    )
    group = LazyGroup(
        name="seqid",
        help="From recorded robot logs to a dynamic model that an engineer trusts.",
        params=[version],
        context_settings=_SETTINGS,
        rich_markup_mode=None,
        no_args_is_help=True,
    )
    try:
        with group.make_context("seqid", list(arguments)) as context:
            return int(group.invoke(context) or 0)
    except typer.Exit as request:
        return request.exit_code


def _report(name: str, problem: SeqidError, arguments: Sequence[str]) -> int:
    """Write an error as a message; returns its exit code."""
    if "--debug" in arguments:
        traceback.print_exception(problem)
    write_error(
        name,
        shortened(str(problem), _LONGEST),
        shortened(problem.hint, _LONGEST),
        color=can_be_steered(sys.stderr) and "--no-color" not in arguments,
    )
    if "--json" in arguments:
        error = {"code": problem.exit_code, "message": problem.message}
        error |= {"hint": problem.hint, "where": problem.where}
        sys.stdout.write(json.dumps({"error": error}, indent=2) + "\n")
    return problem.exit_code


def _show_version(context: Context, param: Parameter, value: bool) -> None:
    if value:
        sys.stdout.write(f"seqid {__version__}\n")
        raise typer.Exit
