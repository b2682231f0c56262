"""Merging of parts in the shape of one binary tree, whoever made them and in which order.

Floating-point sums depend on the order of addition. Here parts 0 and 1, 2 and 3, ... are merged,
then their results pairwise, and so on; a part without a partner goes up as it is. The shape follows
from the number of parts alone, so one process, many processes and a cluster get the same bits.
"""

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Generic, TypeVar

T = TypeVar("T")
Merge = Callable[[T, T], T]


@dataclass
class Tree(Generic[T]):
    """Takes parts in order and keeps no more than one per level: log2(N) of them."""

    merge: Merge[T]
    _levels: list[tuple[int, T]] = field(default_factory=list)  # (level, part), the highest first

    def push(self, part: T) -> None:
        """Take the next part."""
        level = 0
        while self._levels and self._levels[-1][0] == level:
            part = self.merge(self._levels.pop()[1], part)
            level += 1
        self._levels.append((level, part))

    def root(self) -> T | None:
        """Merge what is left; None where there was no part."""
        if not self._levels:
            return None
        whole = self._levels[-1][1]
        for _, part in reversed(self._levels[:-1]):
            whole = self.merge(part, whole)
        return whole


def or_none(merge: Merge[T]) -> Merge[T | None]:
    """The same merge where parts may be missing."""

    def either(first: T | None, second: T | None) -> T | None:
        if first is None or second is None:
            return second if first is None else first
        return merge(first, second)

    return either
