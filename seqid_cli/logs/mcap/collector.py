"""The messages of one topic: gathered, decoded in batches, kept as arrays."""

from dataclasses import dataclass, field

import numpy as np

from seqid_cli.logs.mcap.records import Batch
from seqid_cli.logs.messages.batch import Decode, Decoded, Kind, NameMap, Payloads
from seqid_cli.logs.messages.parsers import decoder
from seqid_cli.logs.raw import Stamps

_LATEST = 1 << 62  # log times from here on are damaged


@dataclass(frozen=True)
class Samples:
    """The decoded messages of one topic, and the times at which they were logged [ns]."""

    log_ns: Stamps
    decoded: Decoded

    def log_minus_header_s(self) -> float | None:
        """Return the median delay from header stamp to log time, None without header stamps."""
        stamped = self.decoded.stamp_ns != 0
        if not stamped.any():
            return None
        return float(np.median((self.log_ns - self.decoded.stamp_ns)[stamped])) * 1e-9


@dataclass
class Collector:
    """Gathers and decodes the messages of one topic.

    Batches of less than `few` wait for more, up to `most`; `waiting` counts the samples to drain.
    """

    topic: str
    kind: Kind
    names: NameMap
    few: int = 256
    most: int = 4096
    received: int = 0
    damaged: int = 0
    waiting: int = 0
    refused: set[str] = field(default_factory=set)
    _decoders: dict[int, Decode | None] = field(default_factory=dict)
    _channel: int = -1
    _log_ns: list[int] = field(default_factory=list)
    _data: list[bytes] = field(default_factory=list)
    _done: list[Samples] = field(default_factory=list)

    def add(self, batch: Batch) -> None:
        """Take messages of one channel."""
        number, encoding = batch.channel.id, batch.channel.message_encoding
        if number not in self._decoders:
            self._decoders[number] = decoder(encoding, batch.schema, self.kind, self.names)
            if self._decoders[number] is None:
                self.refused.add(encoding)
        large = len(batch.payloads) >= self.few
        if large or number != self._channel or len(self._data) >= self.most:
            self._flush()
            self._channel = number
        self.received += len(batch.payloads)
        if large:
            self._decode(batch.log_ns, batch.payloads)
        else:
            self._log_ns.extend(batch.log_ns.tolist())
            self._data.extend(batch.payloads)

    def drain(self) -> Samples:
        """Return what has been decoded since the last call, and forget it."""
        self._flush()
        done, self._done, self.waiting = self._done, [], 0
        if len(done) == 1:
            return done[0]
        parts = done or [
            Samples(np.zeros(0, np.int64), Decoded.empty(0, self.names.width(self.kind)))
        ]
        decoded = Decoded(
            np.concatenate([part.decoded.stamp_ns for part in parts]),
            np.concatenate([part.decoded.values for part in parts]),
            np.concatenate([part.decoded.good for part in parts]),
        )
        return Samples(np.concatenate([part.log_ns for part in parts]), decoded)

    def note(self) -> str:
        """Say what could not be decoded, empty if nothing."""
        if not self.damaged:
            return ""
        return f"{self.damaged} of {self.received} messages of {self.topic} could not be decoded"

    def _flush(self) -> None:
        if self._data:
            log_ns, data = np.array(self._log_ns, np.int64), Payloads.of(self._data)
            self._log_ns, self._data = [], []
            self._decode(log_ns, data)

    def _decode(self, log_ns: Stamps, payloads: Payloads) -> None:
        decode = self._decoders[self._channel]
        if decode is None:
            self.damaged += len(payloads)
            return
        decoded = decode(payloads)
        good = decoded.good & (log_ns >= 0) & (log_ns < _LATEST)
        if not good.all():
            self.damaged += int(np.count_nonzero(~good))
            decoded, log_ns = decoded.take(good), log_ns[good]
        self._done.append(Samples(log_ns, decoded))
        self.waiting += len(log_ns)
