"""Time derivatives of band-limited samples, and the runs of a mask."""

import numpy as np

from seqid_cli.running import dilated
from seqid_cli.typing import Array, Mask

# Central differences of eighth order: the error is below 1e-3 up to a tenth of the
# sampling rate.
FIRST = np.array(
    [1 / 280, -4 / 105, 1 / 5, -4 / 5, 0, 4 / 5, -1 / 5, 4 / 105, -1 / 280]
)
SECOND = np.array([-9, 128, -1008, 8064, -14350, 8064, -1008, 128, -9]) / 5040
SIDE = len(FIRST) // 2  # samples on either side that a derivative takes


def runs(mask: Mask | None, length: int) -> list[tuple[int, int]]:
    """Return half-open index ranges in which `mask` is True; [0, length) for None."""
    if mask is None:
        return [(0, length)]
    padded = np.concatenate(([0], mask.astype(np.int8), [0]))
    edges = np.flatnonzero(np.diff(padded)).tolist()
    return list(zip(edges[::2], edges[1::2], strict=True))


def shrink(mask: Mask, samples: int) -> Mask:
    """Take `samples` off both ends of every run of True."""
    # Runs of False grow; the ends of the mask are ends of its runs.
    shrunk = ~dilated(~mask, samples)
    shrunk[:samples] = False
    shrunk[max(0, len(mask) - samples) :] = False
    return shrunk


def differentiate(
    values: Array, rate_hz: float, valid: Mask | None = None
) -> tuple[Array, Array]:
    """Compute the first and second derivative of band-limited samples.

    Parameters
    ----------
    values : Array
        (N, ...), whose band ends far below a fifth of the rate.
    rate_hz : float
    valid : Mask, optional
        (N,); derivatives do not reach across samples that are not valid.

    Returns
    -------
    tuple of Array
        Both (N, ...), per s and per s^2; zero outside valid runs.
    """
    first = np.zeros_like(values)
    second = np.zeros_like(values)
    margins = [(SIDE, SIDE)] + [(0, 0)] * (values.ndim - 1)
    for start, stop in runs(valid, len(values)):
        # A run goes on beyond its ends by its reflection through the end points.
        piece = np.pad(values[start:stop], margins, mode="reflect", reflect_type="odd")
        _differences(piece, rate_hz, first[start:stop], second[start:stop])
    return first, second


def _differences(piece: Array, rate_hz: float, first: Array, second: Array) -> None:
    """Fill in both derivatives (N, ...) of samples (N + 2 SIDE, ...)."""
    of_first = FIRST * rate_hz
    of_second = SECOND * rate_hz**2
    np.multiply(piece[SIDE:-SIDE], of_second[SIDE], out=second)
    for k in range(SIDE):
        # Weights on either side are alike, but for their sign in the first derivative.
        before = piece[k : k + len(first)]
        behind = piece[2 * SIDE - k : 2 * SIDE - k + len(first)]
        first += (before - behind) * of_first[k]
        second += (before + behind) * of_second[k]
