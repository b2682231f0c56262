"""Messages of one layout, decoded together by position.

All messages that have the length of one that was parsed, and the same structural bits, are decoded
as strided views. What fits no layout is parsed by itself; the result is the same either way.
"""

from __future__ import annotations

import struct
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

import numpy as np

from seqid_cli.logs.alike import Form
from seqid_cli.logs.decoding import Decode, Decoded, put
from seqid_cli.logs.layouts import Layout, NoLayoutError
from seqid_cli.logs.payloads import Bytes, Payloads

Parse = Callable[[bytes], Layout]

_ROUNDS = 32  # layouts of one length decoded together; what remains goes one by one
_KEPT = 512  # layouts remembered per decoder


@dataclass
class LayoutDecoder:
    """Decodes batches; remembers the layouts that it has met.

    `single` decodes messages without a fixed layout; without it they are refused.
    """

    parse: Parse
    width: int
    single: Decode | None = None
    _known: dict[int, list[Form]] = field(default_factory=dict)
    _count: int = 0

    def __call__(self, batch: Sequence[bytes]) -> Decoded:
        """Decode one batch."""
        payloads = Payloads.of(batch)
        lengths = payloads.lengths
        if len(lengths) and (lengths == lengths[0]).all():
            return self._equal_length(payloads)
        out = Decoded.empty(len(payloads), self.width)
        order = np.argsort(lengths, kind="stable")
        for rows in np.split(order, np.flatnonzero(np.diff(lengths[order])) + 1):
            if len(rows):
                put(out, rows, self._equal_length(payloads.take(rows)))
        return out

    def _equal_length(self, payloads: Payloads) -> Decoded:
        length = int(payloads.lengths[0])
        first, pad = payloads[:1].windows(length)
        known = self._layout(first[0], pad, length, 0)
        whole = None if known is None else known.decode_all(payloads)
        return self._in_turn(payloads, length) if whole is None else whole

    def _in_turn(self, payloads: Payloads, length: int) -> Decoded:
        """Decode payloads of one length and several layouts, one layout after the other."""
        rows, pad = payloads.windows(length)
        out = Decoded.empty(len(rows), self.width)
        left = np.arange(len(rows))
        alone: list[int] = []
        rounds = 0
        while len(left):
            rounds += 1
            known = self._layout(rows[left[0]], pad, length, rounds)
            alike = np.zeros(len(left), np.bool_)
            alike[0] = True
            if known is None:
                alone.append(int(left[0]))
            else:
                if rounds <= _ROUNDS:
                    alike = known.fits(rows[left])
                put(out, left[alike], known.decode(rows[left[alike]]))
            left = left[~alike]
        if alone and self.single is not None:
            each = np.array(alone)
            put(out, each, self.single(payloads.take(each)))
        return out

    def _layout(self, row: Bytes, pad: int, length: int, rounds: int) -> Form | None:
        """Find or make the layout of a row; None where it has none."""
        for known in self._known.get(length, ())[:_ROUNDS]:
            if known.starts(row):
                return known
        try:
            made = Form.of(self.parse(row[pad:].tobytes()), self.width)
        except (ValueError, struct.error, NoLayoutError):
            return None
        if rounds <= _ROUNDS and self._count < _KEPT:
            self._known.setdefault(length, []).append(made)
            self._count += 1
        return made
