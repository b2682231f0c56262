"""Logs that repeat a motion: what a motion has for itself counts once.

Noise averages out over repetitions. What the model lacks does not: it comes again with
the motion. Blocks of a motion that is there already are therefore no blocks of their
own, between which errors are independent. Their rows join the rows of the first time,
as the friction stage takes trials of one motion together
(`friction_surface.reduction`).
"""

from collections.abc import Sequence

import numpy as np

from seqid_cli.identify.regression.least_squares import Accumulator
from seqid_cli.typing import Array

# Two logs have one motion where the products of their columns differ by less than this
# share. Encoders, timing and rows that count or not make some 0.01 of difference.
SAME_MOTION = 0.1


def with_log(
    joints: Sequence[Accumulator], log: Sequence[Accumulator]
) -> list[Accumulator]:
    """Return the factors of all joints with those of one more log.

    Parameters
    ----------
    joints, log : sequence of Accumulator
        Of each joint, of the logs so far and of the one that is added; the blocks of
        all joints are of the same times.
    """
    first = _first_time(joints, log)
    if first is None:
        return [of_all + of_log for of_all, of_log in zip(joints, log, strict=True)]
    return [
        of_all.repeated(of_log, first)
        for of_all, of_log in zip(joints, log, strict=True)
    ]


def _first_time(
    joints: Sequence[Accumulator], log: Sequence[Accumulator]
) -> int | None:
    """Return the block at which a log's motion is there already; None if it is new."""
    count = len(log[0].blocks)
    room = len(joints[0].blocks) - count
    n_rows = sum(of_log.samples for of_log in log)
    if not n_rows or room < 0 or joints[0].span != log[0].span:
        return None

    own = _squares(log)
    earlier = _squares(joints)
    size = max(float(np.sum(own)), 1e-300)
    for first in range(room + 1):
        # It may have been repeated already.
        window = slice(first, first + count)
        times = sum(sum(joint.rows[window]) for joint in joints) / n_rows
        # Sums of squares tell most motions apart, at a small part of the work.
        off = float(np.sum(np.abs(earlier[window] - times * own)))
        is_alike = off <= SAME_MOTION * times * size
        if is_alike and _is_same(joints, log, window, times):
            return first
    return None


def _squares(joints: Sequence[Accumulator]) -> Array:
    """Return sums of squares (G, n p) of all columns, block by block."""
    # Factor by factor: all blocks of the logs so far, copied for each log that is
    # added, would be most of what this takes.
    by_joint = [
        [np.einsum("kp,kp->p", factor, factor)[:-1] for factor in joint.blocks]
        for joint in joints
    ]
    return np.hstack(by_joint)


def _is_same(
    joints: Sequence[Accumulator],
    log: Sequence[Accumulator],
    window: slice,
    times: float,
) -> bool:
    """Return whether blocks have so many times the products of a log's columns.

    Columns count alike, whatever their units.
    """
    difference = 0.0
    size = 0.0
    for of_all, of_log in zip(joints, log, strict=True):
        own = np.array(of_log.blocks)[:, :, :-1]
        earlier = np.array(of_all.blocks[window])[:, :, :-1]
        scale = np.sqrt(np.sum(own**2, axis=(0, 1)))
        used = scale > 0.0
        own_products = times * _products(own[:, :, used] / scale[used])
        products = _products(earlier[:, :, used] / scale[used])
        difference += float(np.sum((products - own_products) ** 2))
        size += float(np.sum(own_products**2))
    return difference <= SAME_MOTION**2 * size


def _products(factors: Array) -> Array:
    """Return the products (G, p, p) of columns by factors (G, k, p) of blocks."""
    return np.asarray(factors.transpose(0, 2, 1) @ factors)
