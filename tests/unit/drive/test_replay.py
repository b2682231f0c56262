"""A replayed robot against logs that were not fitted, and against simpler guesses."""

from dataclasses import replace
from functools import cache
from pathlib import Path

import msgspec
import numpy as np
import pytest

from seqid_cli import drive as drives
from seqid_cli.drive.signals import signals_of
from seqid_cli.drive.simulation import Asked, ClosedLoop, FrictionTable, Gains
from seqid_cli.drive.windows import closed_loop
from seqid_cli.errors import ConfigError, InputError, UsageError
from seqid_cli.logs.recording import Recording
from seqid_cli.model.torque import TorqueModel
from seqid_cli.params.encode import encode
from seqid_cli.params.io import read_document
from seqid_cli.params.results.drive import DriveFile
from seqid_cli.params.results.replay import ReplayFile
from seqid_cli.params.schema import Stages
from tests.plants.driven import DrivenArm, drawn_arm, multisine, simulate_drive
from tests.unit.drive.test_drive import arm, file_of, recorded


@cache
def fitted() -> DriveFile:
    return drives.drive([recorded()], arm().robot, file_of(arm()))


@cache
def held_out(*, with_torque: bool = True) -> Recording:
    return simulate_drive(
        arm(), multisine(31, 1, 6.0), 6.0, seed=31, with_torque=with_torque
    )


@cache
def replayed() -> ReplayFile:
    return drives.replay([held_out()], arm().robot, fitted())


def with_true_gains(file: DriveFile, of: DrivenArm) -> DriveFile:
    """A drive file with the true gains in place of the fitted ones."""
    true = {
        "proportional": of.drive.proportional,
        "derivative": of.drive.derivative,
        "integral": of.drive.integral,
        "velocity_feedforward": of.drive.velocity_feedforward,
        "gravity_compensation": of.drive.gravity_compensation,
        "command_delay": np.full(of.robot.n, of.drive.command_delay),
    }
    changed = read_again(file)
    for j, joint in enumerate(changed.joints.values()):
        joint.offset = 0.0
        for parameter in joint.parameters:
            if parameter.name in true:
                parameter.value = float(true[parameter.name][j])
    return changed


def read_again(file: DriveFile) -> DriveFile:
    return msgspec.json.decode(encode(file), type=DriveFile)


@pytest.mark.slow
def test_a_held_out_log_is_followed_as_by_the_true_gains() -> None:
    position = replayed().joints["joint_1"].position
    true = drives.replay([held_out()], arm().robot, with_true_gains(fitted(), arm()))
    assert position.rms < 1.1 * true.joints["joint_1"].position.rms
    assert position.rms < 5e-4


@pytest.mark.slow
def test_true_numbers_are_off_by_little_more_than_noise() -> None:
    true = with_true_gains(fitted(), arm())
    (joint,) = drives.replay([held_out()], arm().robot, true).joints.values()
    assert joint.position.rms < 5e-5


@pytest.mark.slow
def test_an_integral_begins_as_the_log_has_summed_it_up() -> None:
    """Where a joint turns round, the torque of the moment says nothing of it."""
    integrating = arm().with_drive(integral=1.5 * arm().drive.proportional)
    log = simulate_drive(
        integrating, multisine(31, 1, 12.0), 12.0, seed=31, with_torque=False
    )
    true = with_true_gains(fitted(), integrating)
    (joint,) = drives.replay([log], arm().robot, true).joints.values()
    assert joint.position.worst.rms < 1e-4


def test_it_is_better_than_guesses_without_a_model() -> None:
    joint = replayed().joints["joint_1"]
    assert joint.position.rms < 0.1 * joint.delayed_command.rms
    assert joint.position.rms < 0.1 * joint.start_plus_change.rms
    assert joint.without_drive is not None
    assert joint.position.rms < joint.without_drive.rms
    assert joint.torque is not None
    assert joint.torque.rms < 0.1
    assert all(verdict.good for verdict in replayed().verdicts)


def test_the_worst_window_is_named() -> None:
    worst = replayed().joints["joint_1"].position.worst
    assert worst.log == str(held_out().path)
    assert 0.0 <= worst.start < 6.0
    assert worst.rms >= replayed().joints["joint_1"].position.rms


def test_a_log_without_torque_is_replayed_as_well() -> None:
    file = drives.replay([held_out(with_torque=False)], arm().robot, fitted())
    joint = file.joints["joint_1"]
    assert joint.torque is None
    assert joint.without_drive is None
    assert joint.position.rms < 1e-3


def test_a_wrong_drive_is_poor() -> None:
    wrong = read_again(fitted())
    for parameter in wrong.joints["joint_1"].parameters:
        if parameter.name == "proportional":
            assert parameter.value is not None
            parameter.value *= 0.2
        if parameter.name == "velocity_feedforward":
            parameter.value = 0.0
    file = drives.replay([held_out()], arm().robot, wrong)
    assert file.verdicts[0].level == "poor"
    assert "adds nothing" in file.verdicts[-1].reason


