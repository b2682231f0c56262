"""The messages of one topic, gathered and decoded: samples with one kind of stamp."""

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np

from seqid_cli.logs.mcap.records import Batch
from seqid_cli.logs.messages.batch import Decode, Decoded, Kind, NameMap, Payloads
from seqid_cli.logs.messages.parsers import decoder, kind_of
from seqid_cli.logs.raw import Stamps, TimeSource
from seqid_cli.typing import Array

_LATEST = 1 << 62  # log times from here on are damaged


class Samples(NamedTuple):
    """M samples of one topic."""

    stamp_ns: Stamps  # (M,)
    values: Array  # (M, w), as `Decoded` has them
    warnings: list[str]
    delay_s: float | None  # median from header stamp to log time


class _Part(NamedTuple):
    """Messages that are decoded and wait to be drained."""

    log_ns: Stamps  # times of logging
    decoded: Decoded  # all of them good


def _stacked(parts: Sequence[Array]) -> Array:
    """Put rows (M, w) of one topic together; those of fewer quantities lack the last.

    Types that hold commands as well have more quantities than a JointState.
    """
    width = max(part.shape[1] for part in parts)
    even = [
        np.pad(
            part,
            ((0, 0), (0, width - part.shape[1])),
            constant_values=np.nan,
        )
        if part.shape[1] < width
        else part
        for part in parts
    ]
    return np.concatenate(even)


@dataclass
class Collector:
    """Gathers the messages of one topic; the first ones decide which stamps it has."""

    topic: str
    kind: Kind
    names: NameMap
    time_source: TimeSource = "header"
    few: int = 256  # messages; fewer of them wait for more
    received: int = 0
    damaged: int = 0
    waiting: int = 0  # samples to drain
    refused: set[str] = field(default_factory=set)  # encodings without a decoder
    _decoders: dict[int, Decode | None] = field(default_factory=dict)
    _channel: int = -1  # of the messages that wait to be decoded
    _log_ns: list[int] = field(default_factory=list)
    _data: list[bytes] = field(default_factory=list)
    _parts: list[_Part] = field(default_factory=list)
    # whether the times of logging stand in for the headers' stamps
    _uses_log_time: bool | None = None

    @property
    def readable(self) -> bool:
        """True when messages have come that can be decoded."""
        return self.received > self.damaged

    def add(self, batch: Batch) -> None:
        """Take messages of one channel."""
        number = batch.channel.id
        if number not in self._decoders:
            encoding = batch.channel.message_encoding
            kind = kind_of(batch.schema, self.kind)
            decode = decoder(encoding, batch.schema, kind, self.names)
            self._decoders[number] = decode
            if decode is None:
                self.refused.add(encoding)

        # Few messages wait for more of their channel: decoding has a cost per batch.
        is_large = len(batch.payloads) >= self.few
        if is_large or number != self._channel or len(self._data) >= self.few:
            self._flush()
            self._channel = number
        self.received += len(batch.payloads)
        if is_large:
            self._decode(batch.log_ns, batch.payloads)
        else:  # copied, so as not to hold its chunk
            self._log_ns.extend(batch.log_ns.tolist())
            self._data.extend(batch.payloads)

    def drain(self) -> Samples:
        """Return what has been decoded since the last call, and forget it."""
        self._flush()
        parts = self._parts
        self._parts = []
        self.waiting = 0
        if not parts:
            no_values = np.zeros((0, self.names.width(self.kind)))
            return Samples(np.zeros(0, np.int64), no_values, [], None)
        log_ns = np.concatenate([part.log_ns for part in parts])
        stamp_ns = np.concatenate([part.decoded.stamp_ns for part in parts])
        values = _stacked([part.decoded.values for part in parts])

        is_stamped = stamp_ns != 0
        n_unstamped = int(np.count_nonzero(~is_stamped))
        delay_s = None
        if self.kind != "imu" and n_unstamped < len(is_stamped):
            delay_s = float(np.median((log_ns - stamp_ns)[is_stamped])) * 1e-9

        warnings = []
        if self._uses_log_time is None and self.time_source == "header":
            self._uses_log_time = n_unstamped == len(is_stamped)
            if self._uses_log_time:
                warnings.append(
                    f"the header stamps of {self.topic} are all zero: the times of"
                    " logging are used instead; make the driver fill in header.stamp"
                )
        if self.time_source == "log" or self._uses_log_time:
            return Samples(log_ns, values, warnings, delay_s)
        if n_unstamped:
            warnings.append(
                f"{n_unstamped} messages of {self.topic} have no header stamp and were"
                " left out"
            )
            stamp_ns = stamp_ns[is_stamped]
            values = values[is_stamped]
        return Samples(stamp_ns, values, warnings, delay_s)

    def _flush(self) -> None:
        """Decode the messages that wait for more."""
        if not self._data:
            return
        log_ns = np.array(self._log_ns, np.int64)
        payloads = Payloads.of(self._data)
        self._log_ns = []
        self._data = []
        self._decode(log_ns, payloads)

    def _decode(self, log_ns: Stamps, payloads: Payloads) -> None:
        decode = self._decoders[self._channel]
        if decode is None:
            self.damaged += len(payloads)
            return
        decoded = decode(payloads)
        is_good = decoded.good & (log_ns >= 0) & (log_ns < _LATEST)
        if not is_good.all():
            log_ns = log_ns[is_good]
            decoded = decoded.take(is_good)
        self.damaged += len(is_good) - len(log_ns)
        self.waiting += len(log_ns)
        self._parts.append(_Part(log_ns, decoded))
