"""One run of a command: what all commands do before, around and after their function.

with CommandRun("gravity", quiet=quiet, verbose=verbose, ...) as run:
    robot = run.robot_file(robot, logs)
    file = identify.gravity(
        logs,
        robot,
        ...,
        settings=run.settings(GravitySettings(), set_values),
        on_progress=run.on_progress,
    )
run.screen.document(file)
...
return run.exit_code(verdicts, strict=strict)
"""

import contextlib
import shlex
import sys
import warnings
from collections.abc import Sequence
from pathlib import Path
from types import TracebackType
from typing import TYPE_CHECKING, Any, Self, TypeVar

from seqid_cli.commands.robot_file import found_robot
from seqid_cli.commands.screen.progress import ProgressLine
from seqid_cli.commands.screen.render import screen_for
from seqid_cli.errors import SeqidError, SeqidWarning, UsageError
from seqid_cli.params.document import worst_level
from seqid_cli.params.schema import Verdict
from seqid_cli.settings import Settings, overridden
from seqid_cli.working import heard_by

if TYPE_CHECKING:
    from concurrent.futures import Executor

    from seqid_cli.inspect.progress import Progress
    from seqid_cli.params.results.inspection import InspectionFinding

S = TypeVar("S", bound=Settings)

EXIT_DONE = 0
EXIT_UNTRUSTED = 1
EXIT_PARTIAL = 3
# Below this many bytes of logs one process is done before others have imported what
# they need.
WORTH_BYTES = 32_000_000


def quoted(path: object) -> str:
    """Return a path as a shell takes it, with quotes where it has blanks."""
    return shlex.quote(str(path))


