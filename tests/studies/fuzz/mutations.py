"""Ways to damage a file: its bytes, and in texts the numbers, words and lines."""

import re
import struct
from collections.abc import Callable, Sequence

import numpy as np

Damage = Callable[[bytearray, np.random.Generator], None]

_TOKEN = re.compile(rb"[-+]?[0-9][0-9.]*(?:[eE][-+]?[0-9]+)?|\"[^\"\n]*\"|[A-Za-z_]\w*")
_NUMBERS = b"0 -1 1e300 -1e300 1e-320 1e-9 5e-324 -0.0 1e12".split()
_NUMBERS += b"9223372036854775808 65536 0.5 1".split()
_STRINGS = [b"", b" ", b"\\u001b]0;x\\u0007", b"\xff", b"../x", b"1", b"x" * 300]
_STRINGS += ["\u202e\ufeff".encode()]
_ANY = b'nan -inf 1e999 NaN true null "" [] {} [[]] {"a":1} [1,2]'.split()
_ANY += b"0x7fffffff 1_0 .5".split()
_ANY += [b"", b"\x1b[31m", b"9" * 400, b"[" * 300, b"\0"]
_WORDS = [
    struct.pack(f"<{f}", v)
    for f, v in (("Q", 2**64 - 1), ("q", -1), ("I", 2**31), ("B", 0))
]
_WORDS += [
    struct.pack("<d", v) for v in (1e300, 5e-324, float("nan"), float("inf"), -1.0)
]
_WORDS += [struct.pack("<Q", 1 << k) for k in (0, 16, 31, 33, 40, 62)]


def _at(data: bytearray, rng: np.random.Generator) -> int:
    return int(rng.integers(0, len(data) + 1))


def flip(data: bytearray, rng: np.random.Generator) -> None:
    for at in rng.integers(0, max(len(data), 1), rng.integers(1, 12)):
        data[at : at + 1] = bytes([int(rng.integers(0, 256))])


def cut(data: bytearray, rng: np.random.Generator) -> None:
    del data[_at(data, rng) :]


def lose(data: bytearray, rng: np.random.Generator) -> None:
    at = _at(data, rng)
    del data[at : at + int(rng.integers(1, 5_000))]


def zero(data: bytearray, rng: np.random.Generator) -> None:
    at = _at(data, rng)
    size = min(int(rng.integers(1, 5_000)), len(data) - at)
    data[at : at + size] = bytes(size)


def junk(data: bytearray, rng: np.random.Generator) -> None:
    """Bytes of another file."""
    at, size = _at(data, rng), int(rng.integers(1, 500))
    data[at : at + size * int(rng.integers(0, 2))] = rng.bytes(size)


def word(data: bytearray, rng: np.random.Generator) -> None:
    """A length, an offset or a number that nobody meant."""
    at, new = _at(data, rng), _WORDS[int(rng.integers(len(_WORDS)))]
    data[at : at + len(new)] = new


def copy(data: bytearray, rng: np.random.Generator) -> None:
    """A piece of the file once more, in another place."""
    source, target = _at(data, rng), _at(data, rng)
    data[target:target] = data[source : source + int(rng.integers(1, 400))]


def token(data: bytearray, rng: np.random.Generator) -> None:
    """A number or a word of a text becomes another, or something else altogether."""
    found = list(_TOKEN.finditer(data))
    if not found:
        return
    one = found[int(rng.integers(len(found)))]
    alike: Sequence[bytes] = _NUMBERS if one[0][:1] in b"+-0123456789" else _ANY
    if one[0][:1] == b'"':
        alike = [b'"' + text + b'"' for text in _STRINGS]
    hostile = alike if rng.random() < 0.8 else _ANY
    data[one.start() : one.end()] = hostile[int(rng.integers(len(hostile)))]


def swap(data: bytearray, rng: np.random.Generator) -> None:
    found = list(_TOKEN.finditer(data))
    if len(found) > 1:
        one, other = (
            found[k] for k in sorted(rng.choice(len(found), 2, replace=False))
        )
        left, right = bytes(one[0]), bytes(other[0])
        data[other.start() : other.end()] = left
        data[one.start() : one.end()] = right


def lines(data: bytearray, rng: np.random.Generator) -> None:
    """A line of a text is lost or comes many times."""
    rows = bytes(data).split(b"\n")
    at = int(rng.integers(len(rows)))
    rows[at : at + 1] = [rows[at]] * int(rng.choice([0, 2, 3, 200]))
    data[:] = b"\n".join(rows)


BYTES: tuple[Damage, ...] = (flip, cut, lose, zero, junk)
BINARY: tuple[Damage, ...] = (*BYTES, word, word, copy)
TEXT: tuple[Damage, ...] = (
    flip,
    cut,
    lose,
    junk,
    copy,
    *([token] * 12),
    swap,
    lines,
    lines,
)


def mutated(
    sound: bytes, damages: Sequence[Damage], rng: np.random.Generator, most: int = 3
) -> tuple[bytes, str]:
    """Return a file with one to `most` damages, most often one, and their names."""
    data, names = bytearray(sound), []
    count = 1 if rng.random() < 0.5 else int(rng.integers(1, most + 1))
    for _ in range(count):
        damage = damages[int(rng.integers(len(damages)))]
        damage(data, rng)
        names.append(damage.__name__)
    return bytes(data), " ".join(names)
