"""Things to do in other processes."""

import os
import signal
import time
from dataclasses import dataclass

from seqid_cli.errors import InputError


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
