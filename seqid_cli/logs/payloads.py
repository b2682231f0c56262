"""Many messages in one buffer: where each begins and how long it is."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import overload

import numpy as np
from numpy.typing import NDArray

from seqid_cli.logs.raw import Mask, Rows

Bytes = NDArray[np.uint8]
_NARROW = 64  # bytes between payloads that are cheaper overwritten than left out
FRONT = 8  # bytes that a buffer made here has before its first payload; see `windows`


@dataclass(frozen=True)
class Payloads(Sequence[bytes]):
    """M payloads that lie in one buffer; a sequence of bytes objects for who wants them singly."""

    buffer: Bytes
    starts: NDArray[np.int64]  # (M,)
    lengths: NDArray[np.int64]  # (M,)

    @classmethod
    def of(cls, batch: Sequence[bytes]) -> Payloads:
        """Lay payloads one behind the other; what is laid out already is returned as it is."""
        if isinstance(batch, Payloads):
            return batch
        lengths = np.fromiter(map(len, batch), np.int64, len(batch))
        buffer = np.frombuffer(b"".join([bytes(FRONT), *batch]), np.uint8)
        return cls(buffer, FRONT + np.cumsum(lengths) - lengths, lengths)

    def __len__(self) -> int:
        """Count the payloads."""
        return len(self.starts)

    @overload
    def __getitem__(self, index: int) -> bytes: ...
    @overload
    def __getitem__(self, index: slice) -> Payloads: ...
    def __getitem__(self, index: int | slice) -> bytes | Payloads:
        """Copy one payload out, or select some without a copy."""
        if isinstance(index, slice):
            return Payloads(self.buffer, self.starts[index], self.lengths[index])
        start = int(self.starts[index])
        return self.buffer[start : start + int(self.lengths[index])].tobytes()

    def __iter__(self) -> Iterator[bytes]:
        """Copy the payloads out, one after the other."""
        return map(bytes, self.views())

    def views(self) -> Iterator[memoryview]:
        """Go over the payloads without copying them."""
        view = self.buffer.data
        ends = self.starts + self.lengths
        return (view[a:b] for a, b in zip(self.starts.tolist(), ends.tolist(), strict=True))

    def lines(self) -> Bytes:
        """Copy the payloads into one text, with a line break behind each but the last."""
        ends = self.starts + self.lengths
        gaps = self.starts[1:] - ends[:-1]
        if not len(gaps) or gaps[0] < 1 or gaps[0] > _NARROW or (gaps != gaps[0]).any():
            return np.frombuffer(b"\n".join(self.views()), np.uint8)
        first = int(self.starts[0])
        text = self.buffer[first : int(ends[-1])].copy()
        between = (ends[:-1] - first)[:, None] + np.arange(int(gaps[0]))
        text[between] = ord(" ")
        text[between[:, 0]] = ord("\n")
        return text

    def take(self, rows: Rows | Mask) -> Payloads:
        """Select payloads (indices or mask) without a copy."""
        return Payloads(self.buffer, self.starts[rows], self.lengths[rows])

    def windows(self, length: int) -> tuple[Bytes, int]:
        """Copy payloads of equal length side by side, widened to whole words of 8 bytes.

        Parameters
        ----------
        length : int
            Of all payloads, in bytes.

        Returns
        -------
        rows : (M, W) array, W a multiple of 8
            Each row holds a payload at its end. What stands before it is left there: CDR messages
            that end in doubles come to lie aligned in this way.
        pad : int
            Bytes of a row before the payload.
        """
        pad = -length % 8
        return self.cut(-pad, length), pad

    def cut(self, low: int, high: int) -> Bytes:
        """Copy bytes [low, high) of every payload side by side, (M, high - low).

        `low` may be negative by up to 7: what stands there is left as it is.
        """
        width = high - low
        buffer, starts = self.buffer, self.starts + low
        if not width or not len(starts):
            return np.zeros((len(starts), width), np.uint8)
        if low < 0 and int(starts.min()) < 0:
            buffer, starts = np.concatenate([np.zeros(FRONT, np.uint8), buffer]), starts + FRONT
        every = np.ndarray((len(buffer) - width + 1,), f"V{width}", buffer, strides=(1,))
        return every[starts].view(np.uint8).reshape(len(starts), width)
