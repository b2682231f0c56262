"""Controllers of drawn arms: what is there, its errors, and what cannot be told."""

from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from seqid_cli import drive as drives
from seqid_cli.drive.settings import DriveSettings, WindowSettings
from seqid_cli.errors import ConfigError, InputError
from seqid_cli.logs.recording import Recording
from seqid_cli.params.document import head, robot_id
from seqid_cli.params.encode import encode
from seqid_cli.params.io import read_document
from seqid_cli.params.results.drive import DriveFile, DriveParameter
from seqid_cli.params.schema import ParameterFile, Stages
from tests import Array
from tests.plants.driven import DrivenArm, drawn_arm, multisine, simulate_drive

pytestmark = pytest.mark.slow

SECONDS = 12.0


@cache
def arm(n: int = 1, seed: int = 2) -> DrivenArm:
    """An arm with every part but the integral and the feed-forward of acceleration."""
    drawn = drawn_arm(seed, n)
    drive = drawn.drive
    return drawn.with_drive(
        integral=0.0 * drive.integral,
        velocity_feedforward=drive.derivative,
        gravity_compensation=np.ones(n),
        command_delay=0.0173,
        torque_lag=0.004,
    )


def file_of(arm: DrivenArm, stages: Stages | None = None) -> ParameterFile:
    return ParameterFile(
        **head("seqid/params@1", "2026-01-01T00:00:00Z"),
        robot=robot_id(arm.robot),
        inputs=[],
        stages=arm.stages() if stages is None else stages,
    )


@cache
def recorded(**own: Any) -> Recording:
    return simulate_drive(arm(), multisine(4, 1, SECONDS), SECONDS, seed=4, **own)


def identified(log: Recording, of: DrivenArm | None = None, **own: Any) -> DriveFile:
    of = of or arm()
    return drives.drive([log], of.robot, file_of(of), drives.DriveOptions(**own))


def number(file: DriveFile, name: str, joint: str = "joint_1") -> DriveParameter:
    (found,) = [each for each in file.joints[joint].parameters if each.name == name]
    return found


def true_values(of: DrivenArm, j: int = 0) -> dict[str, float]:
    drive = of.drive
    gains = {
        "proportional": drive.proportional,
        "derivative": drive.derivative,
        "integral": drive.integral,
        "velocity_feedforward": drive.velocity_feedforward,
        "gravity_compensation": drive.gravity_compensation,
    }
    values = {name: float(column[j]) for name, column in gains.items()}
    values["acceleration_feedforward"] = 0.0
    return values | {
        "command_delay": drive.command_delay,
        "torque_lag": drive.torque_lag,
    }


def assert_holds(file: DriveFile, of: DrivenArm, *, sigma: float = 4.0) -> None:
    for name, true in true_values(of).items():
        found = number(file, name)
        if found.value is None:
            assert found.reason
            continue
        assert found.std_error is not None
        assert abs(found.value - true) < sigma * found.std_error, name


def test_gains_and_delays_hold_their_errors_with_a_torque() -> None:
    file = identified(recorded())
    assert file.method == "torque"
    assert_holds(file, arm())
    proportional = number(file, "proportional")
    assert proportional.std_error is not None
    assert proportional.std_error < 0.01 * arm().drive.proportional[0]
    assert number(file, "integral").state == "absent"
    assert number(file, "gravity_compensation").state == "identified"
    assert number(file, "command_delay").value == pytest.approx(0.0173, abs=1e-3)
    assert [verdict.good for verdict in file.verdicts] == [True, True]


def test_an_integral_is_found() -> None:
    drawn = arm().with_drive(integral=2.0 * arm().drive.proportional)
    log = simulate_drive(drawn, multisine(5, 1, SECONDS), SECONDS, seed=5)
    file = identified(log, drawn)
    assert number(file, "integral").state == "identified"
    assert_holds(file, drawn)


def test_gains_and_delays_hold_their_errors_without_a_torque() -> None:
    file = identified(recorded(with_torque=False))
    assert file.method == "motion"
    assert_holds(file, arm())
    lag = number(file, "torque_lag")
    assert lag.state == "not_shown"
    assert "log it" in lag.reason
    feedforward = number(file, "acceleration_feedforward")
    assert feedforward.state == "not_shown"


def test_a_logged_torque_can_be_left_aside() -> None:
    assert identified(recorded(), no_torque=True).method == "motion"


def test_held_commands_give_the_delay_within_a_row() -> None:
    plain = arm().with_drive(velocity_feedforward=np.zeros(1))
    log = simulate_drive(
        plain, multisine(4, 1, SECONDS), SECONDS, seed=4, command_hz=50.0
    )
    file = identified(log, plain)
    joint = file.joints["joint_1"]
    assert (joint.command, joint.command_known) == ("held", True)
    delay = number(file, "command_delay")
    assert delay.low is not None
    assert delay.high is not None
    assert delay.low < 0.0173 < delay.high
    # Rows are 5 ms apart: what moves after a step tells when it came.
    assert delay.high - delay.low < 2e-3
    assert_holds(file, plain)


