"""The same work as futures of a Dask cluster; parts are merged there, and only the whole travels.

The client walks through the logs in order with so many futures ahead as keep the workers busy, and
grows the same tree of merges as one process would, of futures instead of parts. Merges come before
further logs, so that a cluster holds few parts at a time.
"""

from __future__ import annotations

import contextlib
import logging
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any, Generic, TypeVar

from distributed import Client, LocalCluster

from seqid_cli.errors import InputError, SeqidError, UsageError
from seqid_cli.identify.tree import Tree, or_none
from seqid_cli.scale.options import Workers, cores
from seqid_cli.scale.reply import Reply, answer
from seqid_cli.scale.work import Done, Item, Task

P = TypeVar("P")
Future = Any  # Dask's futures know nothing of types

AHEAD = 3  # futures per thread of the cluster
MERGE_FIRST = 10  # priority of merges over further logs
PATIENCE_S = 10


@dataclass(frozen=True)
class Leaf(Generic[P]):
    """What became of a log, and the future of its part, which stays on the cluster."""

    item: Item
    note: Reply[Done[None]]
    part: Future


@contextlib.contextmanager
def connected(workers: Workers) -> Iterator[Cluster]:
    """Connect to the scheduler, or start a cluster of this machine for as long as it is needed.

    Raises
    ------
    UsageError
        No scheduler answers.
    """
    with contextlib.ExitStack() as stack:
        if workers.scheduler is None:
            address = stack.enter_context(
                LocalCluster(
                    n_workers=workers.jobs or cores(),
                    threads_per_worker=1,
                    dashboard_address="127.0.0.1:0",
                    silence_logs=logging.ERROR,
                )
            )
        else:
            address = workers.scheduler
        try:
            client = stack.enter_context(Client(address, timeout=PATIENCE_S, set_as_default=False))
        except (OSError, ValueError, TimeoutError) as error:
            message = f"no Dask scheduler answers there ({type(error).__name__}: {error})"
            hint = "Start one with `dask scheduler`, or leave out --scheduler."
            raise UsageError(message, where=str(workers.scheduler), hint=hint) from error
        yield Cluster(client)


class Cluster:
    """A connected cluster."""

    def __init__(self, client: Client) -> None:
        self._client = client

    def leaves(self, task: Task[P], items: Sequence[Item]) -> Iterator[Leaf[P]]:
        """Work on logs; yields in their order what became of each."""
        function = self._client.scatter(task, broadcast=True, hash=False)
        pending: deque[tuple[Item, Future, Future]] = deque()
        rest = iter(items)
        while True:
            ahead = AHEAD * max(1, sum(self._client.nthreads().values()))
            while len(pending) < ahead and (item := next(rest, None)) is not None:
                part = self._client.submit(_worked, function, item, pure=False)
                note = self._client.submit(_noted, part, pure=False, priority=MERGE_FIRST)
                pending.append((item, part, note))
            if not pending:
                return
            item, part, note = pending.popleft()
            yield Leaf(item, _result(note, item), part)

    def part(self, leaf: Leaf[P]) -> P:
        """Fetch one part."""
        reply: Reply[Done[P]] = leaf.part.result()
        return reply.get().part

    def tree(self, merge: Callable[[P, P], P]) -> Tree[Future]:
        """Return the tree of merges that are done on the cluster."""
        submit = partial(self._client.submit, pure=False, priority=MERGE_FIRST)
        return Tree(or_none(lambda first, second: submit(_merged, merge, first, second)))

    def result(self, whole: Future | None) -> Any:
        """Fetch the merged part."""
        if whole is None:
            return None
        try:
            return _part(whole.result())
        except SeqidError:
            raise
        except Exception as error:
            raise _cluster_error(error) from error


def _worked(task: Task[P], item: Item) -> Reply[Done[P]]:
    from threadpoolctl import threadpool_limits  # type: ignore[import-untyped]

    with threadpool_limits(1):
        return answer(task, item)


def _noted(reply: Reply[Done[P]]) -> Reply[Done[None]]:
    if reply.error is not None:
        return Reply(error=reply.error)
    return Reply(Done(reply.get().note, None))


def _merged(merge: Callable[[P, P], P], first: Any, second: Any) -> P:
    from threadpoolctl import threadpool_limits

    with threadpool_limits(1):
        return merge(_part(first), _part(second))


def _part(found: Any) -> Any:
    """What is merged: a log's reply holds its part, a merge's result is one."""
    return found.get().part if isinstance(found, Reply) else found


def _result(note: Future, item: Item) -> Reply[Done[None]]:
    """What became of a log; the loss of its worker is blamed on it."""
    try:
        found: Reply[Done[None]] = note.result()
    except Exception as error:
        if type(error).__name__ in ("KilledWorker", "CancelledError", "FutureCancelledError"):
            hint = "Give the workers more memory, or split the log."
            message = "the Dask workers that worked on it died or were lost"
            return Reply(error=InputError(message, hint=hint, where=str(item)))
        raise _cluster_error(error) from error
    return found


def _cluster_error(error: Exception) -> UsageError:
    message = f"the Dask workers cannot do this work ({type(error).__name__}: {error})"
    hint = "They need the same versions of Python, seqid and its dependencies as this machine."
    return UsageError(message, hint=hint)
