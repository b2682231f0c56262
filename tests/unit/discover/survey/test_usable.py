"""Logs that say nothing are left out with a note; where nothing else is there, an error
says so.
"""

from dataclasses import replace

import numpy as np
import pytest

from seqid_cli.discover.scenes import usable_logs
from seqid_cli.errors import InputError
from seqid_cli.inspect.settings import EchoSettings
from seqid_cli.logs.recording import Recording, Whole
from tests.plants.robots.two_joint import two_joint_robot
from tests.unit.discover.drawn_logs import recording, wander

ROBOT = two_joint_robot()


def log(name: str, seed: int, *, coulomb: float) -> Recording:
    """A stiff controller's torque about a set point, with or without friction."""
    q = wander(20.0, seed)
    noise = np.random.default_rng(seed).normal(scale=0.02, size=q.shape)
    direction = np.tanh(np.gradient(q, axis=0) / 1e-4)
    return recording(q, 5.0 * (0.2 - q) + coulomb * direction + noise, name=name)


def test_echo_is_left_out_with_a_note() -> None:
    good, echo = log("good", 0, coulomb=0.8), log("hand.parquet", 1, coulomb=0.0)
    kept, (note,) = usable_logs(iter([good, echo]), ROBOT)
    assert kept == [good]
    for fragment in (
        "hand.parquet",
        *ROBOT.joint_names,
        "echo of the command",
        "motor current",
    ):
        assert fragment in note


def test_nothing_left_is_an_error() -> None:
    logs = [log("first", 0, coulomb=0.0), log("second", 1, coulomb=0.0)]
    with pytest.raises(InputError, match="echo of the command") as caught:
        usable_logs(logs, ROBOT)
    assert caught.value.where == "first"
    assert "and 1 more" in str(caught.value)
    hint = caught.value.hint or ""
    assert "motor current" in hint
    assert "--set echo.max_friction=0" in hint
    settings = EchoSettings(max_friction=0.0)
    assert usable_logs(logs, ROBOT, settings=settings) == (logs, ())


def test_pieces_stay_together() -> None:
    def piece(name: str, seed: int, coulomb: float) -> Recording:
        return replace(
            log(name, seed, coulomb=coulomb), source_log=Whole(name, 0.0, 80.0)
        )

    good, odd = [piece("one", k, 0.8) for k in range(2)], piece("one", 2, 0.0)
    assert usable_logs([*good, odd], ROBOT) == ([*good, odd], ())
    echo = [piece("two", k, 0.0) for k in range(3)]
    kept, notes = usable_logs([*good, *echo], ROBOT)
    assert kept == good
    assert [note.split()[0] for note in notes] == ["two"]
