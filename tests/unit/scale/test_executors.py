"""Work in several processes: order, failures, deaths, and nothing left behind."""

import multiprocessing
import os
import signal
import threading
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import pytest

from seqid_cli.errors import InputError, UsageError
from seqid_cli.scale import Reply, WorkerError, ordered, processes


@dataclass(frozen=True)
class Waiting:
    items: int
    step_s: float = 0.01

    def __call__(self, item: int) -> int:
        time.sleep(self.step_s * (self.items - item))
        return item


def state(_: int) -> tuple[int, int, bool]:
    """Return process, threads of BLAS, and whether it ignores interrupts."""
    import numpy as np
    from threadpoolctl import threadpool_info

    time.sleep(0.05)
    np.ones((4, 4)) @ np.ones((4, 4))
    threads = max((int(pool["num_threads"]) for pool in threadpool_info()), default=1)
    return os.getpid(), threads, signal.getsignal(signal.SIGINT) is signal.SIG_IGN


def fails(item: int) -> int:
    if item == 2:
        raise InputError("lacks the channel", hint="record it", where=f"log {item}")
    if item == 4:
        raise ZeroDivisionError("nothing to divide by")
    if item == 6:
        raise MemoryError
    return item


def dies(item: int) -> int:
    if item == 1:
        os.kill(os.getpid(), signal.SIGKILL)
    if item == 3:
        os._exit(7)
    return item


def unsendable(item: int) -> object:
    return (lambda: item) if item == 1 else item


def replies(
    function: Callable[..., Any], items: Sequence[Any], count: int
) -> list[Reply[Any]]:
    with processes(count) as executor:
        return list(ordered(executor, function, items))


def failed(found: list[Reply[Any]]) -> list[int]:
    return [k for k, reply in enumerate(found) if reply.error is not None]


def test_replies_come_in_the_order_of_the_items() -> None:
    assert [r.get() for r in replies(Waiting(12), range(12), 3)] == list(range(12))
    assert not replies(Waiting(1), [], 2)
    assert [r.get() for r in ordered(None, Waiting(3), range(3))] == [0, 1, 2]


def test_processes_share_the_work_with_one_blas_thread_each_and_no_interrupts() -> None:
    found = [reply.get() for reply in replies(state, range(8), 2)]
    workers = {pid for pid, *_ in found}
    assert len(workers) == 2
    assert os.getpid() not in workers
    assert all(threads == 1 and ignored for _, threads, ignored in found)


@pytest.mark.parametrize("here", [False, True])
def test_errors_keep_their_kind_and_bugs_their_traceback(here: bool) -> None:
    items = range(8)
    found = list(ordered(None, fails, items)) if here else replies(fails, items, 2)
    assert failed(found) == [2, 4, 6]
    with pytest.raises(InputError) as caught:
        found[2].get()
    told = caught.value.message, caught.value.hint, caught.value.where
    assert told == ("lacks the channel", "record it", "log 2")
    with pytest.raises(
        WorkerError, match=r"^4: ZeroDivisionError: nothing to divide by\n"
    ) as bug:
        found[4].get()
    assert "in fails" in bug.value.__notes__[0]
    assert str(found[6].error) == "6: does not fit into memory"


def test_a_death_is_blamed_on_the_item_at_hand_and_the_rest_is_done() -> None:
    found = replies(dies, range(8), 2)
    assert failed(found) == [1, 3]
    for number in (1, 3):
        with pytest.raises(
            InputError, match=f"^{number}: its process was killed"
        ) as caught:
            found[number].get()
        assert "--jobs" in caught.value.hint


def test_results_that_cannot_travel_have_their_own_words() -> None:
    found = replies(unsendable, range(3), 1)
    assert failed(found) == [1]
    with pytest.raises(UsageError, match="the workers cannot do this work"):
        found[1].get()


def leave(how: type[BaseException], before: set[Any]) -> None:
    with processes(2) as executor:
        work = ordered(executor, Waiting(9, step_s=10.0), [9, *range(8)])
        next(work)
        assert len(set(multiprocessing.active_children()) - before) == 2
        if how is InputError:
            raise InputError("enough")
        threading.Timer(1.0, os.kill, (os.getpid(), signal.SIGINT)).start()
        next(work)


@pytest.mark.parametrize("how", [InputError, KeyboardInterrupt])
def test_leaving_early_ends_the_processes_at_work(how: type[BaseException]) -> None:
    before = set(multiprocessing.active_children())
    # ignored in the background
    usual = signal.signal(signal.SIGINT, signal.default_int_handler)
    try:
        with pytest.raises(how):
            leave(how, before)
    finally:
        signal.signal(signal.SIGINT, usual)
    assert set(multiprocessing.active_children()) == before
