"""Logs that show less than a drive: each is named, with what to record."""

from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from seqid_cli import drive as drives
from seqid_cli.drive.checks import joints_beside, remarks_on_commands, resampled_period
from seqid_cli.drive.settings import DriveSettings, WindowSettings
from seqid_cli.drive.signals import courses_of_all, signals_of
from seqid_cli.logs.commands import is_held
from seqid_cli.logs.recording import Recording
from seqid_cli.model.torque import TorqueModel
from seqid_cli.params.results.drive import DriveFile
from seqid_cli.params.schema import Stages
from seqid_cli.robot.file import load_robot
from tests import Array
from tests.plants.driven import DrivenArm, drawn_arm, multisine, simulate_drive
from tests.unit.drive.test_drive import arm, file_of, number, recorded
from tests.unit.logs.writers import write_parquet

BY_ROWS = DriveSettings(windows=WindowSettings(most=0.0))
PLAIN = arm().with_drive(velocity_feedforward=np.zeros(1))


def by_rows(
    *logs: Recording, stages: Stages | None = None, of: DrivenArm | None = None
) -> DriveFile:
    chosen = PLAIN if of is None else of
    return drives.drive(
        list(logs), chosen.robot, file_of(chosen, stages), settings=BY_ROWS
    )


def told(file: DriveFile) -> str:
    return "\n".join([*file.notes, *(verdict.reason for verdict in file.verdicts)])


@cache
def sent(command_hz: float, rate_hz: float = 200.0, seed: int = 4) -> Recording:
    return simulate_drive(
        PLAIN,
        multisine(seed, 1, 6.0),
        6.0,
        seed=seed + 1000,
        command_hz=command_hz,
        rate_hz=rate_hz,
    )


@pytest.mark.parametrize("rows", [-2, 1])
def test_an_echo_of_another_row_is_named(rows: int) -> None:
    log = recorded()
    file = by_rows(replace(log, command=np.roll(log.q, rows, axis=0)))
    assert not file.joints
    assert "measured position" in told(file)


def test_an_echo_that_was_rounded_is_named() -> None:
    log = recorded()
    step = 1.5e-3
    coarse = step * np.round(log.q / step)
    echo = np.round(coarse, 3)
    file = by_rows(replace(log, q=coarse, command=echo))
    assert "measured position" in told(file)


def remarks(*logs: Recording) -> str:
    """What is said of the commands of some logs, without a fit."""
    model = TorqueModel.from_stages(PLAIN.stages(), PLAIN.robot)
    signals = [signals_of(log, model) for log in logs if log.command is not None]
    return "\n".join(remarks_on_commands(signals, logs, PLAIN.robot))


def test_a_log_without_commands_beside_others_is_named() -> None:
    without = replace(recorded(), command=None, path=Path("silent.parquet"))
    words = remarks(recorded(), without)
    assert "silent.parquet has no commanded position and is left out" in words


def test_commands_that_are_slower_than_rows_are_said_to_be() -> None:
    assert "every 20 ms, rows every 5 ms" in remarks(sent(50.0))


def test_every_row_its_command_leaves_half_a_row_open() -> None:
    assert "the delay is 2.5 ms shorter" in remarks(recorded())


def lines(log: Recording, every: int) -> Array:
    assert log.command is not None
    knots = np.arange(0, len(log.t), every)
    line = np.interp(log.t, log.t[knots], log.command[knots, 0])
    return np.asarray(line[:, None])


def test_commands_that_were_resampled_are_named() -> None:
    log = sent(50.0)
    line = replace(log, command=lines(log, 4), command_form="sampled", command_age=None)
    words = remarks(line)
    assert "commands of joint_1 run straight for 20 ms each" in words
    assert "the delay is 10 ms shorter" in words


@pytest.mark.parametrize("noise", [0.0, 1e-9])
def test_a_smooth_command_was_not_resampled(noise: float) -> None:
    log = recorded()
    assert log.command is not None
    rng = np.random.default_rng(0)
    command = log.command[:, 0] + noise * rng.standard_normal(len(log.t))
    assert resampled_period(command, 200.0) is None
    ramps = np.interp(log.t, [0.0, 2.0, 5.0, 12.0], [0.0, 1.0, 1.0, -1.0])
    assert resampled_period(ramps, 200.0) is None


@pytest.mark.parametrize("command_hz", [125.0, 150.0])
def test_commands_of_every_second_row_or_so_are_held(command_hz: float) -> None:
    """Rows at 200 Hz repeat some of them: no smooth command stops for one row."""
    t = np.arange(2000) / 200.0
    sent_t = np.floor(t * command_hz + 1e-9) / command_hz
    smooth = multisine(3, 1, 10.0)
    assert is_held(smooth(sent_t))
    assert not is_held(smooth(t))
    # A slow command in steps of an encoder repeats as well.
    assert not is_held(np.round(smooth(t) / 1.5e-3) * 1.5e-3)


def test_logs_whose_commands_come_differently_have_one_course_in_common() -> None:
    model = TorqueModel.from_stages(PLAIN.stages(), PLAIN.robot)
    held, smooth = (signals_of(log, model) for log in (sent(50.0), recorded()))
    assert courses_of_all([held]) == ["held", "interpolated"]
    assert courses_of_all([held, smooth]) == ["interpolated"]
    assert courses_of_all([smooth, held]) == ["interpolated"]


def test_damping_apart_from_viscous_friction_is_not_shown() -> None:
    silent = replace(recorded(), tau=None)
    stages = PLAIN.stages()
    without_friction = Stages(inertia=stages.inertia)
    derivative = number(by_rows(silent, stages=without_friction), "derivative")
    assert derivative.state == "not_shown"
    assert "viscous friction" in derivative.reason
    assert "log a torque" in derivative.reason
    assert number(by_rows(silent), "derivative").state == "identified"


