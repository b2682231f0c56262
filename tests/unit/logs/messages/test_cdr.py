"""CDR decoding against the library's own decoder, and unusual definitions."""

import random
import struct
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from mcap.records import Schema

from seqid_cli.logs.messages import parsers
from seqid_cli.logs.messages.batch import NameMap, Payloads
from seqid_cli.logs.read import read_recording
from tests.unit.logs.samples import JOINTS, grid, make_motion, make_robot
from tests.unit.logs.writers import (
    DEFINITIONS,
    DYNAMIC,
    JOINT_STATE,
    header,
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


@pytest.mark.parametrize("effort", ["torque", "current"])
def test_dynamic_joint_states_match_the_slow_way(tmp_path: Path, effort: str) -> None:
    rng, messages = random.Random(4), []
    kinds = ("position", "velocity", "effort", "torque", "current", "other")
    for i in range(200):
        if i % 20 == 0:
            names = rng.sample((*NAMES, "x"), rng.randrange(5))
            interfaces = [rng.sample(kinds, rng.randrange(6)) for _ in names]
        values = [
            SimpleNamespace(interface_names=each, values=[rng.gauss(0, 1) for _ in each])
            for each in interfaces
        ]
        content = SimpleNamespace(header=header(i + 1), joint_names=names, interface_values=values)
        messages.append(("/dynamic_joint_states", 0, content))
    path = write_messages(tmp_path / "log.mcap", messages, encoding="cdr")
    usual = Schema(1, DEFINITIONS[DYNAMIC].encode(), "ros2msg", DYNAMIC)
    parse = parsers.schema_parser("cdr", usual)
    decode = parsers.decoder("cdr", usual, "dynamic_joint_state", NameMap(NAMES, effort))
    assert parse is not None
    assert decode is not None
    batch = Payloads.of(payloads(path))
    slow = parsers.field_decoder("dynamic_joint_state", NameMap(NAMES, effort), parse)(batch)
    fast = decode(batch)
    assert fast.good.all()
    np.testing.assert_array_equal(fast.values, slow.values)
    np.testing.assert_array_equal(fast.stamp_ns, slow.stamp_ns)


@pytest.mark.parametrize(
    ("kind", "change", "usual"),
    [
        (DYNAMIC, ("", ""), True),
        (DYNAMIC, ("float64[] v", "float32[] v"), False),
        (JOINT_STATE, ("std_msgs/Header", "std_msgs/msg/Header"), True),
        (JOINT_STATE, ("std_msgs/Header", "Header"), True),
        (JOINT_STATE, ("std_msgs/Header", "my_msgs/Header"), False),
        (JOINT_STATE, ("float64[] effort", "float64[]   effort  # N m"), True),
        (JOINT_STATE, ("float64[] effort\n", ""), False),
    ],
)
def test_only_the_usual_definition_is_read_fast(
    kind: str, change: tuple[str, str], usual: bool
) -> None:
    schema = Schema(1, DEFINITIONS[kind].replace(*change).encode(), "ros2msg", kind)
    name = "dynamic_joint_state" if kind == DYNAMIC else "joint_state"
    assert parsers.is_usual(schema, name) == usual  # type: ignore[arg-type]
