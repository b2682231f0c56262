"""Stretches of constant velocity of a log, which may be too long to be held."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from seqid_cli.logs.long import Block, LongLog
from seqid_cli.logs.recording import Recording, torque_of
from seqid_cli.motion.blocks import joined
from seqid_cli.motion.segmentation import Stretch, constant_velocity, motion_reach, moving_mask
from seqid_cli.typing import Array


@dataclass(frozen=True)
class _Held:
    """Consecutive samples; those from `start` on are still to be searched."""

    block: Block
    start: int

    def followed_by(self, other: Block) -> _Held:
        """These samples and the next."""
        return replace(self, block=joined([self.block, other]))

    def after(self, cut: int, margin: int) -> _Held:
        """What is left once everything in front of a sample (of the block) has been searched."""
        low = max(0, cut - margin)
        return _Held(self.block.part(slice(low, self.block.samples)), cut - low)


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
    margin = motion_reach(log.rate_hz)
    wait = rows
    held: _Held | None = None
    for block in log.blocks():
        held = _Held(block, 0) if held is None else held.followed_by(block)
        if len(held.block.q) - held.start < wait + margin:
            continue
        cut = _last_change(held, log.rate_hz, step, margin)
        if cut is None:  # one move that goes on and on
            wait = 2 * (len(held.block.q) - held.start)
            continue
        yield held.block, _stretches(held, cut, log.rate_hz, step)
        held, wait = held.after(cut, margin), rows
    if held is not None:
        yield held.block, _stretches(held, len(held.block.q), log.rate_hz, step)


def _last_change(held: _Held, rate_hz: float, step: Array, margin: int) -> int | None:
    """Find the last sample, away from the end, at which another joint moves than before it."""
    block = held.block
    moving = moving_mask(block.q, rate_hz, step)
    alone = block.valid & (moving.sum(axis=1) == 1)
    mover = np.where(alone, moving.argmax(axis=1), -1)
    searched = mover[held.start : len(mover) - margin]
    changes = np.flatnonzero(searched[1:] != searched[:-1])
    return held.start + int(changes[-1]) + 1 if len(changes) else None


def _stretches(held: _Held, cut: int, rate_hz: float, step: Array) -> list[Stretch]:
    inside = held.block.valid.copy()
    inside[: held.start] = False
    inside[cut:] = False
    return constant_velocity(held.block.q, rate_hz, step=step, valid=inside)
