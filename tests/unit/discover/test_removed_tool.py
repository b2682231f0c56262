"""A tool that the file still holds was taken off before the logs."""

from dataclasses import replace

import pytest

from seqid_cli.discover.diagnosis import diagnose
from seqid_cli.discover.options import DiscoverOptions
from tests.plants.cases import Case, declared_plant, injections
from tests.unit.discover.refinement.plants import Logs
from tests.unit.effects.few import only_effects

SECONDS = 12.0
WITH_TOOL = Logs(case=Case("six_joint", 1, (("payload", 0, 1.0),), seconds=SECONDS))
WITHOUT = Logs(case=Case("six_joint", 1, (), seconds=SECONDS))


@pytest.mark.slow
def test_a_removed_tool_is_told_where_the_urdf_has_it() -> None:
    phi = injections(WITH_TOOL.case)[-1].plant.arm.phi
    robot = replace(WITHOUT.robot, nominal=phi)
    with only_effects(["base_tilt", "payload"]):
        found = diagnose(
            WITHOUT.training, robot, WITH_TOOL.file().stages, options=DiscoverOptions()
        )
    (payload,) = [each for each in found.findings if each.effect == "payload"]
    gone = declared_plant(WITHOUT.case).arm.phi[-1] - phi[-1]
    values = {each.name: each.value for each in payload.parameters}
    assert values["payload_m"] == pytest.approx(gone[0], rel=0.03)
    assert values["payload_mz"] == pytest.approx(gone[3], rel=0.1)
