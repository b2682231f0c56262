"""Work on many items in several processes of this machine.

The processes are forked from a server that has imported what they need, so that the import is paid
once and not per process (where the system has no such server, they are started from scratch). Each
is told its items one by one, at most two at a time, and answers on a pipe of its own. Hence a
process that dies (out of memory, say) is known to have died of the item that it had; the others go
on. Items and answers travel as Python's own serialisation between processes of one user; nothing is
ever read from a file or a socket that way.
"""

from __future__ import annotations

import contextlib
import multiprocessing
import signal
from collections import deque
from collections.abc import Callable, Generator, Iterator, Sequence
from multiprocessing.connection import Connection, wait
from multiprocessing.context import BaseContext
from multiprocessing.process import BaseProcess
from typing import Any, Generic, TypeVar

from seqid_cli.errors import InputError
from seqid_cli.scale.reply import Reply, WorkerError, answer, out_of_memory

T = TypeVar("T")
R = TypeVar("R")

DEPTH = 2  # items that a process has at hand: one to work on and the next
AHEAD = 2  # answers per process that may wait for an earlier item's
PATIENCE_S = 2.0  # that a process gets to end when told to


def ordered(
    function: Callable[[T], R], items: Sequence[T], *, jobs: int, preload: Sequence[str] = ()
) -> Generator[Reply[R], None, None]:
    """Work on items in processes; the replies come in the order of the items.

    Parameters
    ----------
    function : callable
        Can be sent to another process: a function of a module, or an object of such a class.
    items : sequence
        `str` of an item names it in messages.
    jobs : int
        Processes.
    preload : sequence of str
        Modules that the processes share.

    Yields
    ------
    Reply
        Of the next item. When the iteration ends or is left, so do the processes.
    """
    crew: _Crew[T, R] = _Crew(function, items, jobs, _context(preload))
    try:
        yield from crew.replies()
    finally:
        crew.stop()


def _context(preload: Sequence[str]) -> BaseContext:
    if "forkserver" not in multiprocessing.get_all_start_methods():
        return multiprocessing.get_context("spawn")
    context = multiprocessing.get_context("forkserver")
    context.set_forkserver_preload(list(preload))
    return context


class _Worker:
    """A process, the pipe to it and the items that it has been told, the current one first."""

    def __init__(self, function: Callable[[Any], Any], context: BaseContext) -> None:
        self.pipe, theirs = context.Pipe()
        self.told: deque[int] = deque()
        make: Callable[..., BaseProcess] = context.Process  # type: ignore[attr-defined]
        self.process = make(target=serve, args=(theirs, function), daemon=True)
        self.process.start()
        theirs.close()

    def stop(self) -> None:
        """End the process, whatever it is doing."""
        self.pipe.close()
        self.process.terminate()
        self.process.join(PATIENCE_S)
        if self.process.is_alive():
            self.process.kill()
            self.process.join()
        self.process.close()


class _Crew(Generic[T, R]):
    def __init__(
        self, function: Callable[[T], R], items: Sequence[T], jobs: int, context: BaseContext
    ) -> None:
        self._function, self._items, self._context = function, items, context
        self._workers: list[_Worker] = []
        self._jobs = min(jobs, len(items))
        self._next = 0  # the first item that nobody has been told
        self._known: dict[int, Reply[R]] = {}

    def replies(self) -> Iterator[Reply[R]]:
        for _ in range(self._jobs):
            self._workers.append(_Worker(self._function, self._context))
        for number in range(len(self._items)):
            while number not in self._known:
                self._tell(number)
                self._listen()
            yield self._known.pop(number)

    def stop(self) -> None:
        for worker in self._workers:
            worker.stop()
        self._workers.clear()

    def _tell(self, number: int) -> None:
        """Hand out items, evenly, but not far beyond the one that is waited for."""
        limit = min(len(self._items), number + self._jobs * (DEPTH + AHEAD))
        for depth in range(DEPTH):
            for worker in self._workers:
                if len(worker.told) == depth and self._next < limit:
                    self._send(worker, self._next)
                    self._next += 1

    def _send(self, worker: _Worker, number: int) -> None:
        worker.told.append(number)
        with contextlib.suppress(OSError):  # it has died: `_listen` finds out
            worker.pipe.send(self._items[number])

    def _listen(self) -> None:
        pipes = {worker.pipe: worker for worker in self._workers if worker.told}
        for pipe in wait(list(pipes)):
            assert isinstance(pipe, Connection)
            worker = pipes[pipe]
            try:
                self._known[worker.told[0]] = pipe.recv()
                worker.told.popleft()
            except (EOFError, OSError):
                self._replace(worker)

    def _replace(self, worker: _Worker) -> None:
        """Blame the death of a process on its item; let another one do what it had left."""
        worker.process.join(PATIENCE_S)
        number = worker.told.popleft()
        self._known[number] = Reply(error=_died(worker.process.exitcode, str(self._items[number])))
        worker.stop()
        fresh = _Worker(self._function, self._context)
        self._workers[self._workers.index(worker)] = fresh
        for left in worker.told:
            self._send(fresh, left)


def serve(pipe: Connection, function: Callable[[Any], Any]) -> None:
    """Answer items until nobody asks any more; runs in a process of its own."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # the asking process stops this one
    from threadpoolctl import threadpool_limits  # type: ignore[import-untyped]

    with contextlib.suppress(EOFError, OSError), threadpool_limits(1):
        while True:
            item = pipe.recv()
            reply = answer(function, item)
            try:
                pipe.send(reply)
            except OSError:
                raise
            except Exception as error:  # whatever its parts raise when they are taken apart
                pipe.send(Reply(error=WorkerError(f"{item}: its result cannot be sent: {error}")))


def _died(code: int | None, item: str) -> InputError:
    if code == -signal.SIGKILL:
        error = out_of_memory(item)
        return InputError(
            "its process was killed, most likely because memory ran out",
            hint=error.hint,
            where=item,
        )
    how = f"by signal {-code}" if code is not None and code < 0 else f"with exit code {code}"
    hint = "Run the same command with --jobs 1 --debug to see why."
    return InputError(f"its process ended {how}", hint=hint, where=item)
