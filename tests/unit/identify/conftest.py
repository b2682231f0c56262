import pytest

from tests.plants.robots.sample import Rig, sample_rig


@pytest.fixture(scope="session")
def one_joint() -> Rig:
    """The paper's one-joint rig."""
    return sample_rig("one_joint")


@pytest.fixture(scope="session")
def two_joint() -> Rig:
    """The paper's planar two-joint rig."""
    return sample_rig("two_joint")


@pytest.fixture(scope="session")
def six_joint() -> Rig:
    """An arm of a UR5e's size."""
    return sample_rig("six_joint")


@pytest.fixture(
    params=["one_joint", "two_joint", pytest.param("six_joint", marks=pytest.mark.slow)]
)
def rig(request: pytest.FixtureRequest) -> Rig:
    """Each of the rigs."""
    return request.getfixturevalue(request.param)
