"""Signals that end a run.

This is imported before everything else, so that signals end the imports as well.
"""

import signal
import sys
import time

TYPE_CHECKING = False
if TYPE_CHECKING:  # typing itself takes milliseconds in which a signal may come
    from types import FrameType
    from typing import NoReturn

ENDING = ("SIGINT", "SIGTERM", "SIGHUP")  # there is no SIGHUP on Windows
AGAIN_S = 0.01  # until an interrupt that a finalizer has swallowed is raised again
# A terminal or a supervisor sends a signal to all processes of a command, and the one
# that watches passes it on: what comes so soon after another is the same request, and
# must not end what the first has begun to clean up. A second request comes later.
SAME_S = 1.0


class Interrupted(KeyboardInterrupt):
    """An interrupt that the program answers.

    Python remembers a plain KeyboardInterrupt that passes through ``exec`` or ``eval``
    of a text, as the import of every dataclass runs them. ``python -m`` then kills the
    process with SIGINT at its end, whatever exit code the program has chosen. A class
    of its own does not set this off.
    """


def answer_signals() -> None:
    """Let the signals that end a run raise `Interrupted`.

    Those that the caller ignores stay ignored.
    """
    last_s = -SAME_S

    def interrupt(number: int, frame: "FrameType | None") -> None:
        nonlocal last_s
        now_s = time.monotonic()
        if now_s - last_s >= SAME_S:
            last_s = now_s
            _interrupt(number, frame)

    for name in ENDING:
        number = getattr(signal, name, None)
        if number is not None and signal.getsignal(number) is not signal.SIG_IGN:
            signal.signal(number, interrupt)
    sys.unraisablehook = _swallowed


def _interrupt(number: int, frame: "FrameType | None") -> "NoReturn":
    del number, frame
    raise Interrupted


def _swallowed(unraisable: "sys.UnraisableHookArgs") -> None:
    """Raise an interrupt again that came in a finalizer, where exceptions end."""
    if isinstance(unraisable.exc_value, Interrupted) and hasattr(signal, "setitimer"):
        signal.signal(signal.SIGALRM, _interrupt)
        signal.setitimer(signal.ITIMER_REAL, AGAIN_S)
    else:
        sys.__unraisablehook__(unraisable)
