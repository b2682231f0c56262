"""Trials in which a joint stops and starts between counts of its encoder are no
friction.
"""

from pathlib import Path

import numpy as np
import pytest

from seqid_cli.errors import QualityError
from seqid_cli.identify.friction_surface.stage import identify_friction
from seqid_cli.identify.options import FrictionOptions
from seqid_cli.motion.hunting import stops, torque_swing
from seqid_cli.params.schema import FrictionStage
from seqid_cli.robot.kinematics import chain_from_dh
from seqid_cli.robot.types import Joint, Robot
from tests.plants.hunting import HuntingJoint, HuntingLog, run
from tests.plants.robots.made import made_recording

SPEEDS = np.array([0.02, 0.04, 0.08, 0.15, 0.3, 0.6, 1.0])
EVERY = 5
RATE_HZ = 1000.0 / EVERY
# Its axis is level: gravity goes with the sine of the angle, as the plant's.
ROBOT = Robot(
    "one",
    (Joint("a"),),
    chain_from_dh([(np.pi / 2, 0.0, 0.0, 0.0)]),
    np.array([0.0, 0.0, -9.81]),
    "",
    Path("robot.toml"),
)


def identified(log: HuntingLog) -> FrictionStage:
    recording = made_recording(
        log.q[:, None], log.tau[:, None], rate_hz=RATE_HZ, path="log"
    )
    return identify_friction([recording], ROBOT, options=FrictionOptions())


def rests_within_counts(log: HuntingLog, speed: float) -> float:
    """Share of the time at one speed in which the joint stands,
    or goes the other way.
    """
    slope = np.abs(np.gradient(log.angle, log.t))
    width = max(1, int(0.5 * RATE_HZ))
    mean = np.convolve(slope, np.full(width, 1.0 / width), "same")
    there = np.abs(mean - speed) < 0.1 * speed
    return float(np.mean(np.abs(log.velocity[there]) < 0.05 * speed))


@pytest.mark.slow
@pytest.mark.parametrize(
    ("counts", "inertia", "hunts"),
    [
        pytest.param(2400, 0.5, (0.02,), id="fair"),
        pytest.param(2400, 2.0, (0.02,), marks=pytest.mark.slow, id="heavy"),
        pytest.param(8000, 0.5, (), id="fine"),
        pytest.param(8000, 2.0, (), marks=pytest.mark.slow, id="fine and heavy"),
    ],
)
def test_slow_trials_that_hunt_are_left_out_and_said(
    counts: int, inertia: float, hunts: tuple[float, ...]
) -> None:
    joint = HuntingJoint(counts=counts, inertia=inertia)
    log = run(joint, SPEEDS, seed=1, every=EVERY)
    for speed in SPEEDS[:4]:  # what no instrument shows
        assert (rests_within_counts(log, speed) > 0.15) == (speed in hunts), speed
    stage = identified(log)
    (found,) = stage.joints.values()
    used = [level.speed for level in found.speeds]
    assert not [v for v in used for slow in hunts if abs(v / slow - 1.0) < 0.2]
    assert found.speed_range[0] == pytest.approx(min(used))
    assert min(used) < (0.1 if hunts else 0.03)  # at most the next speed goes as well
    for level in found.speeds:
        error = abs(level.friction - joint.friction(level.speed))
        assert error < 4.0 * level.std_error + 0.005 * level.friction, level.speed
    said = [note for note in stage.notes if "stops and starts between counts" in note]
    assert len(said) == bool(hunts)
    assert all(f"{speed:g} (2 of 2)" in said[0] for speed in hunts)
    assert all("finer encoder" in note and "is not known" in note for note in said)


@pytest.mark.slow
def test_six_hundred_counts_leave_quick_trials_alone() -> None:
    joint = HuntingJoint(counts=600)
    log = run(joint, SPEEDS, seed=2, every=EVERY)
    stage = identified(log)
    (found,) = stage.joints.values()
    assert min(level.speed for level in found.speeds) > 0.1
    for level in found.speeds:
        error = abs(level.friction - joint.friction(level.speed))
        assert error < 4.0 * level.std_error
    assert "0.04 (2 of 2), 0.08 (2 of 2)" in " ".join(stage.notes)


def test_logs_in_which_nothing_slides_are_refused() -> None:
    log = run(HuntingJoint(counts=600), SPEEDS[1:3], seed=3, every=EVERY)
    with pytest.raises(
        QualityError, match=r"a: the joint stops and starts .* finer encoder"
    ):
        identified(log)


def test_swings_count_at_the_frequency_of_counts_alone() -> None:
    rate_hz, counts_hz = 200.0, 5.0
    t = np.arange(0.0, 40.0, 1.0 / rate_hz)
    white = 0.15 * np.random.default_rng(0).standard_normal(len(t))
    slow = 3.0 * np.sin(2.0 * np.pi * 0.2 * t)  # friction over the position
    quick = 3.0 * np.sin(2.0 * np.pi * counts_hz * t)
    expected = 3.0 / (2.0 * np.pi * counts_hz)
    assert torque_swing(white, rate_hz, counts_hz) < 0.05 * expected
    assert torque_swing(slow + white, rate_hz, counts_hz) < 0.05 * expected
    found = torque_swing(quick + slow + white, rate_hz, counts_hz)
    assert found == pytest.approx(expected, rel=0.1)
    assert torque_swing(quick[:5], rate_hz, counts_hz) == 0.0
    assert torque_swing(quick, rate_hz, np.inf) == 0.0  # counts are not known


def test_readings_stop_where_a_joint_jumps_over_counts() -> None:
    rate_hz, speed, count = 100.0, 0.1, 0.002
    t = np.arange(0.0, 10.0, 1.0 / rate_hz)
    even = speed * t
    jumping = 10.0 * count * np.floor(even / (10.0 * count))
    shaken = even + 0.4 * count * np.sin(60.0 * t)
    for q, expected in ((even, False), (jumping, True), (shaken, False)):
        counted = np.round(q / count) * count
        assert stops(counted, rate_hz, speed, count) == expected
    assert not stops(np.round(even / count) * count, rate_hz, speed, 0.0)
