"""Steps of work that takes long, reported to a listener if there is one.

Standard library only. The listener is found by the context: no argument has to be
passed down to where a part of the work begins.
"""

import contextlib
from collections.abc import Callable, Iterator
from contextvars import ContextVar

Listener = Callable[[int, int, str], None]  # part, number of parts, what it is
_listener: ContextVar[Listener | None] = ContextVar("listener", default=None)


def step(text: str, done: int, total: int) -> None:
    """Report that part `done` (from 0) of `total` begins, and what it is."""
    listener = _listener.get()
    if listener is not None:
        listener(done, total, text)


@contextlib.contextmanager
def heard_by(listener: Listener) -> Iterator[None]:
    """Let a listener hear the steps of the work in this block.

    Whoever listens outside of the block hears them as well.
    """
    outer = _listener.get()

    def both(done: int, total: int, text: str) -> None:
        listener(done, total, text)
        if outer is not None:
            outer(done, total, text)

    token = _listener.set(both)
    try:
        yield
    finally:
        _listener.reset(token)