def test_a_limit_of_the_torque_is_found_and_left_out() -> None:
    free = identified(recorded())
    largest = number(free, "torque_limit").low
    assert largest is not None
    assert number(free, "torque_limit").state == "not_reached"

    limited = arm().with_drive(torque_limit=np.array([0.6 * largest]))
    log = simulate_drive(limited, multisine(4, 1, SECONDS), SECONDS, seed=4)
    file = identified(log, limited)
    limit = number(file, "torque_limit")
    assert limit.state == "identified"
    assert limit.value == pytest.approx(0.6 * largest, rel=0.01)
    assert number(file, "proportional").value == pytest.approx(
        arm().drive.proportional[0], rel=0.02
    )


BY_ROWS = DriveSettings(windows=WindowSettings(most=0.0))


@cache
def drawn(seed: int, n: int, *, sent: bool = False) -> tuple[DrivenArm, DriveFile]:
    """A drawn arm by its rows; `sent`: commands at 50 Hz by a clock of their own."""
    of = drawn_arm(seed, n)
    own: dict[str, Any] = {}
    if sent:
        of = of.with_drive(velocity_feedforward=np.zeros(n))
        own = {"command_hz": 50.0, "own_clock": True}
    log = simulate_drive(of, multisine(seed, n, 20.0), 20.0, seed=seed, **own)
    return of, drives.drive([log], of.robot, file_of(of), settings=BY_ROWS)


def test_a_law_that_lacks_its_integral_shows_no_limit() -> None:
    of, file = drawn(1007, 3)
    assert of.drive.integral[2] > 0.0
    assert number(file, "torque_limit", "joint_3").state == "not_reached"
    integral = number(file, "integral", "joint_3")
    assert integral.value == pytest.approx(of.drive.integral[2], rel=0.01)


def test_a_fast_loop_keeps_its_damping_and_its_gain() -> None:
    of, file = drawn(1119, 1)
    assert_holds(file, of)
    assert number(file, "proportional").value == pytest.approx(
        of.drive.proportional[0], rel=0.01
    )
    assert number(file, "derivative").state == "identified"


def test_a_delay_is_not_taken_for_feed_forward_of_the_acceleration() -> None:
    of, file = drawn(1129, 1)
    assert number(file, "acceleration_feedforward").state == "absent"
    assert_holds(file, of)


def test_steps_of_other_joints_do_not_move_the_gains() -> None:
    of, file = drawn(1202, 6, sent=True)
    for j, name in enumerate(of.robot.joint_names):
        joint = file.joints[name]
        assert (joint.command, joint.command_known) == ("held", True)
        gain = number(file, "proportional", name)
        true = of.drive.proportional[j]
        assert gain.std_error is not None
        assert gain.value == pytest.approx(true, abs=4.0 * gain.std_error)
        assert gain.value == pytest.approx(true, rel=3e-3)


def test_a_joint_without_gravity_cannot_show_its_compensation() -> None:
    drawn = drawn_arm(3, 1)
    upright = replace(
        drawn, robot=replace(drawn.robot, gravity=np.array([0.0, 0.0, 0.0]))
    )
    log = simulate_drive(upright, multisine(6, 1, SECONDS), SECONDS, seed=6)
    gravity = number(identified(log, upright), "gravity_compensation")
    assert gravity.state == "not_shown"
    assert "gravity" in gravity.reason


def with_command(command: Array | None, **own: Any) -> Recording:
    return replace(recorded(), command=command, **own)


@pytest.mark.parametrize(
    ("command", "words"),
    [
        (recorded().q, "measured position"),
        (0.0 * recorded().q, "never changes"),
        (np.nan * recorded().q, "no command of it"),
    ],
    ids=["echo", "constant", "none"],
)
def test_what_is_no_command_is_said(command: Array, words: str) -> None:
    file = identified(with_command(command))
    assert not file.joints
    (reason,) = [each.reason for each in file.verdicts if each.joint]
    assert words in reason


def test_a_command_that_the_joint_does_not_follow_is_poor() -> None:
    file = identified(with_command(multisine(9, 1, SECONDS)(recorded().t)))
    assert file.verdicts[0].level == "poor"


def test_a_log_without_commands_is_an_error() -> None:
    log = with_command(None, command_velocity=recorded().q)
    with pytest.raises(InputError, match=r"no commanded position, but .*velocity"):
        identified(log)


def test_a_model_without_a_rigid_body_is_an_error() -> None:
    stages = Stages(friction=arm().stages().friction)
    with pytest.raises(ConfigError, match="no rigid body"):
        drives.drive([recorded()], arm().robot, file_of(arm(), stages))


def test_the_file_is_read_again_as_it_was_written(tmp_path: Path) -> None:
    path = tmp_path / "drive.json"
    file = drives.drive([recorded()], arm().robot, file_of(arm()), output=path)
    again = read_document(path)
    assert encode(again) == encode(file) == path.read_text(encoding="utf-8")


def test_delays_of_joints_are_one_where_they_are() -> None:
    drawn = drawn_arm(8, 2).with_drive(command_delay=0.021)
    log = simulate_drive(drawn, multisine(8, 2, SECONDS), SECONDS, seed=8)
    file = identified(log, drawn)
    assert file.command_delay is not None
    assert file.command_delay.value == pytest.approx(0.021, abs=1e-3)
