"""What commands have in common: they listen to one function, and turn its result into a code."""

import contextlib
import inspect
import sys
import warnings
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, fields
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING, Any

import typer

from seqid_cli.commands.screen.progress import ProgressLine
from seqid_cli.commands.screen.render import Screen, screen_of
from seqid_cli.errors import SeqidError, SeqidWarning, UsageError
from seqid_cli.params.document import worst_level
from seqid_cli.params.schema import Verdict
from seqid_cli.settings import overridden
from seqid_cli.working import heard_by

if TYPE_CHECKING:
    from concurrent.futures import Executor

    from seqid_cli.inspect.progress import Progress
    from seqid_cli.params.results.inspection import InspectionFinding

EXIT_DONE, EXIT_UNTRUSTED, EXIT_PARTIAL = 0, 1, 3
# Below this many bytes of logs one process is done before others have imported what
# they need.
WORTH_BYTES = 32_000_000


@dataclass
class Told:
    """Shows on a screen what a function tells and warns of, and keeps what decides its exit code.

    `given` are the arguments and options of the command, `findings` those of all logs;
    `partial` says that logs were read in part or not at all.
    """

    screen: Screen
    line: ProgressLine
    given: Mapping[str, Any]
    findings: "list[InspectionFinding]" = field(default_factory=list)
    partial: bool = False

    def __call__(self, progress: "Progress") -> None:
        """Take what is told."""
        if progress.state == "note":
            with self.line.hidden():
                self.screen.note(progress.text)
        elif progress.state == "detail":
            self._detail(progress.text)
        elif progress.state == "failed":
            self.partial = True
        elif (log := progress.note) is not None:
            path = str(log.path)
            self._detail(f"{path}: {log.samples} samples at {log.rate_hz:.6g} Hz")
            self.screen.said.update(f"{path}: {text}" for text in log.mended)
            self.findings += log.findings
            self.partial |= bool(log.partial)
        self.line.show(progress.done, progress.total, Path(progress.log).name)

    def warn(self, message: Warning | str, category: type[Warning], *more: Any) -> None:
        """Print a warning in the place of Python's own way."""
        with self.line.hidden():
            if issubclass(category, SeqidWarning):
                self.screen.warn(str(message))
            else:
                sys.stderr.write(warnings.formatwarning(message, category, *more[:2]))

    def _detail(self, text: str) -> None:
        if self.screen.verbose:  # else the line would blink for nothing
            with self.line.hidden():
                self.screen.detail(text)

    def tell_output(self, following: str = "") -> None:
        """Say where the result went and which command to type next."""
        output = self.given.get("output")
        if output is None:
            self.screen.note("Nothing was written: give -o FILE to keep the result.")
            return
        self.screen.note(f"written: {output}")
        if following:
            self.screen.note(
                f"next: {following.format(output=output, robot=self.given['robot'])}"
            )

    def ended(
        self, verdicts: Sequence[Verdict] = (), *, untrusted: bool = False
    ) -> int:
        """Return the exit code of a command that has written its result.

        After poor verdicts it says what to do. With --strict they, and what is
        `untrusted` for another reason, count.
        """
        not_good = any_poor(verdicts)
        if worst_level(verdicts) == "poor":
            for remedy in dict.fromkeys(
                f.remedy for f in self.findings if f.severity == "error"
            ):
                self.screen.note(f"do: {remedy}")
            self.screen.note(
                "do: look at the reasons above and mend the logs or the robot file"
                " before going on"
                + (
                    ""
                    if self.findings
                    else " (seqid inspect LOG... -r ROBOT looks closer)"
                )
            )
        if (not_good or untrusted) and self.given.get("strict"):
            return EXIT_UNTRUSTED
        return EXIT_PARTIAL if self.partial else EXIT_DONE


def called(context: typer.Context, name: str) -> tuple[Told, Any]:
    """Call the function of the package that a command is for, "identify.friction".

    It gets what the command line gives, its progress and warnings are shown, and what
    it returns is printed where the command is asked for JSON.
    """
    package, function = name.split(".")
    given, screen = context.params, screen_of(context)
    line = ProgressLine(
        sys.stderr, enabled=not screen.quiet, color=screen.color_messages
    )
    told = Told(screen, line, given)
    with (
        warnings.catch_warnings(),
        contextlib.closing(told.line),
        heard_by(told.line.show),
    ):
        warnings.simplefilter("always", SeqidWarning)
        warnings.showwarning = told.warn  # type: ignore[assignment]
        call = getattr(import_module(f"seqid_cli.{package}"), function)
        with _workers(given) as executor:
            result = call(**_arguments(call, told), **executor)
    screen.document(result)
    return told, result


def _arguments(function: Callable[..., object], told: Told) -> dict[str, Any]:
    """Return what a function takes of the command line, and the listener where it reads logs."""
    taken = inspect.signature(function).parameters
    wanted = [*taken, "output"]
    found = {
        name: told.given[name] for name in wanted if told.given.get(name) is not None
    }
    if "options" in taken:
        form = type(taken["options"].default)
        names = {field.name for field in fields(form)} & told.given.keys()
        found["options"] = form(**{name: told.given[name] for name in names})
    if "settings" in taken:
        defaults = taken["settings"].default
        found["settings"] = overridden(defaults, told.given.get("set_values") or ())
    return found | ({"on_progress": told} if "logs" in told.given else {})


@contextlib.contextmanager
def _workers(given: Mapping[str, Any]) -> Iterator["dict[str, Executor]"]:
    """Whoever is to read the logs of a command with --jobs, as an argument of its function."""
    dask, scheduler = given.get("engine") == "dask", given.get("scheduler")
    if scheduler is not None and not dask:
        hint = "Add --engine dask, or leave out --scheduler."
        raise UsageError("a scheduler is of use to Dask only", hint=hint)
    count = (
        processes_for(given["logs"], given["jobs"])
        if "jobs" in given and not dask
        else 1
    )
    if count == 1 and not dask:
        yield {}
        return
    from seqid_cli.scale import dask_cluster, processes

    with (
        dask_cluster(scheduler, given["jobs"]) if dask else processes(count)
    ) as executor:
        yield {"executor": executor}


def processes_for(logs: Sequence[str], jobs: int | None) -> int:
    """How many processes to start for these logs; 1 means none beside this one."""
    from seqid_cli.logs.storage.files import expand
    from seqid_cli.logs.storage.remote import is_url
    from seqid_cli.scale import cores

    if jobs == 1:
        return 1
    if any(map(is_url, logs)):  # listed by its store, later; worth the start
        return jobs or cores()
    try:
        sizes = [path.stat().st_size for path in expand(logs)]
    except (SeqidError, OSError):  # told by whoever reads them
        return jobs or 1
    if jobs is None and sum(sizes) < WORTH_BYTES:
        return 1
    return max(1, min(jobs or cores(), len(sizes)))


def any_poor(verdicts: Sequence[Verdict]) -> bool:
    """Whether a verdict is not good."""
    return any(not verdict.good for verdict in verdicts)
