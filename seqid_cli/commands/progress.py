"""One line on a terminal's stderr that tells how far a command is, once it takes a second."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import TextIO

from seqid_cli.commands.layout import shortened

_PATIENCE_S = 1.0
_CELLS = 20
_CLEAR = "\r\x1b[2K"


class ProgressLine:
    """Draws `[#####...] 3/12 name` over itself; draws nothing where no terminal listens."""

    def __init__(
        self,
        stream: TextIO,
        *,
        enabled: bool,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        self._stream = stream
        self._enabled = enabled and stream.isatty()
        self._clock = clock
        self._start = clock()
        self._drawn = False

    def show(self, done: int, total: int, text: str) -> None:
        """Say that `done` of `total` parts are finished and what comes next."""
        if not self._enabled or self._clock() - self._start < _PATIENCE_S:
            return
        filled = min(_CELLS, _CELLS * done // max(total, 1))
        bar = "#" * filled + "." * (_CELLS - filled)
        self._stream.write(f"{_CLEAR}[{bar}] {done}/{total} {shortened(text, 40)}")
        self._stream.flush()
        self._drawn = True

    def clear(self) -> None:
        """Remove the line so that other text can be written."""
        if self._drawn:
            self._stream.write(_CLEAR)
            self._stream.flush()
            self._drawn = False
