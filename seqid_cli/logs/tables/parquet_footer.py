"""How many values a Parquet file holds, by its footer, before any of it is unpacked.

Arrow tells this by an object for each column, and some footers end the process while it
makes one (statistics of another number of levels than the schema has). The footer is
read here: Thrift's compact protocol, of which only a few fields are looked at.

Sources: the formats' specifications,
https://github.com/apache/parquet-format/blob/master/src/main/thrift/parquet.thrift and
https://github.com/apache/thrift/blob/master/doc/specs/thrift-compact-protocol.md
"""

import struct
from collections.abc import Callable
from pathlib import Path
from typing import Any

_MAGIC = b"PAR1"
_TAIL = struct.Struct("<I4s")  # length of the footer, magic
_LARGEST = 256 << 20  # bytes of a footer; Arrow's own limit is lower
_DEEPEST = 32  # structures in each other; those of Parquet are seven deep
_MOST_DIGITS = 10  # bytes of a number of 64 bits
# Numbers of fields.
_ROW_GROUPS, _COLUMNS, _METADATA, _PATH, _VALUES = 4, 1, 3, 3, 5
_Fields = dict[int, Any]


class FooterError(ValueError):
    """Bytes that are no footer."""


def values_by_column(path: Path) -> dict[str, int]:
    """Count the values of each column of a Parquet file.

    Parameters
    ----------
    path : Path
        A file that Arrow has opened: its schema is in order.

    Returns
    -------
    dict of str to int
        The sum over row groups, by the column's path in the schema, with dots.

    Raises
    ------
    FooterError
        The footer does not follow its specification.
    """
    footer = _Reader(_footer_of(path)).struct()
    counts: dict[str, int] = {}
    try:
        for group in footer[_ROW_GROUPS]:
            for chunk in group[_COLUMNS]:
                metadata = chunk[_METADATA]
                name = b".".join(metadata[_PATH]).decode()
                counts[name] = counts.get(name, 0) + int(metadata[_VALUES])
    except (LookupError, TypeError, ValueError) as error:
        raise FooterError(f"a field is missing or of another type: {error}") from error
    if min(counts.values(), default=0) < 0:
        raise FooterError("a column has fewer values than none")
    return counts


def _footer_of(path: Path) -> bytes:
    """Return the bytes of a file's footer."""
    with path.open("rb") as stream:
        size = stream.seek(0, 2)
        if size < 2 * len(_MAGIC) + _TAIL.size - 4:
            raise FooterError("the file is too short")
        stream.seek(size - _TAIL.size)
        length, magic = _TAIL.unpack(stream.read(_TAIL.size))
        if magic != _MAGIC or length > min(size - _TAIL.size, _LARGEST):
            raise FooterError("the file does not end as a Parquet file does")
        stream.seek(size - _TAIL.size - length)
        return stream.read(length)


class _Reader:
    """Values of Thrift's compact protocol, one after the other.

    Parameters
    ----------
    data : bytes
        They begin with a structure.
    """

    def __init__(self, data: bytes) -> None:
        self._data = data
        self._at = 0
        self._depth = 0
        self._values: dict[int, Callable[[], Any]] = {
            1: lambda: True,
            2: lambda: False,
            3: lambda: self._bytes(1),
            4: self._integer,
            5: self._integer,
            6: self._integer,
            7: lambda: self._bytes(8),
            8: lambda: self._bytes(self._unsigned()),
            9: self._list,
            10: self._list,
            11: self._map,
            12: self.struct,
        }

    def struct(self) -> _Fields:
        """Read a structure: its fields by their numbers."""
        self._depth += 1
        if self._depth > _DEEPEST:
            raise FooterError("its structures lie too deep in each other")
        fields: _Fields = {}
        number = 0
        while True:
            head = self._byte()
            if head == 0:
                self._depth -= 1
                return fields
            step, kind = head >> 4, head & 15
            number = number + step if step else self._integer()
            fields[number] = self._value(kind)

    def _value(self, kind: int) -> Any:
        """Read one value of a kind."""
        read = self._values.get(kind)
        if read is None:
            raise FooterError(f"a value is of the unknown kind {kind}")
        return read()

    def _list(self) -> list[Any]:
        """Read a list: its length and kind, then the items."""
        head = self._byte()
        length = head >> 4
        kind = head & 15
        if length == 15:
            length = self._unsigned()
        self._check_length(length)
        # In a list a truth value has a byte of its own.
        if kind in (1, 2):
            return list(self._bytes(length))
        return [self._value(kind) for _ in range(length)]

    def _map(self) -> list[Any]:
        """Read a map as a list of its keys and values."""
        length = self._unsigned()
        self._check_length(length)
        if length == 0:
            return []
        kinds = self._byte()
        pairs: list[Any] = []
        for _ in range(length):
            pairs += [self._value(kinds >> 4), self._value(kinds & 15)]
        return pairs

    def _check_length(self, length: int) -> None:
        """Raise FooterError for more items than bytes are left."""
        if length > len(self._data) - self._at:
            raise FooterError("a list is longer than the footer")

    def _byte(self) -> int:
        """Read one byte."""
        return self._bytes(1)[0]

    def _bytes(self, count: int) -> bytes:
        """Read some bytes."""
        taken = self._data[self._at : self._at + count]
        if len(taken) < count:
            raise FooterError("it ends within a value")
        self._at += count
        return taken

    def _unsigned(self) -> int:
        """Read a number of seven bits a byte, the lowest first."""
        value = 0
        for digit in range(_MOST_DIGITS):
            byte = self._byte()
            value |= (byte & 127) << (7 * digit)
            if byte < 128:
                return value
        raise FooterError("a number has too many bytes")

    def _integer(self) -> int:
        """Read a number with a sign, which is its lowest bit."""
        value = self._unsigned()
        return (value >> 1) ^ -(value & 1)