def test_a_limit_that_is_never_reached_says_what_to_record() -> None:
    limit = number(by_rows(recorded()), "torque_limit")
    assert limit.state == "not_reached"
    assert "record large steps" in limit.reason


@cache
def two_joints() -> Recording:
    """A log of two joints, of which the second has no command."""
    log = simulate_drive(drawn_arm(2, 2), multisine(4, 2, 5.0), 5.0, seed=4)
    assert log.command is not None
    command = log.command.copy()
    command[:, 1] = np.nan
    return replace(log, command=command)


@cache
def without_second_joint() -> DriveFile:
    return by_rows(two_joints(), of=drawn_arm(2, 2))


@pytest.mark.slow
def test_a_joint_without_a_command_is_left_out_and_moves_as_measured() -> None:
    of = drawn_arm(2, 2)
    file = without_second_joint()
    assert list(file.joints) == ["joint_1"]
    assert "joint_2 is left out: the logs hold no command of it" in told(file)
    assert file.verdicts[0].good

    replayed = drives.replay([two_joints()], of.robot, file)
    assert list(replayed.joints) == ["joint_1"]
    assert "joint_2: no controller" in "\n".join(replayed.notes)
    position = replayed.joints["joint_1"].position
    assert position.rms < 0.1 * replayed.joints["joint_1"].start_plus_change.rms


def test_a_led_joint_is_where_the_log_has_it() -> None:
    from seqid_cli.drive.windows import _asked, closed_loop, windows_of

    of = drawn_arm(2, 2)
    file = without_second_joint()
    model = TorqueModel.from_stages(of.stages(), of.robot)
    log = signals_of(two_joints(), model)
    window = windows_of([log], 1.0, [0])[2]
    asked = _asked(file, [window], 1001, 1e-3)
    run = closed_loop(file, model, [log]).run(
        log.q[window.start][None],
        log.dq[window.start][None],
        log.torque[window.start][None],
        asked,
        1e-3,
    )
    at = window.start + np.arange(0, 200, 5)
    np.testing.assert_allclose(run.q[::25, 0, 1][:40], log.q[at, 1], atol=1e-5)


HAND = """<robot name="hand">
<link name="base"/><link name="arm"/><link name="left"/><link name="right"/>
<joint name="joint_1" type="revolute"><parent link="base"/><child link="arm"/>
<axis xyz="0 0 1"/><limit lower="-3" upper="3" velocity="3" effort="9"/></joint>
<joint name="finger" type="prismatic"><parent link="arm"/><child link="left"/>
<axis xyz="0 1 0"/><limit lower="0" upper="0.04" velocity="1" effort="9"/></joint>
<joint name="finger_2" type="prismatic"><parent link="arm"/><child link="right"/>
<axis xyz="0 1 0"/><limit lower="0" upper="0.04" velocity="1" effort="9"/>
<mimic joint="finger"/></joint></robot>
"""


def test_fingers_mimics_and_unknown_channels_are_left_out_by_name(
    tmp_path: Path,
) -> None:
    (tmp_path / "hand.urdf").write_text(HAND)
    (tmp_path / "robot.toml").write_text(
        'schema = "seqid/robot@1"\nname = "hand"\nurdf = "hand.urdf"\n'
        'gravity = [0.0, 0.0, -9.81]\n[[joint]]\nname = "joint_1"\n'
    )
    robot = load_robot(tmp_path / "robot.toml")
    log = recorded()
    path = write_parquet(
        tmp_path / "log.parquet", log.t, ["joint_1"], log.q, command=log.command
    )
    table = pq.read_table(path)
    for name in ("finger", "finger_2", "camera_tilt"):
        table = table.append_column(f"{name}.position", pa.array(log.q[:, 0]))
    pq.write_table(table, path)
    finger, second, camera = joints_beside([path], robot)
    assert "finger is left out: it slides" in finger
    assert "finger_2 is left out: it follows finger (mimic)" in second
    assert "camera_tilt is left out: it is no joint of the robot file" in camera
    assert 'name = "camera_tilt"' in camera


def test_a_mimic_joint_in_the_robot_file_changes_nothing_of_the_others(
    tmp_path: Path,
) -> None:
    links = (
        '<link name="base"/><link name="arm"><inertial><origin xyz="0.15 0 0"/>'
        '<mass value="1"/><inertia ixx="0.004" iyy="0.004" izz="0.004" ixy="0"'
        ' ixz="0" iyz="0"/></inertial></link>'
    )
    text = HAND.replace('<link name="base"/><link name="arm"/>', links)
    (tmp_path / "hand.urdf").write_text(text)
    log = recorded()
    assert log.command is not None
    assert log.tau is not None
    path = write_parquet(
        tmp_path / "log.parquet",
        log.t,
        ["joint_1", "finger_2"],
        np.hstack([log.q, 0.01 + 0.0 * log.q]),
        command=np.hstack([log.command, 0.0 * log.q]),
        torque=np.hstack([log.tau, 0.0 * log.q]),
    )
    files = []
    for joints in (["joint_1"], ["joint_1", "finger_2"]):
        (tmp_path / "robot.toml").write_text(
            'schema = "seqid/robot@1"\nname = "hand"\nurdf = "hand.urdf"\n'
            "gravity = [0.0, 0.0, -9.81]\n"
            + "".join(f'[[joint]]\nname = "{name}"\n' for name in joints)
        )
        files.append(drives.drive([path], tmp_path / "robot.toml", settings=BY_ROWS))
    without, with_mimic = files
    assert with_mimic.joints == without.joints
    assert "joint_1" in without.joints
    words = "finger_2 is left out: it follows finger (mimic)"
    assert [told(file).count(words) for file in files] == [1, 1]