class CommandRun:
    """A run that shows what its function reports, and keeps what counts later.

    Parameters
    ----------
    command : str
        Its name, for messages.
    quiet, verbose, json, no_color : bool
        The flags that every command has for its screen.

    Attributes
    ----------
    screen : Screen
        Where everything is shown.
    findings : list of InspectionFinding
        What was found wrong with the logs that were read.
    is_partial : bool
        Whether a log was read in part, or not at all.
    """

    def __init__(
        self, command: str, *, quiet: bool, verbose: bool, json: bool, no_color: bool
    ) -> None:
        self.screen = screen_for(
            command, quiet=quiet, verbose=verbose, json=json, no_color=no_color
        )
        self.findings: list[InspectionFinding] = []
        self.is_partial = False
        self._stack = contextlib.ExitStack()

    def __enter__(self) -> Self:
        """Start to listen."""
        # The line is made here and not before: the patience of its timer starts now.
        self._line = ProgressLine(
            sys.stderr,
            enabled=not self.screen.quiet,
            color=self.screen.color_messages,
        )
        self._stack.enter_context(warnings.catch_warnings())
        self._stack.enter_context(contextlib.closing(self._line))
        self._stack.enter_context(heard_by(self._line.show))
        warnings.simplefilter("always", SeqidWarning)
        warnings.showwarning = self._show_warning  # type: ignore[assignment]
        return self

    def __exit__(
        self,
        error_type: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        """Send readers of logs home, and give warnings back to Python."""
        self._stack.__exit__(error_type, error, trace)

    def robot_file(self, robot: Path | None, logs: Sequence[str] = ()) -> Path:
        """Return the robot file that -r names, or else the one that is found."""
        return robot or found_robot(self.screen, logs)

    def settings(self, defaults: S, set_values: Sequence[str] | None) -> S:
        """Return the settings of a command with what --set gives."""
        return overridden(defaults, set_values or ())

    def log_readers(
        self,
        logs: Sequence[str],
        *,
        jobs: int | None,
        engine: str,
        scheduler: str | None,
    ) -> "Executor | None":
        """Start the processes, or the Dask cluster, that read the logs in this run.

        Parameters
        ----------
        logs : sequence of str
            Their number and size say how many processes are worth it.
        jobs : int or None
            How many are asked for.
        engine : str
            "local" or "dask".
        scheduler : str or None
            Address of a running Dask scheduler.

        Returns
        -------
        Executor or None
            None where this process reads the logs itself.

        Raises
        ------
        UsageError
            A scheduler is named, but the engine is not Dask.
        """
        if engine == "dask":
            from seqid_cli.scale import dask_cluster

            return self._stack.enter_context(dask_cluster(scheduler, jobs))

        if scheduler is not None:
            hint = "Add --engine dask, or leave out --scheduler."
            raise UsageError("a scheduler is of use to Dask only", hint=hint)
        count = process_count(logs, jobs)
        if count == 1:
            return None
        from seqid_cli.scale import processes

        return self._stack.enter_context(processes(count))

    def on_progress(self, progress: "Progress") -> None:
        """Show what a function reports before, during and after each log."""
        if progress.state == "step":  # the line hears them by itself
            return
        if progress.state == "note":
            with self._line.hidden():
                self.screen.note(progress.text)
        elif progress.state == "detail":
            self._show_detail(progress.text)
        elif progress.state == "failed":
            self.is_partial = True
        elif (log := progress.note) is not None:
            path = str(log.path)
            self._show_detail(f"{path}: {log.samples} samples at {log.rate_hz:.6g} Hz")
            # The log's own result repeats these; they need not be said twice.
            self.screen.already_said.update(f"{path}: {text}" for text in log.mended)
            self.findings += log.findings
            self.is_partial = self.is_partial or bool(log.partial)
        self._line.show(progress.done, progress.total, Path(progress.log).name)

    def show_output(self, output: Path | None, next_command: str = "") -> None:
        """Say where the result went, and which command to type next."""
        if output is None:
            self.screen.note("Nothing was written: give -o FILE to keep the result.")
            return
        self.screen.note(f"written: {output}")
        if next_command:
            self.screen.note(f"next: {next_command}")

    def exit_code(
        self,
        verdicts: Sequence[Verdict] = (),
        *,
        strict: bool,
        is_untrusted: bool = False,
    ) -> int:
        """Return the exit code of a command that has shown its result.

        Poor verdicts are followed by what to do. With `strict`, verdicts that are not
        good count, and so does a result that is untrusted for another reason.
        """
        if worst_level(verdicts) == "poor":
            self._show_remedies()
        if strict and (is_untrusted or any_not_good(verdicts)):
            return EXIT_UNTRUSTED
        return EXIT_PARTIAL if self.is_partial else EXIT_DONE

    def _show_remedies(self) -> None:
        """Say what to do about a poor verdict: about errors in the logs first."""
        errors = [x for x in self.findings if x.severity == "error"]
        for remedy in dict.fromkeys(finding.remedy for finding in errors):
            self.screen.note(f"do: {remedy}")

        advice = (
            "do: look at the reasons above and mend the logs or the robot file before"
            " going on"
        )
        if not self.findings:
            advice += " (seqid inspect LOG... -r ROBOT looks closer)"
        self.screen.note(advice)

    def _show_warning(
        self,
        message: Warning | str,
        category: type[Warning],
        filename: str,
        line_number: int,
        *_: Any,
    ) -> None:
        """Show a warning as the screen does, and not as Python would."""
        with self._line.hidden():
            if issubclass(category, SeqidWarning):
                self.screen.warn(str(message))
            else:
                text = warnings.formatwarning(message, category, filename, line_number)
                sys.stderr.write(text)

    def _show_detail(self, text: str) -> None:
        """Show what only -v asks for."""
        if self.screen.verbose:  # else the line would blink for nothing
            with self._line.hidden():
                self.screen.detail(text)


def process_count(logs: Sequence[str], jobs: int | None) -> int:
    """Return how many processes read these logs; 1 means this one alone."""
    from seqid_cli.logs.storage.files import expand
    from seqid_cli.logs.storage.remote import is_url
    from seqid_cli.scale import cores

    if jobs == 1:
        return 1
    # Sizes on object storage would have to be asked for; such logs are worth processes.
    if any(map(is_url, logs)):
        return jobs or cores()

    try:
        sizes = [path.stat().st_size for path in expand(logs)]
    except (SeqidError, OSError):  # whoever reads the logs says so
        return jobs or 1
    if jobs is None and sum(sizes) < WORTH_BYTES:
        return 1
    return max(1, min(jobs or cores(), len(sizes)))


def any_not_good(verdicts: Sequence[Verdict]) -> bool:
    """Return whether a verdict is not good."""
    return any(not verdict.good for verdict in verdicts)
