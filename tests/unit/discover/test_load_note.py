"""Where the rotor's inertia is not known, a finding says that the load is not."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import pytest

from seqid_cli.discover.candidates import Candidate
from seqid_cli.discover.rivals import load_note
from seqid_cli.model.effects.registry import CATALOGUE
from seqid_cli.robot.types import Robot
from tests.plants.robots.small import arm_6r


def robot_with(rotor: float | None, joint: int) -> Robot:
    arm = arm_6r()
    joints = [
        replace(one, rotor_inertia=rotor if j == joint else None)
        for j, one in enumerate(arm.joints)
    ]
    return replace(arm, joints=tuple(joints))


def ranked(effect: str, joint: int | None, gain: float) -> Any:
    what = Candidate(CATALOGUE[effect], joint, {})
    term = SimpleNamespace(what=what, key=(effect, joint), joint=joint)
    return SimpleNamespace(term=term, predicted=SimpleNamespace(total=gain))


def note(robot: Robot, joint: int | None, *effects: str) -> str:
    rivals = [ranked(effect, joint, 9.0 - k) for k, effect in enumerate(effects)]
    return load_note(robot, SimpleNamespace(term=rivals[0].term, rivals=tuple(rivals[::-1])))  # type: ignore[arg-type]


@pytest.mark.parametrize(
    "effects",
    [("position_dependent_friction", "gear_efficiency"), ("load_dependent_friction", "stribeck")],
)
def test_the_first_joint_lacks_its_rotor(effects: tuple[str, ...]) -> None:
    assert "give rotor_inertia of" in note(robot_with(None, 0), 0, *effects)
    assert note(robot_with(1e-4, 0), 0, *effects) == ""


def test_where_the_load_plays_no_part_nothing_is_said() -> None:
    arm = robot_with(None, 0)
    assert note(arm, 0, "stribeck", "friction_change", "gear_efficiency") == ""
    assert note(arm, 5, "load_dependent_friction") == ""  # its rotor turns by itself
    assert note(arm, None, "payload", "load_dependent_friction") == ""
