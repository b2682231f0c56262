"""What `plan drive` plans shows every number of a drive, and keeps the limits."""

from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest

from seqid_cli import drive as drives
from seqid_cli.drive.settings import DriveSettings, WindowSettings
from seqid_cli.motion.planned import sampled
from seqid_cli.params.results.plan import PlanFile
from seqid_cli.plan import PlanOptions, plan
from seqid_cli.robot.types import Joint, Robot
from tests import Array
from tests.plants.driven import GEAR, DrivenArm, drawn_arm, simulate_drive
from tests.unit.drive.test_drive import file_of

BANDWIDTH_HZ = 3.0


def limited(n: int) -> Robot:
    """The plant's robot with limits, as a robot file gives them."""
    robot = drawn_arm(2, n).robot
    joints = tuple(
        Joint(
            joint.name,
            gear_ratio=GEAR,
            position_limits=(-1.5, 1.5),
            velocity_limit=3.0,
        )
        for joint in robot.joints
    )
    return replace(robot, joints=joints)


@cache
def planned(n: int) -> PlanFile:
    arm = drawn_arm(2, n)
    options = PlanOptions(bandwidth_hz=BANDWIDTH_HZ, floor=False)
    return plan("drive", limited(n), [file_of(arm)], options)


def test_moves_keep_the_limits_and_reach_twice_the_bandwidth() -> None:
    file = planned(2)
    names = [move.name for move in file.moves]
    assert names == [
        "drive_chirp",
        "drive_slow",
        "drive_steps_joint_1",
        "drive_steps_joint_2",
    ]
    for move in file.moves:
        _, q, dq, ddq = sampled(move, list(file.limits), 1000.0)
        for j, limit in enumerate(file.limits.values()):
            # Moves were checked at fewer times.
            assert limit.position[0] - 1e-4 <= q[:, j].min()
            assert q[:, j].max() <= limit.position[1] + 1e-4
            assert np.abs(dq[:, j]).max() <= limit.speed * 1.001
            assert np.abs(ddq[:, j]).max() <= limit.acceleration * 1.02
    chirp = file.moves[0].chirp["joint_1"]
    assert chirp.highest_hz == pytest.approx(2.0 * BANDWIDTH_HZ)


def test_a_chirp_is_what_its_derivatives_say() -> None:
    t, q, dq, ddq = sampled(planned(2).moves[0], ["joint_1", "joint_2"], 2000.0)
    inside = slice(10, -10)
    np.testing.assert_allclose(
        np.gradient(q, t, axis=0)[inside], dq[inside], atol=2e-3 * np.abs(dq).max()
    )
    np.testing.assert_allclose(
        np.gradient(dq, t, axis=0)[inside], ddq[inside], atol=2e-3 * np.abs(ddq).max()
    )
    assert np.abs(dq[[0, -1]]).max() < 1e-6


def test_files_of_a_chirp_have_rows_for_its_waves(tmp_path: Path) -> None:
    arm = drawn_arm(2, 1)
    options = PlanOptions(bandwidth_hz=20.0, floor=False)
    plan("drive", limited(1), [file_of(arm)], options, trajectories=tmp_path)
    rows = (tmp_path / "drive_chirp.csv").read_text().splitlines()
    assert len(rows) > 350 * 20


def command_of(file: PlanFile) -> tuple[float, Array, Array]:
    """Chirp and steps one after the other, with straight ways between them."""
    times = [np.zeros(1)]
    places = [np.array([file.moves[0].start["joint_1"]])]
    for move in file.moves:
        if move.name == "drive_slow":
            continue
        t, q, _, _ = sampled(move, ["joint_1"], 200.0)
        times.append(times[-1][-1] + 2.0 + t)
        places.append(q[:, 0])
    return times[-1][-1] + 1.0, np.concatenate(times), np.concatenate(places)


def whole_drive() -> DrivenArm:
    """An arm whose controller has every part."""
    drawn = replace(drawn_arm(2, 1), robot=limited(1))
    drive = drawn.drive
    return drawn.with_drive(
        integral=2.0 * drive.proportional,
        velocity_feedforward=drive.derivative,
        gravity_compensation=np.ones(1),
        command_delay=0.0173,
        torque_lag=0.004,
    )


@pytest.mark.slow
def test_what_is_planned_shows_every_part_of_a_drive() -> None:
    seconds, t, q = command_of(planned(1))
    arm = whole_drive()

    def command(at: Array) -> Array:
        return np.interp(at, t, q)[..., None]

    log = simulate_drive(arm, command, seconds, seed=3)
    file = drives.drive(
        [log],
        arm.robot,
        file_of(arm),
        settings=DriveSettings(windows=WindowSettings(most=0.0)),
    )
    joint = file.joints["joint_1"]
    states = {each.name: each.state for each in joint.parameters}
    for name in (
        "command_delay",
        "torque_lag",
        "proportional",
        "derivative",
        "integral",
        "velocity_feedforward",
        "gravity_compensation",
    ):
        assert states[name] == "identified", name
    gain = arm.drive.proportional[0]
    assert joint.value("proportional") == pytest.approx(gain, rel=0.02)
