import pytest

from tests.plants.robots.sample import Rig, sample_rig


@pytest.fixture(scope="session")
def one_joint() -> Rig:
    return sample_rig("one_joint")


@pytest.fixture(scope="session")
def two_joint() -> Rig:
    return sample_rig("two_joint")


@pytest.fixture(scope="session")
def six_joint() -> Rig:
    return sample_rig("six_joint")
