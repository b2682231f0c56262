from collections.abc import Callable

import pytest

from tests.plants.robots.sample import Rig, sample_rig


def rig_fixture(name: str) -> Callable[[], Rig]:
    return pytest.fixture(lambda: sample_rig(name), scope="session", name=name)


one_joint, two_joint, six_joint = map(
    rig_fixture, ("one_joint", "two_joint", "six_joint")
)
