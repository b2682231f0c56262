"""Batches of CDR messages: what is decoded, and what is not."""

import numpy as np

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
