"""Batches of CDR messages: what is decoded, and what is not."""

import struct

import numpy as np
import pytest

from seqid_cli.logs.messages.batch import NameMap, Payloads
from seqid_cli.logs.messages.cdr import LayoutDecoder
from tests.unit.logs import writers
from tests.unit.logs.samples import JOINTS

Q = np.arange(12.0).reshape(4, 3)


def encoded_states() -> list[bytes]:
    """Joint states with efforts behind the positions."""
    stamps = np.arange(1, 5)
    messages = writers.joint_messages(stamps, JOINTS, Q, effort=-Q)
    _, rows = writers.encoded(messages, "cdr")
    return [data for _, _, data in rows]


def test_a_message_that_breaks_off_is_not_completed_by_the_next() -> None:
    decode = LayoutDecoder("joint_state", NameMap(JOINTS))
    states = encoded_states()
    for first in (0, 2):
        batch = [states[first][:-8], states[first + 1]]
        decoded = decode(Payloads.of(batch))
        assert decoded.good.tolist() == [False, True]
        assert np.isnan(decoded.values[0]).all()
        np.testing.assert_array_equal(decoded.values[1, :3], Q[first + 1])


def packed(representation: int, order: str, alignment: int, q: list[float]) -> bytes:
    """Pack a joint state as the standard says it for a representation of CDR."""
    data = bytearray([0, representation, 0, 0])

    def put(form: str, *values: float) -> None:
        for value in values:
            size = min(struct.calcsize(form), alignment)
            data.extend(bytes(-(len(data) - 4) % size))
            data.extend(struct.pack(order + form, value))

    def put_text(text: str) -> None:
        put("I", len(text) + 1)
        data.extend(text.encode() + b"\0")

    put("i", 7)
    put("I", 5)
    put_text("world")
    put("I", len(JOINTS))
    for name in JOINTS:
        put_text(name)
    for values in (q, [], []):
        put("I", len(values))
        put("d", *values)
    return bytes(data)


@pytest.mark.parametrize(
    ("representation", "order", "alignment"),
    [(0, ">", 8), (1, "<", 8), (6, ">", 4), (7, "<", 4)],
)
def test_every_plain_representation_is_read(
    representation: int, order: str, alignment: int
) -> None:
    batch = [packed(representation, order, alignment, list(q)) for q in Q]
    decoded = LayoutDecoder("joint_state", NameMap(JOINTS))(Payloads.of(batch))
    assert decoded.good.all()
    np.testing.assert_array_equal(decoded.values[:, :3], Q)
    assert set(decoded.stamp_ns.tolist()) == {7_000_000_005}


def test_a_representation_that_is_not_plain_is_damage() -> None:
    batch = [packed(8, "<", 4, list(Q[0])), packed(1, "<", 8, list(Q[1]))]
    decoded = LayoutDecoder("joint_state", NameMap(JOINTS))(Payloads.of(batch))
    assert decoded.good.tolist() == [False, True]
