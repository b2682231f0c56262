"""What ways to damage containers have in common."""

import functools
from collections.abc import Callable, Iterator
from typing import Any

import numpy as np
from mcap.data_stream import RecordBuilder

from tests.studies.fuzz.mutations import Damage

MCAP_MAGIC = b"\x89MCAP0\r\n"


def inside(damage: Callable[[bytes, np.random.Generator], bytes]) -> Damage:
    """Leave a file as it is that other damages have made unreadable."""

    @functools.wraps(damage)
    def careful(data: bytearray, rng: np.random.Generator) -> None:
        for _ in range(5):
            try:
                data[:] = damage(bytes(data), rng)
                return
            # whatever a library says of such a file, or of such a value
            except Exception:
                continue

    return careful


def places(holder: Any) -> Iterator[tuple[Any, Any]]:
    for key in holder if isinstance(holder, dict) else range(len(holder)):
        yield holder, key
        if isinstance(holder[key], dict | list):
            yield from places(holder[key])


def written(*records: Any) -> bytes:
    builder = RecordBuilder()
    for each in records:
        each.write(builder)
    return bytes(builder.end())
