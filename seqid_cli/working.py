"""Steps of work that takes long, told to whoever listens in this process, else to nobody.

Standard library only; nothing is passed down to where a part of the work begins.
"""

import contextlib
from collections.abc import Callable, Iterator
from contextvars import ContextVar

Listener = Callable[[int, int, str], None]
_listener: ContextVar[Listener | None] = ContextVar("listener", default=None)


def step(text: str, done: int, total: int) -> None:
    """Say that part `done` (from 0) of `total` begins, and what it is."""
    if (listener := _listener.get()) is not None:
        listener(done, total, text)


@contextlib.contextmanager
def heard_by(listener: Listener) -> Iterator[None]:
    """Let a listener hear the steps of the work in this block."""
    before = _listener.set(listener)
    try:
        yield
    finally:
        _listener.reset(before)
