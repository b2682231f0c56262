"""How a command is declared, and the arguments and options that commands share."""

import functools
import inspect
import math
from collections.abc import Callable
from pathlib import Path
from typing import Annotated, Any, Literal

import typer
from typer.models import OptionInfo

Run = Callable[..., int]
SIX = "sample_logs/six_joint"  # in examples


def command(names: str, *examples: str) -> Callable[[Run], Run]:
    """Make a function a command with examples that its help shows.

    `names` are its arguments in this order, its own and those of `_shared`; the latter reach it in
    `context.params` alone, where all are.
    """

    def decorate(run: Run) -> Run:
        own = inspect.signature(run, eval_str=True).parameters
        known = {**inspect.signature(_shared).parameters, **own}
        asked = [known[name].replace(kind=inspect.Parameter.KEYWORD_ONLY) for name in names.split()]
        screen = inspect.signature(_of_the_screen).parameters.values()

        @functools.wraps(run)
        def decorated(context: typer.Context, **given: Any) -> int:
            context.params = given
            return run(context, **{name: given[name] for name in given if name in own})

        signature = inspect.Signature([own["context"], *asked, *screen])
        vars(decorated).update(__signature__=signature, examples=examples)
        return decorated

    return decorate


def only(
    what: str, allowed: Callable[[float], bool] = lambda x: x > 0.0
) -> Callable[[float | None], float | None]:
    """Return a callback that refuses a number that is infinite or not `allowed`: not `what`."""

    def check(value: float | None) -> float | None:
        if value is not None and not (math.isfinite(value) and allowed(value)):
            message = f"{value} is not {what}"
            raise typer.BadParameter(message)
        return value

    return check


def option(
    spelled: str, text: str, check: Callable[[Any], Any] | None = None, **more: Any
) -> OptionInfo:
    """Return an option as it is typed, "-o --output FILE": spellings, and what it takes if it does.

    `text` is its help, `check` a callback that refuses values; `more` is as Typer has it.
    """
    words = spelled.split()
    metavar = None if words[-1].startswith("-") else words.pop()
    made = typer.Option(*words, metavar=metavar, callback=check, help=text, **more)
    assert isinstance(made, OptionInfo)
    return made


Logs = Annotated[
    list[str],
    typer.Argument(metavar="LOG...", help="Files, folders or globs; Parquet and MCAP mixed."),
]
RobotPath = Annotated[Path, option("-r --robot FILE", "Robot file (robot.toml).")]
Parameters = Annotated[
    list[Path],
    option(
        "-p --parameters FILE", "Parameter file of the stages before; repeat it to join several."
    ),
]
OptionalParameters = Annotated[
    list[Path] | None,
    option(
        "-p --parameters FILE", "Parameter file to add the result to; repeat it to join several."
    ),
]
Output = Annotated[Path | None, option("-o --output FILE", "Where the result goes, as JSON.")]
Jobs = Annotated[
    int | None,
    option(
        "--jobs N",
        "Processes to read logs with; by default all cores where the logs are large enough.",
        min=1,
    ),
]


def _shared(
    logs: Logs,
    robot: RobotPath,
    parameters: Parameters,
    output: Output = None,
    source: Annotated[
        Literal["auto", "encoder", "imu", "fused"],
        option(
            "--motion",
            "Where joint motion comes from: encoders, accelerations by IMUs (Eq. 30, 42), or both"
            " in one smoother; auto is fused where a log has a calibrated IMU (to look for effects:"
            " and where encoders are much the worse), else encoder.",
        ),
    ] = "auto",
    cutoff_hz: Annotated[
        float | None,
        option(
            "--cutoff HZ",
            "Low-pass cut-off frequency; that of the model, or chosen from the logs, if left out.",
            only("a positive number"),
        ),
    ] = None,
    time_source: Annotated[
        Literal["header", "log"], option("--time", "Which time stamps of an MCAP log count.")
    ] = "header",
    jobs: Jobs = None,
    engine: Annotated[
        Literal["local", "dask"],
        option("--engine", "Who reads the logs: processes here, or Dask (seqid[dask])."),
    ] = "local",
    scheduler: Annotated[
        str | None, option("--scheduler ADDRESS", "Of a running Dask scheduler.")
    ] = None,
    skip_failed: Annotated[
        bool, option("--skip-failed", "Go on without logs that cannot be used; exits with 3.")
    ] = False,
    consistent: Annotated[
        bool,
        option(
            "--consistent",
            "Allow only parameters that bodies with positive density and rotors of positive"
            " inertia can have; says what moved, in standard errors.",
        ),
    ] = False,
    strict: Annotated[bool, option("--strict", "Exit with 1 when a verdict is poor.")] = False,
) -> None:
    """Arguments that commands share, with their defaults."""


def _of_the_screen(
    *,
    quiet: Annotated[
        bool, option("-q --quiet", "No progress and no advice, only results and warnings.")
    ] = False,
    verbose: Annotated[bool, option("-v --verbose", "Say more about each log.")] = False,
    json: Annotated[bool, option("--json", "Print the result as one JSON document.")] = False,
    no_color: Annotated[
        bool, option("--no-color", "No colours, whatever the terminal can do.")
    ] = False,
    debug: Annotated[bool, option("--debug", "Show the traceback of an error.")] = False,
) -> None:
    """Options that every command has."""
