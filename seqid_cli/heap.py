"""Memory that was let go of, given back to the system.

The C library keeps what is freed, in pieces between what is still held: a process stays
as large as it has ever been, and what comes next often finds no piece that is large
enough. glibc's `malloc_trim` gives whole pages back. Standard library only.
"""

import ctypes
import sys


def give_back() -> None:
    """Give free memory back to the system; nothing happens where that is unknown."""
    if not sys.platform.startswith("linux"):
        return
    trim = getattr(ctypes.CDLL(None), "malloc_trim", None)
    if trim is not None:
        trim(ctypes.c_size_t(0))
