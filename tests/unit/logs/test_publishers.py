"""Two publishers on one topic: what is left out, what is refused, and what is one
publisher.
"""

from pathlib import Path

import numpy as np
import pytest

from seqid_cli.errors import InputError
from seqid_cli.logs.read import read_recording
from tests import Array
from tests.plants.robots.small import planar_2r
from tests.unit.logs.writers import Message, joint_messages, write_messages

NAMES = planar_2r().joint_names
BEGIN = 1_700_000_000_000_000_000
RATE_HZ = 50.0
COUNT = 600
T = np.arange(COUNT) / RATE_HZ
Q = np.stack([0.3 + 0.8 * np.sin(1.1 * T), np.cos(0.7 * T) - 0.2], axis=1)
TAU = np.stack([np.sin(2.0 * T), np.sign(np.cos(T))], axis=1)
ZERO = np.zeros_like(Q)


def messages(
    q: Array, *, late_s: float = 0.0, tau: Array | None = None
) -> list[Message]:
    stamps = BEGIN + np.rint((T + late_s) * 1e9).astype(np.int64)
    return joint_messages(stamps, NAMES, q, effort=tau)


def in_turn(first: list[Message], second: list[Message]) -> list[Message]:
    return [message for pair in zip(first, second, strict=True) for message in pair]


ROBOT = messages(Q, tau=TAU)
RARE = [m for k, m in enumerate(messages(ZERO, late_s=0.007)) if k % 5 == 0]
OTHERS = {
    "zeros, no effort": (in_turn(ROBOT, messages(ZERO, late_s=0.01)), COUNT),
    "zeros of the same stamp come first": (in_turn(messages(ZERO), ROBOT), COUNT),
    "zeros, now and then": (sorted(ROBOT + RARE, key=lambda m: m[1]), COUNT // 5),
    "zeros, effort of zero": (
        in_turn(ROBOT, messages(ZERO, late_s=0.01, tau=ZERO)),
        COUNT,
    ),
    "a posture": (
        in_turn(ROBOT, messages(ZERO + 0.9, late_s=0.01, tau=ZERO + 2.0)),
        COUNT,
    ),
    "a simulator": (in_turn(ROBOT, messages(Q[::-1], late_s=0.01, tau=ZERO)), COUNT),
}


@pytest.mark.parametrize("kind", OTHERS)
def test_messages_of_another_publisher_are_left_out(kind: str, tmp_path: Path) -> None:
    made, others = OTHERS[kind]
    log = write_messages(tmp_path / "log.mcap", made, encoding="cdr")
    recording = read_recording(log, planar_2r())
    (said,) = recording.health.warnings
    assert f"a second publisher: {others} of {COUNT + others} messages" in said
    assert recording.health.rate_hz == pytest.approx(RATE_HZ)
    np.testing.assert_array_equal(recording.q, Q)
    np.testing.assert_array_equal(recording.tau, TAU)


# A coarse encoder rests from one step to the next.
SLOW_AND_COARSE = np.round(0.05 * Q / 0.01) * 0.01 + 0.5
# Mostly at rest, then quicker than ten times what is usual in the log.
RESTING_THEN_QUICK = np.stack(
    [np.where(T > 10.0, np.sin(3.0 * (T - 10.0)), 0.0) + 0.4, ZERO[:, 1] + 0.7], axis=1
)
MOTIONS = {
    "slow and coarse": SLOW_AND_COARSE,
    "resting, then quick": RESTING_THEN_QUICK,
}


@pytest.mark.parametrize("motion", MOTIONS)
def test_zeros_are_left_out_of_any_motion(motion: str, tmp_path: Path) -> None:
    q = MOTIONS[motion]
    zeros = messages(ZERO, late_s=0.007, tau=ZERO)[::5]
    both = sorted(messages(q, tau=TAU) + zeros, key=lambda message: message[1])
    log = write_messages(tmp_path / "log.mcap", both, encoding="cdr")
    recording = read_recording(log, planar_2r())
    (said,) = recording.health.warnings
    assert f"a second publisher: {len(zeros)} of {COUNT + len(zeros)} messages" in said
    np.testing.assert_array_equal(recording.q, q)


def test_two_that_look_alike_are_refused(tmp_path: Path) -> None:
    other = messages(Q[::-1], late_s=0.01, tau=TAU[::-1])
    log = write_messages(tmp_path / "log.mcap", in_turn(ROBOT, other), encoding="cdr")
    with pytest.raises(
        InputError, match="two publishers take turns, with 600 and 600 messages"
    ):
        read_recording(log, planar_2r())


# with steps, as of a joint that is set
RESTS = np.where((T % 4.0 < 2.0)[:, None], Q, 0.0)
SPIKES = Q + 0.5 * (np.arange(COUNT) % 149 == 7)[:, None]
ONE = {
    "plain": ROBOT,
    "slow and coarse": messages(SLOW_AND_COARSE, tau=TAU),
    "resting, then quick": messages(RESTING_THEN_QUICK, tau=TAU),
    "effort in every second message": in_turn(ROBOT, messages(Q, late_s=0.002)),
    "without effort": messages(Q),
    "at rest": messages(np.where((T < 6.0)[:, None], Q, Q[300]), tau=TAU),
    "at rest at zero": messages(RESTS, tau=TAU),
    "spikes": messages(SPIKES, tau=TAU),
    "quick and coarse": messages(
        np.round(np.sin(17.0 * T)[:, None] + ZERO, 2), tau=TAU
    ),
}


@pytest.mark.parametrize("kind", ONE)
def test_one_publisher_is_taken_whole(kind: str, tmp_path: Path) -> None:
    log = write_messages(tmp_path / "log.mcap", ONE[kind], encoding="cdr")
    recording = read_recording(log, planar_2r())
    assert not [text for text in recording.health.warnings if "publisher" in text]
