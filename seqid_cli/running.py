"""Running extremes, means and medians of signals, as `scipy.ndimage` has them.

That package takes longer to import than a command needs for a log of some minutes. What
is used of it takes a few lines. The window of sample i are those from i - width // 2 to
i - width // 2 + width - 1.
"""

from typing import Literal, TypeVar

import numpy as np
from numpy.typing import NDArray

from seqid_cli.typing import Array, Mask

Number = TypeVar("Number", bound=np.generic)

# How a signal a b c goes on beyond its ends: b a | a b c | c b, or a a | a b c | c c.
Beyond = Literal["symmetric", "edge"]


def running_min(values: NDArray[Number], width: int) -> NDArray[Number]:
    """Return the smallest of each window (N, ...) of signals (N, ...).

    Windows end where the signals do.
    """
    return _extremes(np.minimum, values, width)


def running_max(values: NDArray[Number], width: int) -> NDArray[Number]:
    """Return the largest of each window (N, ...) of signals (N, ...).

    Windows end where the signals do.
    """
    return _extremes(np.maximum, values, width)


def _extremes(
    extreme: np.ufunc, values: NDArray[Number], width: int
) -> NDArray[Number]:
    """Return one extreme of each window, by those of windows of 1, 2, 4, ... samples.

    Two of these that overlap are a window of any width: passes over the samples are as
    many as the width has binary digits.
    """
    count = len(values)
    if not count:
        return values.copy()
    before = width // 2
    # The end itself is in each window that reaches beyond it: repeated, it adds none.
    first = np.repeat(values[:1], before, axis=0)
    last = np.repeat(values[-1:], width - 1 - before, axis=0)
    found: NDArray[Number] = np.concatenate([first, values, last])
    seen = 1
    while 2 * seen <= width:
        found = extreme(found[:-seen], found[seen:])
        seen *= 2
    return np.asarray(extreme(found[:count], found[width - seen :]))


def dilated(mask: Mask, reach: int) -> Mask:
    """Return where (N, ...) a mask is true within `reach` samples to either side."""
    return running_max(mask, 2 * reach + 1)


def running_mean(values: Array, width: int, *, beyond: Beyond = "symmetric") -> Array:
    """Return the mean of each window (N, ...) of signals (N, ...)."""
    before = width // 2
    margins = [(before, width - before)] + [(0, 0)] * (values.ndim - 1)
    padded = np.pad(values, margins, mode=beyond)
    # From one window to the next a sample comes in and another goes.
    changes = padded[width - 1 : -1].copy()
    changes[0] = padded[:width].sum(axis=0)
    changes[1:] -= padded[: len(values) - 1]
    changes /= width
    return np.asarray(np.cumsum(changes, axis=0))


def median_of_five(values: Array, *, beyond: Literal["wrap", "edge"]) -> Array:
    """Return the median of each five samples (N, ...) of signals (N, ...)."""
    margins = [(2, 2)] + [(0, 0)] * (values.ndim - 1)
    padded = np.pad(values, margins, mode=beyond)
    a, b, c, d, e = (padded[k : k + len(values)] for k in range(5))
    # The smallest and the largest of four are none: the median is that of the other
    # two and the fifth.
    smaller = np.maximum(np.minimum(a, b), np.minimum(c, d))
    larger = np.minimum(np.maximum(a, b), np.maximum(c, d))
    low = np.minimum(smaller, larger)
    high = np.maximum(smaller, larger)
    return np.asarray(np.maximum(low, np.minimum(e, high)))
