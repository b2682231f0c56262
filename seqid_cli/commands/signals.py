"""Signals that end a run; imported before everything else, so that they end the imports as well."""

from __future__ import annotations

import signal

TYPE_CHECKING = False
if TYPE_CHECKING:  # typing itself takes milliseconds in which a signal may come
    from types import FrameType
    from typing import NoReturn

ENDING = ("SIGINT", "SIGTERM", "SIGHUP")  # there is no SIGHUP on Windows


class Interrupted(KeyboardInterrupt):
    """An interrupt that the program answers.

    Python remembers a plain KeyboardInterrupt that passes through ``exec`` or ``eval`` of a text,
    as the import of every dataclass runs them. ``python -m`` then kills the process with SIGINT at
    its end, whatever exit code the program has chosen. A class of its own does not set this off.
    """


def answer_signals() -> None:
    """Let the signals that end a run raise `Interrupted`; those the caller ignores stay ignored."""
    for name in ENDING:
        number = getattr(signal, name, None)
        if number is not None and signal.getsignal(number) is not signal.SIG_IGN:
            signal.signal(number, _interrupt)


def _interrupt(number: int, frame: FrameType | None) -> NoReturn:
    del number, frame
    raise Interrupted
