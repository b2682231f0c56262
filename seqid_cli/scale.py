"""Who works on many items: processes of this machine, a Dask cluster, or any other executor.

Everything here takes and gives a `concurrent.futures.Executor`. Results come in the
order of the items, and what goes wrong comes as an exception that names its item.
Imports nothing heavy.
"""

import contextlib
import importlib.util
import logging
import multiprocessing
import os
import signal
import traceback
import weakref
from collections import deque
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import BrokenExecutor, CancelledError, Executor, Future
from dataclasses import dataclass
from itertools import islice
from pathlib import Path
from typing import Any, Generic, TypeVar

from seqid_cli.errors import InputError, SeqidError, UsageError

T = TypeVar("T")
R = TypeVar("R")

PATIENCE_S = 10  # until a Dask scheduler must answer
PRELOAD = ("seqid_cli.inspect.screening", "seqid_cli.identify.rigid.inertia")
_ENDED_AT_ONCE: weakref.WeakSet[Executor] = weakref.WeakSet()
_QUOTA = Path("/sys/fs/cgroup/cpu.max")
_LOST = ("KilledWorker", "CancelledError", "FutureCancelledError")  # of Dask


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
    """Work on items; the replies come in the order of the items.

    `executor`: who does the work; None does it here, item by item. `function`: to be
    sent elsewhere it must be a function of a module, or an object of such a class.
    `items`: `str` of an item names it in messages. Yields: of the next item. An item
    whose process dies is tried once more in a process of its own, so that the death is
    blamed on the right one; the others go on.
    """
    if executor is None:
        yield from (answer(function, item) for item in items)
        return
    pending: deque[tuple[T, Future[Reply[R]] | None]] = deque()
    rest = iter(items)
    try:
        while True:
            for item in islice(rest, max(0, ahead * _workers(executor) - len(pending))):
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
        for _, future in pending if executor not in _ENDED_AT_ONCE else ():
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
        found = WorkerError(f"{item}: {type(error).__name__}: {error}")
        found.add_note("".join(traceback.format_exception(error)))
        return Reply(error=found)


@contextlib.contextmanager
def processes(jobs: int | None = None) -> Iterator[Executor]:
    """Processes of this machine, for as long as the block lasts; an exception ends them at once.

    They are forked from a server that has imported what they need, so that the import
    is paid once (where the system has no such server, they are started from scratch). A
    script that uses them guards its main part with `if __name__ == "__main__":`.

    `jobs`: how many; all cores by default.
    """
    from concurrent.futures import ProcessPoolExecutor

    before = set(multiprocessing.active_children())
    forked = "forkserver" in multiprocessing.get_all_start_methods()
    context: Any = multiprocessing.get_context("forkserver" if forked else "spawn")
    if forked:
        context.set_forkserver_preload(list(PRELOAD))
    # Whoever asked for the processes deals with interrupts, and ends them.
    deaf = signal.signal, (signal.SIGINT, signal.SIG_IGN)
    executor = ProcessPoolExecutor(jobs or cores(), context, *deaf)
    _ENDED_AT_ONCE.add(executor)
    try:
        yield executor
    except BaseException:
        for child in set(multiprocessing.active_children()) - before:
            child.kill()
            child.join()
        raise
    finally:
        executor.shutdown(cancel_futures=True)


@contextlib.contextmanager
def dask_cluster(
    scheduler: str | None = None, jobs: int | None = None
) -> Iterator[Executor]:
    """Connect to a Dask scheduler, or start a cluster of this machine for as long as it is needed.

    `jobs`: workers of a cluster that is started, else as many as cores. Raises
    UsageError: no scheduler answers at the address `scheduler`, or Dask is not
    installed.
    """
    if not all(map(importlib.util.find_spec, ("dask", "distributed"))):
        hint = "Install it: python -m pip install 'seqid[dask]'"
        raise UsageError("--engine dask needs Dask, which is not installed", hint=hint)
    from distributed import Client, LocalCluster

    with contextlib.ExitStack() as stack:
        address: Any = scheduler
        if scheduler is None:
            quiet = {"dashboard_address": "127.0.0.1:0", "silence_logs": logging.ERROR}
            own = LocalCluster(n_workers=jobs or cores(), threads_per_worker=1, **quiet)
            address = stack.enter_context(own)
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
    """Cores that this process may use: those it is bound to, within the container's quota."""
    bound = getattr(os, "sched_getaffinity", None)
    count = len(bound(0)) if bound is not None else os.cpu_count() or 1
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
    """How many items an executor works on at once, as far as it tells."""
    client = getattr(executor, "_client", None)  # of Dask
    if client is not None:
        return max(1, int(sum(client.nthreads().values())))
    return int(getattr(executor, "_max_workers", None) or cores())


def _reply(
    function: Callable[[T], R], item: T, future: Future[Reply[R]] | None
) -> Reply[R]:
    """The reply of an item; the loss of its worker counts as its failure."""
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
    with processes(1) as executor:  # one died of it or of another: once more, by itself
        try:
            return executor.submit(_alone, function, item).result()
        except BrokenExecutor:
            message = "its process was killed, most likely because memory ran out"
            return Reply(error=_out_of_memory(message, item))


def _out_of_memory(message: str, item: object) -> InputError:
    hint = "Use fewer processes (--jobs), a machine with more memory, or split the log."
    return InputError(message, hint=hint, where=str(item))
