"""One line on a terminal's stderr that tells how far a command is."""

import contextlib
import threading
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import TYPE_CHECKING, TextIO

from seqid_cli.commands.screen.layout import can_be_steered, shortened, visible_cell

if TYPE_CHECKING:
    from rich.progress import Progress, TaskID

PATIENCE_S = 0.5  # a command that is faster needs no line, and no import of rich
NAME_WIDTH = 30  # characters: with bar and times the line fits 80 columns


@dataclass(frozen=True)
class Step:
    """Parts that are done of a total, 0 where nobody knows it, and the next part."""

    done: int
    total: int
    text: str


class ProgressLine:
    """Draws parts, what comes next and times over itself, while a command takes long.

    Draws nothing where no terminal listens, and where NO_COLOR forbids controls.
    """

    def __init__(
        self,
        stream: TextIO,
        *,
        enabled: bool,
        color: bool = False,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        self._stream = stream
        self._enabled = enabled and can_be_steered(stream)
        self._color = color
        self._clock = clock
        self._start_s = clock()
        self._step = Step(0, 0, "starting")
        self._bar: Progress | None = None
        self._task: TaskID | None = None
        # Steps come from the thread that works; the timer has its own.
        self._lock = threading.RLock()
        self._timer = threading.Timer(PATIENCE_S, self._draw)
        self._timer.daemon = True
        if self._enabled:
            self._timer.start()

    def show(self, done: int, total: int, text: str) -> None:
        """Say that `done` of `total` parts are finished and what comes next."""
        with self._lock:
            step_before = self._step
            self._step = Step(done, total, text)
            if self._bar is None:
                self._draw()
            elif total != step_before.total or done < step_before.done:
                self._begin_parts()
            elif self._task is not None:
                self._bar.update(self._task, completed=done, description=self._words())

    @contextlib.contextmanager
    def hidden(self) -> Iterator[None]:
        """Remove the line while other text is written in the block."""
        with self._lock:
            if self._bar is not None:
                self._bar.stop()
            yield
            if self._bar is not None and self._enabled:
                self._bar.start()

    def close(self) -> None:
        """Remove the line for good."""
        self._timer.cancel()
        with self._lock:
            self._enabled = False
            if self._bar is not None:
                self._bar.stop()

    def _draw(self) -> None:
        """Draw the line for the first time, if the command has taken long enough."""
        with self._lock:
            early = self._clock() - self._start_s < PATIENCE_S
            if not self._enabled or self._bar is not None or early:
                return
            from seqid_cli.commands.screen.progress_bar import progress_bar

            self._bar = progress_bar(self._stream, color=self._color, clock=self._clock)
            self._begin_parts()
            self._bar.start()

    def _begin_parts(self) -> None:
        """Count parts anew, and the time that they take."""
        if self._bar is None:
            return
        if self._task is not None:
            self._bar.remove_task(self._task)
        self._task = self._bar.add_task(
            self._words(),
            total=self._step.total or None,
            completed=self._step.done,
        )
        # The first mark on the clock: the next part that is done gives a speed.
        self._bar.advance(self._task, 0)

    def _words(self) -> str:
        name = shortened(visible_cell(self._step.text), NAME_WIDTH)
        if self._step.total == 0:
            return name
        return f"{self._step.done}/{self._step.total} {name}"
