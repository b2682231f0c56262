"""Arguments and options that commands share, spelled once."""

import inspect
import math
from collections.abc import Callable
from pathlib import Path
from typing import Annotated, Any, Literal, TypeVar

import typer
from typer.core import TyperOption
from typer.models import OptionInfo

TimeSource = Literal["header", "log"]
F = TypeVar("F", bound=Callable[..., int])


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
Cutoff = Annotated[
    float | None,
    option(
        "--cutoff HZ",
        "Low-pass cut-off frequency; that of the model, or chosen from the logs, if left out.",
        only("a positive number"),
    ),
]
Clock = Annotated[TimeSource, option("--time", "Which time stamps of an MCAP log count.")]
MotionSource = Annotated[
    Literal["auto", "encoder", "imu", "fused"],
    option(
        "--motion",
        "Where joint motion comes from: encoders, accelerations by IMUs (Eq. 30, 42), or both"
        " in one smoother; auto is fused where a log has a calibrated IMU (to look for effects: and"
        " where encoders are much the worse), else encoder.",
    ),
]
Jobs = Annotated[
    int | None,
    option(
        "--jobs N",
        "Processes to read logs with; by default all cores where the logs are large enough.",
        min=1,
    ),
]
Engine = Annotated[
    Literal["local", "dask"],
    option("--engine", "Who reads the logs: processes here, or Dask (seqid[dask])."),
]
Scheduler = Annotated[str | None, option("--scheduler ADDRESS", "Of a running Dask scheduler.")]
SkipFailed = Annotated[
    bool, option("--skip-failed", "Go on without logs that cannot be used; exits with 3.")
]
Consistent = Annotated[
    bool,
    option(
        "--consistent",
        "Allow only parameters that bodies with positive density and rotors of positive"
        " inertia can have; says what moved, in standard errors.",
    ),
]
Strict = Annotated[bool, option("--strict", "Exit with 1 when a verdict is poor.")]


def _shared(
    logs: Logs,
    robot: RobotPath,
    parameters: Parameters,
    output: Output = None,
    source: MotionSource = "auto",
    cutoff_hz: Cutoff = None,
    time_source: Clock = "header",
    jobs: Jobs = None,
    engine: Engine = "local",
    scheduler: Scheduler = None,
    skip_failed: SkipFailed = False,
    consistent: Consistent = False,
    strict: Strict = False,
) -> None:
    """Arguments that commands share, with their defaults."""


def takes(names: str) -> Callable[[F], F]:
    """Give a command the arguments `names`, in this order: its own ones, and shared ones.

    Shared ones reach it as `**shared`; all of them are in `context.params`.
    """

    def decorate(run: F) -> F:
        own = inspect.signature(run).parameters
        known = {**inspect.signature(_shared).parameters, **own}
        told = [known[name].replace(kind=inspect.Parameter.KEYWORD_ONLY) for name in names.split()]
        run.__signature__ = inspect.Signature([own["context"], *told])  # type: ignore[attr-defined]
        return run

    return decorate


_SCREEN_FLAGS = (
    ("quiet", ["-q", "--quiet"], "No progress and no advice, only results and warnings."),
    ("verbose", ["-v", "--verbose"], "Say more about each log."),
    ("json", ["--json"], "Print the result as one JSON document."),
    ("no_color", ["--no-color"], "No colours, whatever the terminal can do."),
    ("debug", ["--debug"], "Show the traceback of an error."),
)
_META = "seqid.screen."


def screen_options() -> list[TyperOption]:
    """Return new parser entries of the flags that every command takes; see `screen_flag`."""
    return [
        TyperOption(
            param_decls=[name, *spellings],
            is_flag=True,
            default=False,
            expose_value=False,
            callback=_remember,
            help=text,
        )
        for name, spellings, text in _SCREEN_FLAGS
    ]


def screen_flag(context: typer.Context, name: str) -> bool:
    """Return whether one of the `screen_options` was given."""
    return bool(context.meta.get(_META + name, False))


def _remember(context: typer.Context, param: typer.CallbackParam, value: bool) -> None:
    context.meta[_META + str(param.name)] = value
