"""Works on the logs of a command with the workers that were asked for."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Generic, TypeVar

from seqid_cli.errors import ConfigError, InputError, SeqidError, UsageError
from seqid_cli.identify.tree import Tree, or_none
from seqid_cli.scale.local import ordered
from seqid_cli.scale.options import Workers
from seqid_cli.scale.reply import Reply, answer
from seqid_cli.scale.work import Done, Item, Listener, Task

P = TypeVar("P")


def mapped_logs(
    task: Task[P], files: Sequence[Path], *, workers: Workers, listener: Listener
) -> Iterator[P]:
    """Yield the part of every log, in their order.

    Parameters
    ----------
    task : Task
        What is done with a log.
    files : sequence of Path
        Logs.
    workers : Workers
        Who does it.
    listener : Listener
        Told of every log.

    Raises
    ------
    SeqidError
        A log cannot be used, the first of them in the order given, and `workers` does not say to
        go on; or none can.
    """
    tally = _Tally(files, workers, listener)
    if workers.engine == "dask":
        from seqid_cli.scale.dask_engine import connected

        with connected(workers) as cluster:
            for leaf in cluster.leaves(task, tally.items):
                if tally.counts(leaf.note):
                    yield cluster.part(leaf)
    else:
        for reply in _replies(task, tally.items, workers, listener):
            if tally.counts(reply):
                yield reply.get().part
    tally.close()


def reduced_logs(
    task: Task[P],
    files: Sequence[Path],
    merge: Callable[[P, P], P],
    *,
    workers: Workers,
    listener: Listener,
) -> P | None:
    """Merge the parts of all logs in the shape of one tree; see `mapped_logs`."""
    tally = _Tally(files, workers, listener)
    if workers.engine == "dask":
        from seqid_cli.scale.dask_engine import connected

        with connected(workers) as cluster:
            whole = cluster.tree(merge)
            for leaf in cluster.leaves(task, tally.items):
                whole.push(leaf.part if tally.counts(leaf.note) else None)
            tally.close()
            found: P | None = cluster.result(whole.root())
            return found
    tree: Tree[P | None] = Tree(or_none(merge))
    for reply in _replies(task, tally.items, workers, listener):
        tree.push(reply.get().part if tally.counts(reply) else None)
    tally.close()
    return tree.root()


def _replies(
    task: Task[P], items: Sequence[Item], workers: Workers, listener: Listener
) -> Iterator[Reply[Done[P]]]:
    jobs = workers.processes([item.path for item in items])
    if jobs == 1:
        here = _Here(task, listener)
        return (answer(here, i) if workers.skip_failed else Reply(here(i)) for i in items)
    modules = ("seqid_cli.logs.read", type(task.part).__module__)
    return ordered(task, items, jobs=jobs, preload=modules)


@dataclass(frozen=True)
class _Here(Generic[P]):
    """A task in this process, of which the listener hears at once."""

    task: Task[P]
    listener: Listener

    def __call__(self, item: Item) -> Done[P]:
        return self.task.work(item, self.listener)


class _Tally:
    """Tells the listener of each log and keeps count of those that failed."""

    def __init__(self, files: Sequence[Path], workers: Workers, listener: Listener) -> None:
        self.items = [Item(number, path) for number, path in enumerate(files)]
        self._workers, self._listener = workers, listener
        self._told = 0
        self._errors: list[Exception] = []

    def counts(self, reply: Reply[Done[P]]) -> bool:
        """Whether the next log is of use; raises its error where nobody wants to go on."""
        item = self.items[self._told]
        self._told += 1
        if reply.error is None:
            self._listener.done(reply.get().note)
            return True
        beyond_one_log = isinstance(reply.error, UsageError | ConfigError)
        if beyond_one_log or not self._workers.skip_failed:
            raise reply.error
        self._errors.append(reply.error)
        self._listener.failed(item.path, reply.error)
        return False

    def close(self) -> None:
        """Raise the first error where no log was of use."""
        if self.items and len(self._errors) == len(self.items):
            first = self._errors[0]
            hint = first.hint if isinstance(first, SeqidError) else ""
            raise InputError(f"none of the {len(self.items)} logs can be used: {first}", hint=hint)
