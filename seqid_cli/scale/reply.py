"""What comes back from work done elsewhere: a value, or the exception that it ended with."""

from __future__ import annotations

import traceback
from collections.abc import Callable
from dataclasses import dataclass
from typing import Generic, TypeVar

from seqid_cli.errors import InputError, SeqidError

T = TypeVar("T")
R = TypeVar("R")


class WorkerError(RuntimeError):
    """A bug that showed in a worker; its notes hold the traceback from there."""


@dataclass(frozen=True)
class Reply(Generic[R]):
    """A value, or the error that came instead of it."""

    value: R | None = None
    error: Exception | None = None

    def get(self) -> R:
        """Return the value.

        Raises
        ------
        Exception
            What the work ended with.
        """
        if self.error is not None:
            raise self.error
        return self.value  # type: ignore[return-value]


def answer(function: Callable[[T], R], item: T) -> Reply[R]:
    """Work on one item; whatever happens becomes a reply that can travel."""
    try:
        return Reply(function(item))
    except SeqidError as error:
        return Reply(error=error)
    except MemoryError:
        return Reply(error=out_of_memory(str(item)))
    except Exception as error:
        return Reply(error=_portable(error, str(item)))


def out_of_memory(item: str) -> InputError:
    """The error of an item that needs more memory than there is."""
    hint = "Use fewer processes (--jobs), a machine with more memory, or split the log."
    return InputError("does not fit into memory", hint=hint, where=item)


def _portable(error: Exception, item: str) -> WorkerError:
    """Any exception as one that can be sent between processes, with its traceback in words."""
    found = WorkerError(f"{item}: {type(error).__name__}: {error}")
    found.add_note("".join(traceback.format_exception(error)))
    return found
