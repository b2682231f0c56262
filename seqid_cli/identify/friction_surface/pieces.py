"""Stretches of constant velocity of a log, which may be too long to be held."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from seqid_cli.logs.long import Block, LongLog
from seqid_cli.logs.recording import Recording, torque_of
from seqid_cli.motion.blocks import joined
from seqid_cli.motion.segmentation import Stretch, constant_velocity, motion_reach, moving_mask
from seqid_cli.typing import Array


def pieces(
    log: Recording | LongLog, step: Array, *, rows: int = 65_536
) -> Iterator[tuple[Block, list[Stretch]]]:
    """Find the stretches of constant velocity of a log.

    They lie within runs of samples at which one and the same joint moves alone. A long log is cut
    between such runs into pieces, each with so many samples more on either side as the search for
    motion reaches; what is found is what the whole log gives. A log that is held is one piece.

    `step` (n,): encoder noise [rad], see `noise_step`. Yields: samples, and the stretches in them,
    counted from the first of these samples.
    """
    if isinstance(log, Recording):
        found = constant_velocity(log.q, log.rate_hz, step=step, valid=log.valid)
        yield Block(0, log.q, torque_of(log), log.valid), found
        return
    margin, rate = motion_reach(log.rate_hz), log.rate_hz
    wait, start = rows, 0  # samples before `start` have been searched
    held: Block | None = None
    for block in log.blocks():
        held = block if held is None else joined([held, block])
        if held.samples - start < wait + margin:
            continue
        cut = _last_change(held, start, rate, step, margin)
        if cut is None:  # one move that goes on and on
            wait = 2 * (held.samples - start)
            continue
        yield held, _stretches(held, start, cut, rate, step)
        low = max(0, cut - margin)
        held, start, wait = held.part(slice(low, held.samples)), cut - low, rows
    if held is not None:
        yield held, _stretches(held, start, held.samples, rate, step)


def _last_change(block: Block, start: int, rate_hz: float, step: Array, margin: int) -> int | None:
    """Find the last sample, away from the end, at which another joint moves than before it."""
    moving = moving_mask(block.q, rate_hz, step)
    alone = block.valid & (moving.sum(axis=1) == 1)
    mover = np.where(alone, moving.argmax(axis=1), -1)
    searched = mover[start : len(mover) - margin]
    changes = np.flatnonzero(searched[1:] != searched[:-1])
    return start + int(changes[-1]) + 1 if len(changes) else None


def _stretches(block: Block, start: int, cut: int, rate_hz: float, step: Array) -> list[Stretch]:
    inside = block.valid.copy()
    inside[:start], inside[cut:] = False, False
    return constant_velocity(block.q, rate_hz, step=step, valid=inside)
