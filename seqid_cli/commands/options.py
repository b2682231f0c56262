"""How a command is declared, and the arguments and options that commands share."""

import functools
import inspect
import math
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, Literal, overload

import typer

from seqid_cli.commands.screen.render import Screen, screen_of
from seqid_cli.errors import UsageError
from seqid_cli.settings import Settings

Run = Callable[..., int]
SIX = "sample_logs/six_joint"  # in examples


def command(
    names: str, *examples: str, settings: Settings | None = None
) -> Callable[[Run], Run]:
    """Make a function a command with examples that its help shows.

    `names` are its arguments in this order, its own and those of `_shared`; the latter
    reach it in `context.params` alone, where all are. With `settings`, its defaults, it
    has --set and --show-settings as well.
    """

    def decorate(run: Run) -> Run:
        own = inspect.signature(run, eval_str=True).parameters
        known = {**inspect.signature(_shared).parameters, **own}
        asked = [
            known[name].replace(kind=inspect.Parameter.KEYWORD_ONLY)
            for name in names.split()
        ]
        screen = [*inspect.signature(_of_the_screen).parameters.values()]
        if settings is not None:
            screen = [*inspect.signature(_of_settings).parameters.values(), *screen]

        needs_robot = "robot" in known and known["robot"].default is ROBOT

        @functools.wraps(run)
        def decorated(context: typer.Context, **given: Any) -> int:
            context.params = given
            if needs_robot and given.get("robot", "") is None:
                given["robot"] = found_robot(
                    screen_of(context), given.get("logs") or []
                )
            return run(context, **{name: given[name] for name in given if name in own})

        signature = inspect.Signature([own["context"], *asked, *screen])
        about = {"__signature__": signature, "examples": examples, "settings": settings}
        vars(decorated).update(about)
        return decorated

    return decorate


ROBOT_NAME = "robot.toml"


@overload
def found_robot(screen: Screen, logs: Sequence[str]) -> Path: ...


@overload
def found_robot(
    screen: Screen, logs: Sequence[str], *, required: bool
) -> Path | None: ...


def found_robot(
    screen: Screen, logs: Sequence[str], *, required: bool = True
) -> Path | None:
    """Return the robot file of the working folder, or else the one beside the logs.

    The screen says which it is. Beside a log is its folder, a folder of logs itself,
    and the one above, in which the folders of the stages lie.

    Raises
    ------
    UsageError
        There are several beside the logs, or there is none and one is `required`.
    """
    here = Path(ROBOT_NAME)
    if here.is_file():
        screen.note(f"robot file: {here} (-r names another)")
        return here
    beside = list(dict.fromkeys(filter(None, map(_robot_beside, logs))))
    if len(beside) == 1:
        screen.note(f"robot file: {beside[0]} (beside the logs; -r names another)")
        return beside[0]
    if beside:
        names = ", ".join(map(str, beside))
        message = (
            f"-r is left out, and several robot files lie beside the logs: {names}"
        )
        raise UsageError(message, hint="Choose one with -r.")
    if not required:
        return None
    message = f"-r is left out, and there is no {ROBOT_NAME} here or beside the logs"
    raise UsageError(
        message, hint="Name the robot file with -r, or make one: seqid init LOG."
    )


def _robot_beside(log: str) -> Path | None:
    """Return the robot file in a folder of logs, beside a log, or one folder above."""
    if "://" in log:  # on object storage
        return None
    place = Path(log)
    try:
        folder = place if place.is_dir() else place.parent
        candidates = (folder / ROBOT_NAME, folder.parent / ROBOT_NAME)
        return next((path for path in candidates if path.is_file()), None)
    # a name that no file can have: told by whoever opens it
    except (OSError, ValueError):
        return None


def only(
    what: str, allowed: Callable[[float], bool] = lambda x: x > 0.0
) -> Callable[[float | None], float | None]:
    """Return a callback that refuses a number that is infinite or not `allowed`: not `what`."""

    def check(value: float | None) -> float | None:
        if value is not None and not (math.isfinite(value) and allowed(value)):
            raise typer.BadParameter(f"{value} is not {what}")
        return value

    return check


