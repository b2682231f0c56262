"""The command that settles a name."""

import pytest

from seqid_cli.discover.diagnosis import separate_by
from seqid_cli.model.effects.registry import CATALOGUE
from tests.plants.robots.sample import sample_robot


@pytest.mark.parametrize(
    ("effect", "others", "joint", "command"),
    [
        ("stribeck", ("quadratic_drag",), 1, "--between stribeck,quadratic_drag --joint joint_2"),
        ("torque_bias", ("drift", "spring"), 0, "--between torque_bias,spring --joint joint_1"),
        ("payload", ("base_tilt",), None, "--between payload,base_tilt"),
        ("payload", ("spring",), None, ""),
        ("drift", ("torque_bias",), 0, ""),
        ("stribeck", (), 0, ""),
    ],
)
def test_the_command_names_a_rival_that_motion_can_settle(
    effect: str, others: tuple[str, ...], joint: int | None, command: str
) -> None:
    text = separate_by(CATALOGUE[effect], others, sample_robot("two_joint"), joint)
    ending = f"; seqid plan discriminate {command}, with these logs as --have, plans it"
    assert text.removeprefix(CATALOGUE[effect].separate_by) == (ending if command else "")
