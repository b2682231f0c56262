"""Work on many items by processes of this machine, a Dask cluster, or any executor.

Everything here takes and gives a `concurrent.futures.Executor`. Results come in the
order of the items, and what goes wrong comes as an exception that names its item.
Imports nothing heavy.
"""

from __future__ import annotations

import contextlib
import os
import signal
import traceback
import weakref
from collections import deque
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from itertools import islice
from pathlib import Path
from typing import TYPE_CHECKING, Any, Generic, TypeVar

from seqid_cli.errors import InputError, SeqidError, UsageError

if TYPE_CHECKING:
    from concurrent.futures import Executor, Future

T = TypeVar("T")
R = TypeVar("R")

PATIENCE_S = 10  # until a Dask scheduler must answer
PRELOAD = ("seqid_cli.inspect.screening", "seqid_cli.identify.rigid.inertia")
# Pools whose processes are killed where their block raises.
_ENDED_AT_ONCE: weakref.WeakSet[Executor] = weakref.WeakSet()
_QUOTA = Path("/sys/fs/cgroup/cpu.max")
# Errors by which Dask says that a worker was lost.
_LOST = ("KilledWorker", "CancelledError", "FutureCancelledError")


class WorkerError(RuntimeError):
    """A bug that showed in a worker; its notes hold the traceback from there."""


@dataclass(frozen=True)
class Reply(Generic[R]):
    """A value, or the error that came instead of it."""

    value: R | None = None
    error: Exception | None = None

    def get(self) -> R:
        """Return the value, or raise what the work ended with."""
        if self.error is not None:
            raise self.error
        return self.value  # type: ignore[return-value]


def ordered(
    executor: Executor | None,
    function: Callable[[T], R],
    items: Iterable[T],
    *,
    ahead: int = 3,
) -> Iterator[Reply[R]]:
    """Work on items, and yield the replies in the order of the items.

    Parameters
    ----------
    executor : Executor or None
        Who does the work; None does it here, item by item.
    function : callable
        What is done with an item. To be sent elsewhere it must be a function of a
        module, or an object of a class of a module.
    items : iterable
        `str` of an item names it in messages.
    ahead : int
        Items per worker that are handed out before their replies are asked for.

    Yields
    ------
    Reply
        Of the next item. An item whose process dies is tried once more in a process of
        its own, so that the death is blamed on the right one; the others go on.
    """
    if executor is None:
        yield from (answer(function, item) for item in items)
        return
    from concurrent.futures import BrokenExecutor

    pending: deque[tuple[T, Future[Reply[R]] | None]] = deque()
    remaining = iter(items)
    try:
        while True:
            # Hand out no more than is soon worked on: items and replies take memory.
            free_places = max(0, ahead * _workers(executor) - len(pending))
            for item in islice(remaining, free_places):
                future = None
                with contextlib.suppress(BrokenExecutor):
                    future = executor.submit(_alone, function, item)
                pending.append((item, future))
            if not pending:
                return
            item, future = pending.popleft()
            yield _reply(function, item, future)
    finally:
        # A pool that is about to be ended must not find futures that were cancelled.
        if executor not in _ENDED_AT_ONCE:
            for _, future in pending:
                if future is not None:
                    future.cancel()


def answer(function: Callable[[T], R], item: T) -> Reply[R]:
    """Work on one item; whatever happens becomes a reply that can travel."""
    try:
        return Reply(function(item))
    except SeqidError as error:
        return Reply(error=error)
    except MemoryError:
        return Reply(error=_out_of_memory("does not fit into memory", item))
    except Exception as error:
        worker_error = WorkerError(f"{item}: {type(error).__name__}: {error}")
        worker_error.add_note("".join(traceback.format_exception(error)))
        return Reply(error=worker_error)


@contextlib.contextmanager
def processes(jobs: int | None = None) -> Iterator[Executor]:
    """Start processes of this machine, for as long as the block lasts.

    An exception in the block ends them at once. They are forked from a server that has
    imported what they need, so that the import is paid once (where the system has no
    such server, they are started from scratch). A script that uses them guards its main
    part with `if __name__ == "__main__":`.

    Parameters
    ----------
    jobs : int, optional
        Number of processes; all cores by default.
    """
    import multiprocessing
    from concurrent.futures import ProcessPoolExecutor

    earlier_children = set(multiprocessing.active_children())
    has_server = "forkserver" in multiprocessing.get_all_start_methods()
    method = "forkserver" if has_server else "spawn"
    context: Any = multiprocessing.get_context(method)
    if has_server:
        context.set_forkserver_preload(list(PRELOAD))
    # A worker ignores interrupts: whoever asked for the processes deals with them, and
    # ends the workers.
    executor = ProcessPoolExecutor(
        jobs or cores(),
        context,
        initializer=signal.signal,
        initargs=(signal.SIGINT, signal.SIG_IGN),
    )
    _ENDED_AT_ONCE.add(executor)
    try:
        yield executor
    except BaseException:
        for child in set(multiprocessing.active_children()) - earlier_children:
            child.kill()
            child.join()
        raise
    finally:
        executor.shutdown(cancel_futures=True)


