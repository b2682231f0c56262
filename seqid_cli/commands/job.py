"""What commands have in common: they listen to one function, and turn its result into a code."""

from __future__ import annotations

import contextlib
import sys
import warnings
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, fields
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

import typer

from seqid_cli.commands.screen.progress import ProgressLine
from seqid_cli.commands.screen.render import Screen, screen_of
from seqid_cli.commands.screen.show import show_stages
from seqid_cli.errors import SeqidError, SeqidWarning, UsageError
from seqid_cli.params.schema import ParameterFile, Stages, Verdict
from seqid_cli.working import heard_by

if TYPE_CHECKING:
    from concurrent.futures import Executor

    from seqid_cli.inspect.progress import Progress
    from seqid_cli.params.results.inspection import InspectionFinding

T = TypeVar("T")
_INPUTS = ("logs", "holdout", "robot", "parameters", "output", "torques")
EXIT_DONE, EXIT_UNTRUSTED, EXIT_PARTIAL = 0, 1, 3
# Below this many bytes of logs one process is done before others have imported what they need.
WORTH_BYTES = 32_000_000


@dataclass
class Told:
    """Shows on a screen what a function tells and warns of, and keeps what decides its exit code.

    `given` are the arguments and options of the command, `findings` those of all logs; `partial`
    and `left_out` name logs that were read in part or not at all.
    """

    screen: Screen
    line: ProgressLine
    given: Mapping[str, Any]  # on the command line
    findings: list[InspectionFinding] = field(default_factory=list)
    partial: list[str] = field(default_factory=list)
    left_out: list[str] = field(default_factory=list)

    def options(self, form: type[T]) -> T:
        """Return the options of a function, fields of `form`, as the command line has them."""
        names = {field.name for field in fields(form)}  # type: ignore[arg-type]
        return form(**{name: value for name, value in self.given.items() if name in names})

    def call(self, function: Callable[..., T], form: type) -> T:
        """Call a function of the package with the command line; `form` is the type of its options.

        A command with --jobs lends it whoever is to read the logs.
        """
        given = {name: self.given[name] for name in _INPUTS if self.given.get(name) is not None}
        options = {"options": self.options(form), "on_progress": self}
        if "jobs" not in self.given:
            return function(**given, **options)
        who = {name: self.given[name] for name in ("engine", "scheduler") if name in self.given}
        with workers(given["logs"], self.given["jobs"], **who) as executor:
            return function(**given, **options, executor=executor)

    def __call__(self, progress: Progress) -> None:
        """Take what is told."""
        with self.line.hidden():
            if progress.state == "note":
                self.screen.note(progress.text)
            elif progress.state == "detail":
                self.screen.detail(progress.text)
            elif progress.state == "failed":
                self.left_out.append(progress.log)
            elif (log := progress.note) is not None:
                path = str(log.path)
                self.screen.detail(f"{path}: {log.samples} samples at {log.rate_hz:.6g} Hz")
                self.screen.knows(f"{path}: {text}" for text in log.mended)
                self.findings += log.findings
                self.partial += [path] if log.partial else []
        self.line.show(progress.done, progress.total, Path(progress.log).name)

    def warn(self, message: Warning | str, category: type[Warning], *more: Any) -> None:
        """Print a warning in the place of Python's own way."""
        with self.line.hidden():
            if issubclass(category, SeqidWarning):
                self.screen.warn(str(message))
            else:
                sys.stderr.write(warnings.formatwarning(message, category, *more[:2]))

    def tell_output(self, following: str = "") -> None:
        """Say where the result went and which command to type next."""
        output = self.given.get("output")
        if output is None:
            self.screen.note("Nothing was written: give -o FILE to keep the result.")
            return
        self.screen.note(f"written: {output}")
        if following:
            self.screen.note(f"next: {following.format(output=output, robot=self.given['robot'])}")

    def ended(self, verdicts: Sequence[Verdict] = (), *, untrusted: bool = False) -> int:
        """Return the exit code of a command that has written its result.

        After poor verdicts it says what to do. With --strict they, and what is `untrusted` for
        another reason, count.
        """
        poor = any_poor(verdicts)
        if poor:
            for remedy in dict.fromkeys(f.remedy for f in self.findings if f.severity == "error"):
                self.screen.note(f"do: {remedy}")
            self.screen.note(
                "do: look at the reasons above and mend the logs or the robot file before going on"
                + ("" if self.findings else " (seqid inspect LOG... -r ROBOT looks closer)")
            )
        if (poor or untrusted) and self.given.get("strict"):
            return EXIT_UNTRUSTED
        return EXIT_PARTIAL if self.partial or self.left_out else EXIT_DONE


@contextlib.contextmanager
def listening(context: typer.Context) -> Iterator[Told]:
    """Show progress and warnings of what is called in the block."""
    screen = screen_of(context)
    told = Told(screen, ProgressLine(sys.stderr, enabled=not screen.quiet), context.params)
    with warnings.catch_warnings():
        warnings.simplefilter("always", SeqidWarning)
        warnings.showwarning = told.warn  # type: ignore[assignment]
        try:
            with heard_by(told.line.show):
                yield told
        finally:
            told.line.close()


@contextlib.contextmanager
def workers(
    logs: Sequence[str], jobs: int | None, engine: str = "local", scheduler: str | None = None
) -> Iterator[Executor | None]:
    """Whoever is to read the logs: processes, a Dask cluster, or None for this process.

    Raises UsageError: a scheduler is given without Dask, Dask is not installed or no scheduler
    answers.
    """
    if scheduler is not None and engine != "dask":
        hint = "Add --engine dask, or leave out --scheduler."
        raise UsageError("a scheduler is of use to Dask only", hint=hint)
    count = 1 if engine == "dask" else processes_for(logs, jobs)
    if engine != "dask" and count == 1:
        yield None
        return
    from seqid_cli.scale.executors import dask_cluster, processes

    with dask_cluster(scheduler, jobs) if engine == "dask" else processes(count) as executor:
        yield executor


def processes_for(logs: Sequence[str], jobs: int | None) -> int:
    """How many processes to start for these logs; 1 means none beside this one."""
    from seqid_cli.logs.storage.files import expand
    from seqid_cli.logs.storage.remote import is_url
    from seqid_cli.scale.executors import cores

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


def show_stage(told: Told, file: ParameterFile, names: Sequence[str], following: str) -> int:
    """Show new stages of a file; returns the exit code.

    `told`: what listened to their identification. `names`: the new stages. `following`: the command
    that comes next, with `{output}` and `{robot}` to fill in; it is not proposed after a poor
    verdict.
    """
    stages = Stages(**{name: getattr(file.stages, name) for name in names})
    told.screen.document(file)
    show_stages(told.screen, stages, file.robot)
    verdicts = [verdict for name in names for verdict in getattr(stages, name).verdicts]
    told.tell_output("" if any_poor(verdicts) else following)
    return told.ended(verdicts)
