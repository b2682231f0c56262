"""Losses of a joint whose rotor nothing else tells from its link."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest

from seqid_cli.discover.options import DiscoverOptions
from seqid_cli.discover.refinement.rounds import refine
from seqid_cli.model.effects.gear_load import ROTOR
from tests.studies.loop.logs import Case, recorded
from tests.studies.undeclared.logs import sequential
from tests.studies.undeclared.refine import file_of

LOSS = 0.1  # of the load, in all logs of the case


@pytest.mark.slow
def test_refine_finds_loss_and_rotor_of_a_joint_that_hides_it(tmp_path: Path) -> None:
    logs = recorded(Case("two", "load_dependent_friction", 0, 12), tmp_path)
    first, *rest = logs.robot.joints
    assert first.rotor_inertia is not None
    assert first.gear_ratio is not None
    reflected = first.gear_ratio**2 * first.rotor_inertia
    robot = replace(logs.robot, joints=(replace(first, rotor_inertia=None), *rest))
    file = file_of(robot, sequential(logs.earlier, robot), logs.earlier)
    options = DiscoverOptions()
    found = refine(logs.training, robot, file, earlier=logs.earlier, options=options).stages.effects
    assert found is not None
    (loss,) = found
    assert (loss.effect, loss.joint) == ("load_dependent_friction", first.name)
    assert loss.parameters[0].value == pytest.approx(LOSS, rel=0.04)
    assert loss.settings[ROTOR] == pytest.approx(reflected, rel=0.15)
