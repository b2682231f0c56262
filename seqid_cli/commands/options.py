"""Arguments and options that several commands share, each defined once.

A command lists those it takes in its signature, with their defaults; the name of a
parameter is the one that the function behind the command has. What one command alone
takes stands in that command.
"""

import math
from collections.abc import Callable
from pathlib import Path
from typing import Annotated, Literal

import typer

SIX = "sample_logs/six_joint"  # in examples


def command_app() -> typer.Typer:
    """Return an app for the commands of a module: plain text, no traceback of rich."""
    return typer.Typer(
        add_completion=False, rich_markup_mode=None, pretty_exceptions_enable=False
    )


def examples(*command_lines: str) -> str:
    """Return the end of a command's help: command lines to copy, a line each."""
    lines = "\n".join(f"  {line}" for line in command_lines)
    return f"\b\nExamples:\n{lines}"  # Typer leaves the lines behind \b as they are


def number_check(
    is_allowed: Callable[[float], bool], description: str
) -> Callable[[float | None], float | None]:
    """Return a callback for an option that refuses numbers which are not allowed.

    Infinite numbers and NaN are never allowed. An option that is left out passes.
    """

    def check(value: float | None) -> float | None:
        if value is None:
            return None
        if not math.isfinite(value) or not is_allowed(value):
            raise typer.BadParameter(f"{value} is not {description}")
        return value

    return check


def is_positive(value: float) -> bool:
    """Return whether a number is above zero."""
    return value > 0.0


LogsArgument = Annotated[
    list[str],
    typer.Argument(
        metavar="LOG...",
        help=(
            "Files, folders or globs, formats mixed: MCAP, ROS 1 and 2 bags, Parquet,"
            " CSV, LeRobot data sets."
        ),
    ),
]
RobotOption = Annotated[
    Path | None,
    typer.Option(
        "-r",
        "--robot",
        metavar="FILE",
        help="Robot file; ./robot.toml or one beside the logs when left out.",
    ),
]
# The model that a command starts from.
ParametersOption = Annotated[
    list[Path],
    typer.Option(
        "-p",
        "--parameters",
        metavar="FILE",
        help="Parameter file of the stages before; repeat it to join several.",
    ),
]
# The results that a command adds its own to.
AddedToOption = Annotated[
    list[Path] | None,
    typer.Option(
        "-p",
        "--parameters",
        metavar="FILE",
        help="Parameter file to add the result to; repeat it to join several.",
    ),
]
OutputOption = Annotated[
    Path | None,
    typer.Option(
        "-o", "--output", metavar="FILE", help="Where the result goes, as JSON."
    ),
]
MotionOption = Annotated[
    Literal["auto", "encoder", "imu", "fused"],
    typer.Option(
        "--motion",
        help=(
            "Where joint motion comes from: encoders, IMUs (Eq. 30, 31, 41, 42), or"
            " both in one smoother; auto is fused where a log has a calibrated IMU (to"
            " look for effects: and where encoders are much the worse), else encoder."
        ),
    ),
]
CutoffOption = Annotated[
    float | None,
    typer.Option(
        "--cutoff",
        metavar="HZ",
        callback=number_check(is_positive, "a positive number"),
        help=(
            "Low-pass cut-off frequency; that of the model, or chosen from the logs, if"
            " left out."
        ),
    ),
]
TimeOption = Annotated[
    Literal["header", "log"],
    typer.Option("--time", help="Which time stamps of an MCAP log count."),
]
# The part of each log that is used; `LogPart.of` takes the three of them.
FromOption = Annotated[
    str | None,
    typer.Option(
        "--from",
        metavar="MOMENT",
        help=(
            "Use logs from here on: seconds from the start, or a stamp"
            " (2026-03-01T12:00:00Z, seconds since 1970, or @ and seconds of the log's"
            " clock)."
        ),
    ),
]
ToOption = Annotated[
    str | None,
    typer.Option("--to", metavar="MOMENT", help="Use logs up to here."),
]
ExcludeOption = Annotated[
    list[str] | None,
    typer.Option(
        "--exclude",
        metavar="MOMENT,MOMENT",
        help="Leave out what lies between; repeat it for several.",
    ),
]
JobsOption = Annotated[
    int | None,
    typer.Option(
        "--jobs",
        metavar="N",
        min=1,
        help=(
            "Processes to read logs with; by default all cores where the logs are large"
            " enough."
        ),
    ),
]
EngineOption = Annotated[
    Literal["local", "dask"],
    typer.Option(
        "--engine", help="Who reads the logs: processes here, or Dask (seqid[dask])."
    ),
]
SchedulerOption = Annotated[
    str | None,
    typer.Option("--scheduler", metavar="ADDRESS", help="Of a running Dask scheduler."),
]
SkipFailedOption = Annotated[
    bool,
    typer.Option(
        "--skip-failed", help="Go on without logs that cannot be used; exits with 3."
    ),
]
ConsistentOption = Annotated[
    bool,
    typer.Option(
        "--consistent",
        help=(
            "Allow only parameters that bodies with positive density and rotors of"
            " positive inertia can have; says what moved, in standard errors."
        ),
    ),
]
StrictOption = Annotated[
    bool, typer.Option("--strict", help="Exit with 1 when a verdict is not good.")
]

# The settings of a command. `app` answers --show-settings, for which no log is needed.
SetOption = Annotated[
    list[str] | None,
    typer.Option(
        "--set",
        metavar="NAME=VALUE",
        help="Another value for a setting; repeat it for several.",
    ),
]
ShowSettingsOption = Annotated[
    bool,
    typer.Option(
        "--show-settings",
        help="Show the settings, with units and reasons, and stop.",
    ),
]

# What the screen shows: every command has these.
QuietOption = Annotated[
    bool,
    typer.Option(
        "-q", "--quiet", help="No progress and no advice, only results and warnings."
    ),
]
VerboseOption = Annotated[
    bool, typer.Option("-v", "--verbose", help="Say more about each log.")
]
JsonOption = Annotated[
    bool, typer.Option("--json", help="Print the result as one JSON document.")
]
NoColorOption = Annotated[
    bool,
    typer.Option("--no-color", help="No colours, whatever the terminal can do."),
]
# `app` looks for it among the words: it reports mistakes on the command line as well.
DebugOption = Annotated[
    bool, typer.Option("--debug", help="Show the traceback of an error.")
]
