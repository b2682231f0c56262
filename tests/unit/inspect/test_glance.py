"""Joints that only later messages of a log name are found, though its start is all that
is looked at for names.
"""

from pathlib import Path

import numpy as np
import pytest

from seqid_cli.inspect.inspection import inspect_log
from seqid_cli.logs.contents import contents_of
from tests.unit.logs.writers import joint_messages, write_messages

PERIOD_NS = 4_000_000
ARM = ("a", "b")
GRIPPER = ("finger",)


def write_log(path: Path, samples: int, *, gripper_from: int) -> Path:
    """Write messages of two joints, and from a sample on those of a third between."""
    stamps = 10**18 + PERIOD_NS * np.arange(samples)
    t = PERIOD_NS * 1e-9 * np.arange(samples)
    arm = np.sin(t[:, None] + [0.0, 1.0])
    effort = 3.0 * arm + np.sign(np.cos(t[:, None] + [0.0, 1.0]))
    messages = [*joint_messages(stamps, ARM, arm, effort=effort)]
    later = slice(gripper_from, None)
    messages += joint_messages(
        stamps[later] + PERIOD_NS // 2,
        GRIPPER,
        0.1 * arm[later, :1],
        effort=0.2 * effort[later, :1],
    )
    messages.sort(key=lambda message: message[1])
    return write_messages(path, messages, encoding="cdr", chunk_size=20_000)


@pytest.mark.parametrize("gripper_from", [0, 6000])
def test_all_joints_are_found(tmp_path: Path, gripper_from: int) -> None:
    log = write_log(tmp_path / "log.mcap", 8000, gripper_from=gripper_from)
    first = contents_of(log, glance=True)
    assert not first.complete
    assert set(first.joints) == {*ARM, *(GRIPPER if not gripper_from else ())}
    whole = contents_of(log)
    assert whole.complete
    assert set(whole.joints) == {*ARM, *GRIPPER}
    inspected = inspect_log(log).log
    assert {joint.name for joint in inspected.joints} == {*ARM, *GRIPPER}
    assert inspected.channels == list(whole.channels)


def test_a_short_log_is_looked_at_whole(tmp_path: Path) -> None:
    log = write_log(tmp_path / "log.mcap", 900, gripper_from=800)
    assert set(contents_of(log, glance=True).joints) == {*ARM, *GRIPPER}
