"""Work in several processes: order, failures, deaths, and that nothing is left behind."""

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
from seqid_cli.scale.executors import Reply, WorkerError, ordered, processes


def square(item: int) -> int:
    return item * item


@dataclass(frozen=True)
class Waiting:
    """Waits the longer the earlier the item is."""

    items: int
    step_s: float = 0.01

    def __call__(self, item: int) -> int:
        time.sleep(self.step_s * (self.items - item))
        return item


def process(item: int) -> int:
    time.sleep(0.05)
    return os.getpid()


def threads(item: int) -> list[int]:
    import numpy as np
    from threadpoolctl import threadpool_info

    np.ones((4, 4)) @ np.ones((4, 4))
    return [int(pool["num_threads"]) for pool in threadpool_info()]


def interrupt_handler(item: int) -> bool:
    return signal.getsignal(signal.SIGINT) is signal.SIG_IGN


def fails(item: int) -> int:
    if item == 2:
        raise InputError("lacks the channel", hint="record it", where=f"log {item}")
    if item == 4:
        raise ZeroDivisionError("nothing to divide by")
    return item


def dies(item: int) -> int:
    if item == 1:
        os.kill(os.getpid(), signal.SIGKILL)
    if item == 3:
        os._exit(7)
    return item


def unsendable(item: int) -> object:
    return (lambda: item) if item == 1 else item


def out_of_memory(item: int) -> int:
    raise MemoryError


def replies(function: Callable[..., Any], items: Sequence[Any], count: int) -> list[Reply[Any]]:
    with processes(count) as executor:
        return list(ordered(executor, function, items))


def test_replies_come_in_the_order_of_the_items() -> None:
    assert [r.get() for r in replies(square, range(7), 2)] == [k * k for k in range(7)]
    assert [r.get() for r in replies(Waiting(12), range(12), 3)] == list(range(12))
    assert not replies(square, [], 2)
    assert [r.get() for r in ordered(None, square, range(3))] == [0, 1, 4]


def test_several_processes_share_the_work_with_one_blas_thread_each() -> None:
    found = {reply.get() for reply in replies(process, range(8), 2)}
    assert len(found) == 2
    assert os.getpid() not in found
    (counts,) = [reply.get() for reply in replies(threads, [0], 1)]
    assert set(counts) <= {1}


def test_workers_leave_interrupts_to_the_asking_process() -> None:
    assert [reply.get() for reply in replies(interrupt_handler, [0], 1)] == [True]


@pytest.mark.parametrize("here", [False, True])
def test_errors_keep_their_kind_and_bugs_their_traceback(here: bool) -> None:
    items = range(6)
    found = list(ordered(None, fails, items)) if here else replies(fails, items, 2)
    assert [k for k, reply in enumerate(found) if reply.error is None] == [0, 1, 3, 5]
    with pytest.raises(InputError) as caught:
        found[2].get()
    assert (caught.value.message, caught.value.hint) == ("lacks the channel", "record it")
    assert caught.value.where == "log 2"
    with pytest.raises(WorkerError, match=r"^4: ZeroDivisionError: nothing to divide by\n") as bug:
        found[4].get()
    assert "in fails" in bug.value.__notes__[0]


def test_a_death_is_blamed_on_the_item_at_hand_and_the_rest_is_done() -> None:
    found = replies(dies, range(8), 2)
    assert [k for k, reply in enumerate(found) if reply.error is None] == [0, 2, 4, 5, 6, 7]
    for number in (1, 3):
        assert isinstance(found[number].error, InputError)
        assert str(found[number].error).startswith(f"{number}: its process was killed")
        assert "--jobs" in found[number].error.hint


def test_memory_and_results_that_cannot_travel_have_their_own_words() -> None:
    (full,) = replies(out_of_memory, ["a.parquet"], 1)
    assert str(full.error) == "a.parquet: does not fit into memory"
    found = replies(unsendable, range(3), 1)
    assert [reply.error is None for reply in found] == [True, False, True]
    assert isinstance(found[1].error, UsageError)
    assert "the workers cannot do this work" in str(found[1].error)


def leave_early(before: set[Any]) -> None:
    with processes(2) as executor:
        next(ordered(executor, Waiting(9, step_s=10.0), [9, *range(8)]))
        assert len(set(multiprocessing.active_children()) - before) == 2
        raise InputError("enough")


def test_leaving_early_ends_the_processes() -> None:
    before = set(multiprocessing.active_children())
    with pytest.raises(InputError, match="enough"):
        leave_early(before)
    assert set(multiprocessing.active_children()) == before


def test_an_interrupt_ends_the_processes_in_the_middle_of_their_work() -> None:
    before = set(multiprocessing.active_children())
    usual = signal.signal(signal.SIGINT, signal.default_int_handler)  # ignored in the background
    threading.Timer(1.0, os.kill, (os.getpid(), signal.SIGINT)).start()
    try:
        with pytest.raises(KeyboardInterrupt), processes(2) as executor:
            next(ordered(executor, Waiting(9, step_s=10.0), range(8)))
    finally:
        signal.signal(signal.SIGINT, usual)
    assert set(multiprocessing.active_children()) == before
