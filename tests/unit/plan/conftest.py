from collections.abc import Sequence

import pytest

from seqid_cli.params.schema import Stages
from seqid_cli.plan.belief import Belief, belief_of
from seqid_cli.plan.limits import limits_of
from tests.plants.robots.sample import sample_robot


def believed(
    name: str, stages: Stages | None = None, locked: Sequence[str] = ()
) -> Belief:
    """Return the belief of a sample robot before the experiment."""
    robot = sample_robot(name)
    return belief_of(
        robot, stages or Stages(), limits_of(robot, ramp_s=0.3, locked=locked)
    )


@pytest.fixture(scope="session")
def belief() -> Belief:
    return believed("six_joint")
