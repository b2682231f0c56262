"""What `inspect` says of commands: lag, mode, limits, and what is no command."""

from pathlib import Path

import numpy as np
import pytest

from seqid_cli.inspect.channels.commands import lag_between
from seqid_cli.inspect.inspection import inspect_log, inspect_logs
from seqid_cli.params.results.inspection import InspectedCommand
from tests import Array
from tests.unit.logs.samples import JOINTS, make_robot
from tests.unit.logs.writers import write_parquet

RATE_HZ = 200.0
T = np.arange(4000) / RATE_HZ
FREQUENCIES = np.array([0.31, 0.47, 0.83, 1.29])


def motion(t: Array, joint: int = 0) -> Array:
    phases = np.random.default_rng(joint).uniform(0, 2 * np.pi, 4)
    waves = np.sin(2 * np.pi * FREQUENCIES * t[:, None] + phases)
    return np.asarray(waves @ (0.2 / FREQUENCIES))


def motions(t: Array) -> Array:
    return np.stack([motion(t, j) for j in range(3)], axis=1)


def inspected(path: Path, **commands: Array) -> list[InspectedCommand | None]:
    noise = 1e-5 * np.random.default_rng(2).standard_normal((len(T), 3))
    q = motions(T) + noise
    write_parquet(path, T, JOINTS, q, **commands)
    return [joint.command for joint in inspect_log(path, make_robot()).log.joints]


@pytest.mark.parametrize("lag_s", [0.004, 0.0123, 0.151])
def test_the_lag_of_a_position_holds_its_error(tmp_path: Path, lag_s: float) -> None:
    for command in inspected(tmp_path / "log.parquet", command=motions(T + lag_s)):
        assert command is not None
        assert (command.mode, command.form) == ("position", "sampled")
        assert command.lag_s is not None
        assert command.lag_std_s is not None
        assert abs(command.lag_s - lag_s) < 4.0 * command.lag_std_s + 1e-5
        assert command.lag_std_s < 1e-3


def test_the_error_of_a_lag_grows_with_what_is_no_lag() -> None:
    rng = np.random.default_rng(1)
    q = motion(T)
    wander = np.cumsum(rng.standard_normal(len(T))) * 1e-3
    valid = np.ones(len(T), np.bool_)
    clean = lag_between(motion(T + 0.05), q, valid, RATE_HZ)
    rough = lag_between(motion(T + 0.05) + wander, q, valid, RATE_HZ)
    assert clean is not None
    assert rough is not None
    assert clean.std_s is not None
    assert rough.std_s is not None
    assert rough.std_s > 10.0 * clean.std_s
    assert abs(rough.seconds - 0.05) < 4.0 * rough.std_s


def test_a_joint_that_follows_a_velocity(tmp_path: Path) -> None:
    velocity = np.gradient(motions(T + 0.03), T, axis=0)
    for command in inspected(tmp_path / "log.parquet", command_velocity=velocity):
        assert command is not None
        assert command.mode == "velocity"
        assert command.lag_s == pytest.approx(0.03, abs=2e-3)


def test_a_joint_that_is_asked_for_torque_and_its_limit(tmp_path: Path) -> None:
    torque = np.clip(4.0 * motions(T), -0.5, 0.5)
    for command in inspected(tmp_path / "log.parquet", command_torque=torque):
        assert command is not None
        assert command.mode == "torque"
        assert command.lag_s is None
        assert command.saturated is not None
        assert command.saturated == pytest.approx(
            np.mean(np.isclose(torque[:, 0], 0.5)), abs=0.3
        )


def codes(path: Path, command: Array) -> dict[str, str]:
    inspected(path, command=command)
    report = inspect_logs([path], make_robot())
    return {
        finding.code: finding.message
        for finding in report.findings
        if finding.channel == "command"
    }


def test_a_command_that_is_the_measured_position_is_said(tmp_path: Path) -> None:
    noise = 1e-5 * np.random.default_rng(2).standard_normal((len(T), 3))
    path = tmp_path / "log.parquet"
    assert list(codes(path, motions(T) + noise)) == ["command_echo"]
    command = inspect_log(path, make_robot()).log.joints[0].command
    assert command is not None
    assert command.mode == ""


def test_a_command_of_another_joint_is_said(tmp_path: Path) -> None:
    command = motions(T + 0.02)[:, [1, 2, 0]]
    assert list(codes(tmp_path / "log.parquet", command)) == ["command_not_followed"]


def test_a_command_in_degrees_is_said(tmp_path: Path) -> None:
    found = codes(tmp_path / "log.parquet", np.rad2deg(motions(T + 0.02)))
    assert "looks like degrees" in found["command_not_followed"]


def test_a_log_without_commands_says_nothing_of_them(tmp_path: Path) -> None:
    assert inspected(tmp_path / "log.parquet") == [None] * 3
