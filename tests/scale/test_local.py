"""Work in several processes: order, failures, deaths, and that nothing is left behind."""

from __future__ import annotations

import multiprocessing
import os
import signal
import threading

import pytest
from seqid_cli.scale.local import ordered
from seqid_cli.scale.reply import WorkerError

from seqid_cli.errors import InputError
from tests.scale import jobs


def test_replies_come_in_the_order_of_the_items() -> None:
    assert [r.get() for r in ordered(jobs.square, range(7), jobs=2)] == [k * k for k in range(7)]
    assert [r.get() for r in ordered(jobs.Waiting(12), range(12), jobs=3)] == list(range(12))
    assert not list(ordered(jobs.square, [], jobs=2))


def test_several_processes_share_the_work_with_one_blas_thread_each() -> None:
    found = {reply.get() for reply in ordered(jobs.process, range(8), jobs=2)}
    assert len(found) == 2
    assert os.getpid() not in found
    (counts,) = [reply.get() for reply in ordered(jobs.threads, [0], jobs=1)]
    assert set(counts) <= {1}


def test_workers_leave_interrupts_to_the_asking_process() -> None:
    assert [reply.get() for reply in ordered(jobs.interrupt_handler, [0], jobs=1)] == [True]


def test_errors_keep_their_kind_and_bugs_their_traceback() -> None:
    replies = list(ordered(jobs.fails, range(6), jobs=2))
    assert [k for k, reply in enumerate(replies) if reply.error is None] == [0, 1, 3, 5]
    with pytest.raises(InputError) as caught:
        replies[2].get()
    assert (caught.value.message, caught.value.hint) == ("lacks the channel", "record it")
    assert caught.value.where == "log 2"
    with pytest.raises(WorkerError, match=r"^4: ZeroDivisionError: nothing to divide by\n") as bug:
        replies[4].get()
    assert "in fails" in bug.value.__notes__[0]


def test_a_death_is_blamed_on_the_item_at_hand_and_the_rest_is_done() -> None:
    replies = list(ordered(jobs.dies, range(8), jobs=2))
    assert [k for k, reply in enumerate(replies) if reply.error is None] == [0, 2, 4, 5, 6, 7]
    assert isinstance(replies[1].error, InputError)
    assert str(replies[1].error).startswith("1: its process was killed")
    assert "--jobs" in replies[1].error.hint
    assert str(replies[3].error) == "3: its process ended with exit code 7"


def test_memory_and_results_that_cannot_travel_have_their_own_words() -> None:
    (full,) = ordered(jobs.out_of_memory, ["a.parquet"], jobs=1)
    assert str(full.error) == "a.parquet: does not fit into memory"
    replies = list(ordered(jobs.unsendable, range(3), jobs=1))
    assert [reply.error is None for reply in replies] == [True, False, True]
    assert "its result cannot be sent" in str(replies[1].error)


def test_leaving_early_ends_the_processes() -> None:
    before = set(multiprocessing.active_children())
    replies = ordered(jobs.Waiting(9, step_s=0.01), range(8), jobs=2)
    next(replies)
    assert len(set(multiprocessing.active_children()) - before) == 2
    replies.close()
    assert set(multiprocessing.active_children()) == before


def test_an_interrupt_ends_the_processes_in_the_middle_of_their_work() -> None:
    before = set(multiprocessing.active_children())
    replies = ordered(jobs.Waiting(9, step_s=10.0), range(8), jobs=2)
    threading.Timer(1.0, os.kill, (os.getpid(), signal.SIGINT)).start()
    with pytest.raises(KeyboardInterrupt):
        next(replies)
    assert set(multiprocessing.active_children()) == before