def option(
    default: Any,
    spelled: str,
    text: str,
    check: Callable[[Any], Any] | None = None,
    **more: Any,
) -> Any:
    """Return an option as it is typed, "-o --output FILE": spellings, and what it takes if it does.

    `default` is ... where it must be given, `text` its help, `check` a callback that
    refuses values; `more` is as Typer has it.
    """
    words = spelled.split()
    metavar = None if words[-1].startswith("-") else words.pop()
    return typer.Option(
        default, *words, metavar=metavar, callback=check, help=text, **more
    )


LOGS = typer.Argument(
    ..., metavar="LOG...", help="Files, folders or globs; Parquet and MCAP mixed."
)
ROBOT = option(
    None,
    "-r --robot FILE",
    "Robot file; ./robot.toml or one beside the logs when left out.",
)
MODEL = option(
    ...,
    "-p --parameters FILE",
    "Parameter file of the stages before; repeat it to join several.",
)
ADDED_TO = option(
    None,
    "-p --parameters FILE",
    "Parameter file to add the result to; repeat it to join several.",
)
OUTPUT = option(None, "-o --output FILE", "Where the result goes, as JSON.")
JOBS = option(
    None,
    "--jobs N",
    "Processes to read logs with; by default all cores where the logs are large"
    " enough.",
    min=1,
)


def _shared(
    logs: list[str] = LOGS,
    robot: Path = ROBOT,
    parameters: list[Path] = MODEL,
    output: Path | None = OUTPUT,
    source: Literal["auto", "encoder", "imu", "fused"] = option(
        "auto",
        "--motion",
        "Where joint motion comes from: encoders, IMUs (Eq. 30, 31, 41, 42), or both in"
        " one smoother; auto is fused where a log has a calibrated IMU (to look for"
        " effects: and where encoders are much the worse), else encoder.",
    ),
    cutoff_hz: float | None = option(
        None,
        "--cutoff HZ",
        "Low-pass cut-off frequency; that of the model, or chosen from the logs, if"
        " left out.",
        only("a positive number"),
    ),
    time_source: Literal["header", "log"] = option(
        "header", "--time", "Which time stamps of an MCAP log count."
    ),
    jobs: int | None = JOBS,
    engine: Literal["local", "dask"] = option(
        "local",
        "--engine",
        "Who reads the logs: processes here, or Dask (seqid[dask]).",
    ),
    scheduler: str | None = option(
        None, "--scheduler ADDRESS", "Of a running Dask scheduler."
    ),
    skip_failed: bool = option(
        False, "--skip-failed", "Go on without logs that cannot be used; exits with 3."
    ),
    consistent: bool = option(
        False,
        "--consistent",
        "Allow only parameters that bodies with positive density and rotors of positive"
        " inertia can have; says what moved, in standard errors.",
    ),
    strict: bool = option(False, "--strict", "Exit with 1 when a verdict is poor."),
) -> None:
    """Arguments that commands share, with their defaults."""


def _of_settings(
    *,
    set_values: list[str] = option(
        [], "--set NAME=VALUE", "Another value for a setting; repeat it for several."
    ),
    show_settings: bool = option(
        False, "--show-settings", "Show the settings, with units and reasons, and stop."
    ),
) -> None:
    """Options of commands with settings."""


def _of_the_screen(
    *,
    quiet: bool = option(
        False, "-q --quiet", "No progress and no advice, only results and warnings."
    ),
    verbose: bool = option(False, "-v --verbose", "Say more about each log."),
    json: bool = option(False, "--json", "Print the result as one JSON document."),
    no_color: bool = option(
        False, "--no-color", "No colours, whatever the terminal can do."
    ),
    debug: bool = option(False, "--debug", "Show the traceback of an error."),
) -> None:
    """Options that every command has."""