def test_logs_that_were_fitted_are_said() -> None:
    file = drives.replay([recorded()], arm().robot, fitted())
    assert any("fitted" in note for note in file.notes)


def test_the_file_is_read_again_as_it_was_written(tmp_path: Path) -> None:
    path = tmp_path / "replay.json"
    file = drives.replay([held_out()], arm().robot, fitted(), output=path)
    assert encode(read_document(path)) == encode(file)


def test_what_cannot_be_replayed_is_said() -> None:
    without = read_again(fitted())
    without.stages = Stages(friction=without.stages.friction)
    with pytest.raises(ConfigError, match="no inertia"):
        drives.replay([held_out()], arm().robot, without)
    incomplete = read_again(fitted())
    incomplete.joints = {}
    with pytest.raises(ConfigError, match="no controller of joint joint_1"):
        drives.replay([held_out()], arm().robot, incomplete)
    with pytest.raises(InputError, match="no commanded position"):
        drives.replay([replace(held_out(), command=None)], arm().robot, fitted())
    with pytest.raises(UsageError, match="window"):
        drives.replay(
            [held_out()],
            arm().robot,
            fitted(),
            drives.ReplayOptions(window_s=0.0),
        )
    with pytest.raises(InputError, match="no 60 s in which"):
        drives.replay(
            [held_out()],
            arm().robot,
            fitted(),
            drives.ReplayOptions(window_s=60.0),
        )


def test_a_joint_that_friction_holds_stays_where_it_is() -> None:
    """Friction is a torque up to its limit at rest, and the limit in motion."""
    drawn = drawn_arm(3, 2)
    model = TorqueModel.from_stages(drawn.stages(), drawn.robot)
    q0 = np.array([[np.pi / 2, 0.0]])
    nothing = np.zeros(2)
    gains = Gains(
        proportional=nothing,
        derivative=nothing,
        integral=nothing,
        velocity_feedforward=nothing,
        acceleration_feedforward=nothing,
        gravity=np.ones(2),
        offset=0.9 * drawn.coulomb,
        torque_limit=np.full(2, np.inf),
        velocity_limit=np.full(2, np.inf),
        dead_band=nothing,
        armature=nothing,
        coulomb=nothing,
        viscous=nothing,
        friction_factor=np.ones(2),
        stribeck=nothing,
        stribeck_speed=np.ones(2),
        load_friction=nothing,
    )
    tables = [FrictionTable.of(s, -3.0, 3.0, 3.0) for s in model.surfaces]
    steps = np.zeros((200, 1, 2))
    asked = Asked(c=steps, dc=steps, ddc=steps)
    loop = ClosedLoop(model=model, gains=gains, friction=tables)
    rest = np.zeros((1, 2))
    held = loop.run(q0, rest, rest, asked, 1e-3)
    np.testing.assert_allclose(held.q[-1], q0, atol=1e-9)

    pushed = replace(loop, gains=replace(gains, offset=1.5 * drawn.coulomb))
    assert (pushed.run(q0, rest, rest, asked, 1e-3).q[-1] > q0 + 1e-3).all()


@pytest.mark.slow
def test_half_the_step_moves_a_replay_by_little(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    joint = replayed().joints["joint_1"]
    monkeypatch.setattr("seqid_cli.drive.windows.STEP_S", 5e-4)
    finer = drives.replay([held_out()], arm().robot, fitted()).joints["joint_1"]
    assert abs(finer.position.rms - joint.position.rms) < 1e-4


def test_a_limit_of_the_torque_takes_part() -> None:
    drawn = arm()
    model = TorqueModel.from_stages(drawn.stages(), drawn.robot)
    signals = [signals_of(held_out(), model)]
    loop = closed_loop(fitted(), model, signals)
    gains = replace(loop.gains, torque_limit=np.array([0.5]))
    asked = Asked(
        c=np.ones((50, 1, 1)), dc=np.zeros((50, 1, 1)), ddc=np.zeros((50, 1, 1))
    )
    rest = np.zeros((1, 1))
    run = replace(loop, gains=gains).run(rest, rest, rest, asked, 1e-3)
    assert np.abs(run.torque).max() <= 0.5


def test_a_loop_that_is_not_stable_stays_a_number() -> None:
    wild = read_again(fitted())
    for parameter in wild.joints["joint_1"].parameters:
        if parameter.name == "proportional":
            parameter.value = -1e5
    file = drives.replay([held_out()], arm().robot, wild)
    assert np.isfinite(file.joints["joint_1"].position.rms)
    assert file.verdicts[0].level == "poor"
