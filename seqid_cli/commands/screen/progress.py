"""One line on a terminal's stderr that tells how far a command is, once it takes half a second."""

import contextlib
import threading
import time
from collections.abc import Callable, Iterator
from typing import TextIO

from seqid_cli.commands.screen.layout import shortened

_PATIENCE_S = _TICK_S = 0.5
_CELLS, _TEXT = 16, 30
_CLEAR = "\r\x1b[2K"


class ProgressLine:
    """Draws `[#####...] 3/12 name  8 s, about 24 s left` over itself, twice a second.

    Draws nothing where no terminal listens.
    """

    def __init__(
        self, stream: TextIO, *, enabled: bool, clock: Callable[[], float] = time.monotonic
    ) -> None:
        self._stream, self._clock = stream, clock
        self._enabled = enabled and stream.isatty()
        self._state: tuple[int, int, str] = (0, 0, "starting")
        self._start = self._began = self._told = clock()  # of all, of these parts, of the last
        self._drawn = False
        self._lock, self._closed = threading.RLock(), threading.Event()
        if self._enabled:
            threading.Thread(target=self._tick, daemon=True).start()

    def show(self, done: int, total: int, text: str) -> None:
        """Say that `done` of `total` parts are finished and what comes next."""
        self._told = self._clock()
        if total != self._state[1] or done < self._state[0]:
            self._began = self._told
        self._state = (done, total, text)
        self._draw()

    @contextlib.contextmanager
    def hidden(self) -> Iterator[None]:
        """Remove the line while other text is written in the block."""
        with self._lock:
            if self._drawn:
                self._stream.write(_CLEAR)
                self._stream.flush()
                self._drawn = False
            yield

    def close(self) -> None:
        """Remove the line for good."""
        self._closed.set()
        with self.hidden():
            self._enabled = False

    def _tick(self) -> None:
        while not self._closed.wait(_TICK_S):
            self._draw()

    def _draw(self) -> None:
        now = self._clock()
        with self._lock:
            if not self._enabled or now - self._start < _PATIENCE_S:
                return
            done, total, text = self._state
            filled = min(_CELLS, _CELLS * done // max(total, 1))
            bar = "#" * filled + "." * (_CELLS - filled)
            times = f"{now - self._start:.0f} s"
            left = (self._told - self._began) * (total - done) / max(done, 1)
            if left > now - self._told:
                times += f", about {left - now + self._told:.0f} s left"
            text = (f"{done}/{total} " if total else "") + shortened(text, _TEXT)
            self._stream.write(f"{_CLEAR}{f'[{bar}] {text}  {times}'[:79]}")
            self._stream.flush()
            self._drawn = True
