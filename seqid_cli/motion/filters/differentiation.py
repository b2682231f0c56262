"""Time derivatives of band-limited samples, and the runs of a mask."""

import numpy as np
from scipy.ndimage import correlate1d, minimum_filter1d

from seqid_cli.typing import Array, Mask

# Central differences of eighth order: the error is below 1e-3 up to a tenth of the
# sampling rate.
FIRST = np.array(
    [1 / 280, -4 / 105, 1 / 5, -4 / 5, 0, 4 / 5, -1 / 5, 4 / 105, -1 / 280]
)
SECOND = np.array([-9, 128, -1008, 8064, -14350, 8064, -1008, 128, -9]) / 5040
SIDE = len(FIRST) // 2  # samples on either side that a derivative takes


def runs(mask: Mask | None, length: int) -> list[tuple[int, int]]:
    """Half-open index ranges in which `mask` is True; the whole length where it is None."""
    if mask is None:
        return [(0, length)]
    edges = np.flatnonzero(np.diff(np.concatenate(([0], mask.astype(np.int8), [0]))))
    return [(int(a), int(b)) for a, b in zip(edges[::2], edges[1::2], strict=True)]


def shrink(mask: Mask, samples: int) -> Mask:
    """Take `samples` off both ends of every run of True."""
    return minimum_filter1d(mask.view(np.uint8), 2 * samples + 1, mode="constant").view(
        np.bool_
    )


def differentiate(
    values: Array, rate_hz: float, valid: Mask | None = None
) -> tuple[Array, Array]:
    """First and second derivative of samples (N, ...) far below a fifth of their rate."""
    # They do not reach across samples that are not valid, and are zero outside valid
    # runs.
    first, second = np.zeros_like(values), np.zeros_like(values)
    width = [(SIDE, SIDE)] + [(0, 0)] * (values.ndim - 1)
    for start, stop in runs(valid, len(values)):
        # Mirrored through the end points.
        piece = np.pad(values[start:stop], width, mode="reflect", reflect_type="odd")
        first[start:stop] = correlate1d(piece, FIRST * rate_hz, axis=0)[SIDE:-SIDE]
        second[start:stop] = correlate1d(piece, SECOND * rate_hz**2, axis=0)[SIDE:-SIDE]
    return first, second
