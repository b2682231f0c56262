"""CDR decoding against the library's own decoder, and unusual definitions."""

import random
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from mcap.records import Schema
from mcap_ros2.writer import Writer

from seqid_cli.logs.messages import parsers
from seqid_cli.logs.messages.batch import NameMap, Payloads
from seqid_cli.logs.read import read_recording
from tests.unit.logs.samples import JOINTS, grid, make_motion, make_robot
from tests.unit.logs.writers import DEFINITIONS, JOINT_STATE, header, payloads

NAMES = ("a", "joint_with_a_long_name", "c3")


def test_definition_with_other_fields(tmp_path: Path) -> None:
    definition = DEFINITIONS[JOINT_STATE].replace(
        "string[] name", "uint8 mode\nstring[] name\n# not the usual one"
    )
    motion = make_motion(grid(100))
    path = tmp_path / "log.mcap"
    with path.open("wb") as out:
        writer = Writer(out)
        schema = writer.register_msgdef(JOINT_STATE, definition)
        for t, q in zip(motion.t, motion.q, strict=True):
            content = SimpleNamespace(
                header=header(round((t + 1.0) * 1e9)),
                mode=3,
                name=list(JOINTS),
                position=list(q),
                velocity=[],
                effort=[],
            )
            writer.write_message("/joint_states", schema, content, 0)
        writer.finish()
    np.testing.assert_array_equal(read_recording(path, make_robot()).q, motion.q)


@pytest.mark.parametrize("effort", ["torque", "current"])
def test_dynamic_joint_states_match_the_slow_way(tmp_path: Path, effort: str) -> None:
    kind, line = "control_msgs/msg/DynamicJointState", "=" * 80
    definition = (
        "std_msgs/Header header\nstring[] joint_names\nInterfaceValue[] interface_values\n"
        f"{line}\nMSG: control_msgs/InterfaceValue\nstring[] interface_names\nfloat64[] values\n"
        + DEFINITIONS[JOINT_STATE][DEFINITIONS[JOINT_STATE].index(line) :]
    )
    rng = random.Random(4)
    path = tmp_path / "log.mcap"
    kinds = ("position", "velocity", "effort", "torque", "current", "other")
    with path.open("wb") as out:
        writer = Writer(out)
        schema = writer.register_msgdef(kind, definition)
        for i in range(200):
            if i % 20 == 0:
                names = rng.sample((*NAMES, "x"), rng.randrange(5))
                interfaces = [rng.sample(kinds, rng.randrange(6)) for _ in names]
            values = [
                SimpleNamespace(interface_names=each, values=[rng.gauss(0, 1) for _ in each])
                for each in interfaces
            ]
            content = SimpleNamespace(
                header=header(i + 1), joint_names=names, interface_values=values
            )
            writer.write_message("/dynamic_joint_states", schema, content, 0)
        writer.finish()
    batch = payloads(path)
    found = Schema(1, definition.encode(), "ros2msg", kind)
    assert parsers.is_usual(found, "dynamic_joint_state")
    assert not parsers.is_usual(
        Schema(1, definition.replace("float64[] v", "float32[] v").encode(), "ros2msg", kind),
        "dynamic_joint_state",
    )
    parse = parsers.schema_parser("cdr", found)
    decode = parsers.decoder("cdr", found, "dynamic_joint_state", NameMap(NAMES, effort))
    assert parse is not None
    assert decode is not None
    slow = parsers.field_decoder("dynamic_joint_state", NameMap(NAMES, effort), parse)(
        Payloads.of(batch)
    )
    fast = decode(Payloads.of(batch))
    assert fast.good.all()
    np.testing.assert_array_equal(fast.values, slow.values)
    np.testing.assert_array_equal(fast.stamp_ns, slow.stamp_ns)