@contextlib.contextmanager
def dask_cluster(
    scheduler: str | None = None, jobs: int | None = None
) -> Iterator[Executor]:
    """Connect to a Dask cluster for as long as the block lasts.

    Parameters
    ----------
    scheduler : str, optional
        Address of a scheduler; without it a cluster of this machine is started.
    jobs : int, optional
        Workers of a cluster that is started; as many as cores by default.

    Raises
    ------
    UsageError
        No scheduler answers at the address, or Dask is not installed.
    """
    import importlib.util
    import logging

    if not all(map(importlib.util.find_spec, ("dask", "distributed"))):
        hint = "Install it: python -m pip install 'seqid[dask]'"
        raise UsageError("--engine dask needs Dask, which is not installed", hint=hint)
    from distributed import Client, LocalCluster

    with contextlib.ExitStack() as stack:
        address: Any = scheduler
        if scheduler is None:
            cluster = LocalCluster(
                n_workers=jobs or cores(),
                threads_per_worker=1,
                dashboard_address="127.0.0.1:0",
                silence_logs=logging.ERROR,
            )
            address = stack.enter_context(cluster)
        try:
            client = stack.enter_context(
                Client(address, timeout=PATIENCE_S, set_as_default=False)
            )
        except (OSError, ValueError, TimeoutError) as error:
            message = (
                f"no Dask scheduler answers there ({type(error).__name__}: {error})"
            )
            hint = "Start one with `dask scheduler`, or leave out --scheduler."
            raise UsageError(message, where=str(scheduler), hint=hint) from error
        yield client.get_executor(pure=False)


def cores() -> int:
    """Return the number of cores that this process may use.

    These are the cores that it is bound to, within the container's quota.
    """
    # Not every system binds processes to cores.
    affinity = getattr(os, "sched_getaffinity", None)
    count = len(affinity(0)) if affinity is not None else os.cpu_count() or 1
    with contextlib.suppress(OSError, ValueError):
        quota, period = _QUOTA.read_text().split()
        count = min(count, max(1, int(quota) // int(period)))
    return count


def _alone(function: Callable[[T], R], item: T) -> Reply[R]:
    """Answer with linear algebra in one thread; runs in a worker."""
    from threadpoolctl import threadpool_limits  # type: ignore[import-untyped]

    with threadpool_limits(1):
        return answer(function, item)


def _workers(executor: Executor) -> int:
    """Return how many items an executor works on at once, as far as it tells."""
    client = getattr(executor, "_client", None)  # of Dask
    if client is not None:
        return max(1, int(sum(client.nthreads().values())))
    return int(getattr(executor, "_max_workers", None) or cores())


def _reply(
    function: Callable[[T], R], item: T, future: Future[Reply[R]] | None
) -> Reply[R]:
    """Return the reply of an item; the loss of its worker counts as its failure."""
    from concurrent.futures import BrokenExecutor, CancelledError

    try:
        if future is not None:
            return future.result()
    except BrokenExecutor:
        pass
    except (CancelledError, Exception) as error:
        if type(error).__name__ in _LOST:
            message = "the workers that worked on it died or were lost"
            return Reply(error=_out_of_memory(message, item))
        message = f"the workers cannot do this work ({type(error).__name__}: {error})"
        hint = (
            "They need the same versions of Python, seqid and its dependencies as this"
            " machine."
        )
        return Reply(error=UsageError(message, hint=hint))
    # A process died of this item or of another one: once more, by itself.
    with processes(1) as executor:
        try:
            return executor.submit(_alone, function, item).result()
        except BrokenExecutor:
            message = "its process was killed, most likely because memory ran out"
            return Reply(error=_out_of_memory(message, item))


def _out_of_memory(message: str, item: object) -> InputError:
    """Return the error of an item that took too much memory."""
    hint = "Use fewer processes (--jobs), a machine with more memory, or split the log."
    return InputError(message, hint=hint, where=str(item))
