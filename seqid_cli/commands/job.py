"""What commands have in common: they listen to one function, and turn its result into a code."""

from __future__ import annotations

import contextlib
import sys
import warnings
from collections.abc import Iterator, Mapping, Sequence
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

    def ended(self, verdicts: Sequence[Verdict], *, strict: bool) -> int:
        """Say what to do about poor verdicts; returns the exit code of the command."""
        poor = any_poor(verdicts)
        if poor:
            tell_remedies(self.screen, self.findings)
        partial = [*self.partial, *self.left_out]
        return exit_code(untrusted=strict and poor, partial=partial)


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


def exit_code(*, untrusted: bool, partial: Sequence[str] = ()) -> int:
    """Return the exit code of a command that has written its result."""
    if untrusted:
        return EXIT_UNTRUSTED
    return EXIT_PARTIAL if partial else EXIT_DONE


def any_poor(verdicts: Sequence[Verdict]) -> bool:
    """Whether a verdict is not good."""
    return any(not verdict.good for verdict in verdicts)


def tell_output(screen: Screen, output: Path | None, robot: Path, following: str = "") -> None:
    """Say where the result went and which command to type next."""
    if output is None:
        screen.note("Nothing was written: give -o FILE to keep the result.")
        return
    screen.note(f"written: {output}")
    if following:
        screen.note(f"next: {following.format(output=output, robot=robot)}")


def tell_remedies(screen: Screen, findings: Sequence[InspectionFinding]) -> None:
    """Say what to do after a poor verdict."""
    for remedy in dict.fromkeys(f.remedy for f in findings if f.severity == "error"):
        screen.note(f"do: {remedy}")
    screen.note(
        "do: look at the reasons above and mend the logs or the robot file before going on"
        + ("" if findings else " (seqid inspect LOG... -r ROBOT looks closer)")
    )


def show_stage(told: Told, file: ParameterFile, names: Sequence[str], following: str) -> int:
    """Show new stages of a file; returns the exit code.

    `told`: what listened to their identification. `names`: the new stages. `following`: the command
    that comes next, with `{output}` and `{robot}` to fill in; it is not proposed after a poor
    verdict.
    """
    stages = Stages(**{name: getattr(file.stages, name) for name in names})
    told.screen.document(file)
    show_stages(told.screen, stages, file.robot)
    verdicts, given = [v for name in names for v in getattr(stages, name).verdicts], told.given
    following = "" if any_poor(verdicts) else following
    tell_output(told.screen, given.get("output"), given["robot"], following)
    return told.ended(verdicts, strict=given.get("strict", False))
