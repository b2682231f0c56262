"""Options of a user per stage, and shared arguments of functions; no heavy imports."""

from __future__ import annotations

import functools
import inspect
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, Literal, TypeAlias, TypedDict, TypeVar

from seqid_cli.errors import UsageError
from seqid_cli.identify.settings import InertiaSettings
from seqid_cli.logs.reading import ALL, LogPart, Reading, TimeSource
from seqid_cli.motion.options import MotionOptions
from seqid_cli.working import heard_by

if TYPE_CHECKING:
    from concurrent.futures import Executor

    from seqid_cli.inspect.progress import Progress
    from seqid_cli.logs.given import PathLike
    from seqid_cli.model.friction import IdentifiedRange

# Order over position that friction may have: trials are reduced to functions up to it.
MAX_POSITION_ORDER = 10

Source = Literal["auto", "encoder", "imu", "fused"]


@dataclass(frozen=True, kw_only=True)
class LogOptions:
    """How logs are read.

    `cutoff_hz` is the low-pass cut-off; that of the model, or chosen from the logs,
    where it is None. `time_source` says which stamps of an MCAP log count: those in the
    messages, or the times of logging. `part` is the part of each log that is used; all
    of it by default, or what an earlier stage used of the same log. With `skip_failed`
    logs that cannot be used are left out, and warned of.
    """

    cutoff_hz: float | None = None
    time_source: TimeSource = "header"
    part: LogPart = ALL
    skip_failed: bool = False

    @property
    def reading(self) -> Reading:
        """By which stamps logs are read, and which part of them."""
        return Reading(time_source=self.time_source, part=self.part)


@dataclass(frozen=True, kw_only=True)
class FrictionOptions(LogOptions):
    """Orders m and l of Eq. 8 and 10, and the threshold beta of Eq. 11.

    Orders left None are the fewest with which the surface is that of the highest
    orders, within its errors; with a `beta` the fewest at which Eq. 11 holds, if any
    do.
    """

    position_order: int | None = None
    velocity_order: int | None = None
    beta: float | None = None

    def __post_init__(self) -> None:
        order = self.position_order
        if order is not None and order > MAX_POSITION_ORDER:
            raise UsageError(
                f"position order {order} is too high",
                hint=(
                    "Trials are reduced to functions of position up to order"
                    f" {MAX_POSITION_ORDER}."
                ),
            )


@dataclass(frozen=True, kw_only=True)
class RigidOptions(LogOptions):
    """Where joint motion comes from, and which parameters are allowed.

    `source` "auto" is "fused" where a log has a calibrated IMU, else "encoder".
    `consistent` allows only parameters that bodies with positive density and rotors of
    positive inertia can have.
    """

    source: Source = "auto"
    consistent: bool = False


@dataclass(frozen=True, kw_only=True)
class SimultaneousOptions(RigidOptions):
    """`offset` says whether each joint's friction has a constant torque besides."""

    offset: bool = True


@dataclass(frozen=True, kw_only=True)
class PredictOptions(LogOptions):
    """`with_unexplained` adds the smooth terms that no known effect explains."""

    source: Source = "auto"
    with_unexplained: bool = False


@dataclass(frozen=True, kw_only=True)
class InertiaOptions:
    """`source` is where joint motion comes from: "auto", "encoder", "imu" or "fused".

    `source_by_log` says it of logs that have one of their own, by their SHA-256.

    `slides_from` are the speeds [rad/s; m/s where prismatic], one per joint, from which
    a joint certainly slides in a prediction, `identified_ranges` the positions and
    speeds within which its friction counts as identified. None: what the model's own
    friction says. Errors of two models are compared on the same samples only where both
    have the same of both.

    `neighbours` are multiples of the cut-off at which the inertia stage looks at its
    parameters again (see `cutoff_check`); a log that is passed over is not looked at
    again.

    `settings` are the inertia stage's.
    """

    motion: MotionOptions = field(default_factory=MotionOptions)
    source: str = "auto"
    source_by_log: Mapping[str, str] = field(default_factory=dict)
    slides_from: tuple[float, ...] | None = None
    identified_ranges: tuple[IdentifiedRange | None, ...] | None = None
    neighbours: tuple[float, ...] = (0.7, 1.4)
    settings: InertiaSettings = field(default_factory=InertiaSettings)

    def source_of(self, sha256: str) -> str:
        """Return where the joint motion of a log comes from."""
        return self.source_by_log.get(sha256, self.source)


F = TypeVar("F", bound=Callable[..., object])
OnProgress: TypeAlias = "Callable[[Progress], None]"


class Keywords(TypedDict, total=False):
    """Keyword arguments of every function; `ENTRIES` says what they mean."""

    output: PathLike | None
    on_progress: OnProgress | None


class ParallelKeywords(Keywords, total=False):
    """Those of functions that read their logs in parallel."""

    executor: Executor | None


ENTRIES = {
    "robot": "path or Robot\n    The robot file.",
    "parameters": (
        "path or ParameterFile, or a sequence of them\n    What the result is added to."
    ),
    "options": "{default}\n    Its docstring says what can be set.",
    "settings": (
        "{default}\n    Numbers that decide; `--show-settings` of the command lists"
        " them."
    ),
    "output": "path, optional\n    Where the document is written as well.",
    "on_progress": (
        "callable, optional\n    Given a `Progress` before and after each log, and at"
        " each step of a search."
    ),
    "executor": (
        "concurrent.futures.Executor, optional\n    Who reads and reduces the logs (see"
        " `seqid_cli.scale`); this process by default."
    ),
}
ENDING = """
Returns
-------
{result}

Raises
------
SeqidError
    Where the command would exit with 1 or 2: it has `message`, `hint` and `where`.
"""


def documented(keywords: type[Keywords]) -> Callable[[F], F]:
    """Show shared arguments and `keywords` in a function's signature and docstring."""

    # That docstring ends with the parameters that are its own.
    def decorate(function: F) -> F:
        signature = inspect.signature(function)
        parameters = [
            p for p in signature.parameters.values() if p.kind is not p.VAR_KEYWORD
        ]
        for name, hint in keywords.__annotations__.items():
            annotation = getattr(hint, "__forward_arg__", hint)
            shared = inspect.Parameter(
                name, inspect.Parameter.KEYWORD_ONLY, default=None
            )
            parameters.append(shared.replace(annotation=annotation))
        text = inspect.cleandoc(function.__doc__ or "")
        entries = [
            f"{p.name} : {ENTRIES[p.name].format(default=p.annotation)}"
            for p in parameters
            if f"\n{p.name} : " not in text
        ]
        function.__doc__ = "\n".join(
            [text, *entries, ENDING.format(result=signature.return_annotation)]
        )
        function.__signature__ = signature.replace(parameters=parameters)  # type: ignore[attr-defined]
        return function

    return decorate


def tells_steps(function: F) -> F:
    """Let the `on_progress` of a call hear the steps of a search, beside the logs."""

    @functools.wraps(function)
    def told(*arguments: Any, **keywords: Any) -> object:
        on_progress: OnProgress | None = keywords.get("on_progress")
        if on_progress is None:
            return function(*arguments, **keywords)
        from seqid_cli.inspect.progress import Progress

        def hear(done: int, total: int, text: str) -> None:
            on_progress(Progress(state="step", done=done, total=total, text=text))

        with heard_by(hear):
            return function(*arguments, **keywords)

    return told  # type: ignore[return-value]
