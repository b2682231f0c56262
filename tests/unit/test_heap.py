"""Free memory goes back to the system."""

import sys
from pathlib import Path

import numpy as np
import pytest

from seqid_cli.heap import give_back
from tests import Array

MB = 1 << 20
PIECE = 64 << 10  # bytes: below what the C library asks the system for by itself


def resident() -> int:
    """Return the bytes of this process that are in memory."""
    pages = int(Path("/proc/self/statm").read_text(encoding="ascii").split()[1])
    return pages * 4096


@pytest.mark.skipif(
    not sys.platform.startswith("linux"), reason="only glibc gives pages back"
)
def test_what_lies_between_what_is_held_goes_back() -> None:
    pieces: list[Array] = [np.ones(PIECE // 8) for _ in range(200 * MB // PIECE)]
    held = pieces[::50]
    full = resident()
    pieces.clear()
    give_back()
    assert resident() < full - 100 * MB
    assert all(piece.all() for piece in held)
