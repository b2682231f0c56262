"""Slices of long tables: wide tables of all samples at once would take much memory."""

from collections.abc import Iterator


def tiles(stop: int, start: int = 0, *, size: int = 8192) -> Iterator[slice]:
    """Yield slices of at most `size` that cover the numbers from `start` to `stop`."""
    for first in range(start, stop, size):
        yield slice(first, min(first + size, stop))
