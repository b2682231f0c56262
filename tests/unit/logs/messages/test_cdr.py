"""CDR decoding against the library's own decoder, and unusual definitions."""

import struct
from pathlib import Path

import numpy as np

from seqid_cli.logs.read import read_recording
from tests.unit.logs.samples import JOINTS, grid, make_motion, make_robot
from tests.unit.logs.writers import (
    DEFINITIONS,
    JOINT_STATE,
    joint_messages,
    payloads,
    write_messages,
    write_raw,
)

NAMES = ("a", "joint_with_a_long_name", "c3")
MOTION = make_motion(grid(100))
MESSAGES = joint_messages(np.rint((MOTION.t + 1.0) * 1e9).astype(np.int64), JOINTS, MOTION.q)


def test_definition_with_other_fields(tmp_path: Path) -> None:
    other = DEFINITIONS[JOINT_STATE].replace(
        "string[] name", "uint8 mode\nstring[] name\n# not the usual one"
    )
    for _, _, content in MESSAGES:
        content.mode = 3
    path = tmp_path / "log.mcap"
    write_messages(path, MESSAGES, encoding="cdr", definitions={JOINT_STATE: other})
    np.testing.assert_array_equal(read_recording(path, make_robot()).q, MOTION.q)


def test_messages_of_both_byte_orders(tmp_path: Path) -> None:
    """They are of one length, and differ in their first bytes."""
    rows = []
    for k, (stamp, q) in enumerate(zip(MOTION.t + 1.0, MOTION.q, strict=True)):
        order = "<>"[k % 2]
        sec, nanosec = divmod(round(stamp * 1e9), 10**9)
        body = struct.pack(f"{order}iII", sec, nanosec, 1) + bytes(4) + struct.pack(f"{order}I", 3)
        for name in JOINTS:
            text = name.encode() + b"\0"
            body += struct.pack(f"{order}I", len(text)) + text + b"\0" * (-len(text) % 4)
        body += struct.pack(f"{order}I", 3)
        body += b"\0" * (-len(body) % 8) + struct.pack(f"{order}3dII", *q, 0, 0)
        rows.append(("/joint_states", k, bytes([0, order == "<", 0, 0]) + body))
    path = write_raw(tmp_path / "log.mcap", {"/joint_states": "cdr"}, rows)
    recording = read_recording(path, make_robot())
    np.testing.assert_array_equal(recording.q, MOTION.q)
    assert recording.partial == ""


def test_a_message_of_another_representation_is_refused(tmp_path: Path) -> None:
    source = write_messages(tmp_path / "source.mcap", MESSAGES, encoding="cdr")
    rows = [("/joint_states", k, data) for k, data in enumerate(payloads(source))]
    rows[50] = ("/joint_states", 50, b"\0\3" + rows[50][2][2:])
    path = write_raw(tmp_path / "log.mcap", {"/joint_states": "cdr"}, rows)
    partial = read_recording(path, make_robot()).partial
    assert partial == "1 of 100 messages of /joint_states could not be decoded"
