"""Every undeclared effect does what its size says, to the joint that it is put into."""

from dataclasses import replace

import numpy as np
import pytest

from tests import Array
from tests.plants.arms.vertical import vertical_two_joint
from tests.plants.effects.friction import rated_torque
from tests.plants.effects.registry import REGISTRY, inject
from tests.plants.mechanics.hidden import Hidden, Spring
from tests.plants.motions.trajectories import Reference, periodic
from tests.plants.robotfile import robot_toml
from tests.plants.simulate import Plant, simulate

STIFF = Hidden(springs=(Spring(1, 1e6, 30.0),))
PAIR = "transmission_coupling"


def rig() -> Plant:
    plant = vertical_two_joint(simple_friction=True)
    return replace(plant, current_noise=np.zeros(2), current_step=0.0)


@pytest.fixture(scope="module")
def motion() -> Reference:
    plant = rig()
    low, high = 0.9 * plant.position_limits.T
    top, push = 0.9 * plant.velocity_limits, 0.9 * plant.acceleration_limits
    rng = np.random.default_rng(3)
    return periodic(
        rng,
        low,
        high,
        top,
        push,
        period=2.0,
        periods=1,
        harmonics=2,
        rate_hz=1000.0,
        fade=0.5,
    )


@pytest.fixture(scope="module")
def plain(motion: Reference) -> Array:
    return torque_of(rig(), motion)


@pytest.fixture(scope="module")
def stiff(motion: Reference) -> Array:
    """The same with a spring that hardly bends:
    what elastic joints are compared with.
    """
    return torque_of(replace(rig(), hidden=STIFF), motion)


def torque_of(plant: Plant, motion: Reference) -> Array:
    return (
        simulate(plant, motion, 0, imus=False, start=600.0).current
        * plant.torque_per_ampere
    )


@pytest.mark.parametrize("name", sorted(REGISTRY))
def test_effect_shows_where_it_is(
    name: str, motion: Reference, plain: Array, stiff: Array
) -> None:
    """It changes the log, its own joint's most, and leaves the robot file as it was."""
    plant = rig()
    found = inject(name, plant, 1)
    change = torque_of(found.plant, motion) - (
        stiff if found.plant.hidden.springs else plain
    )
    share = np.sqrt(np.mean(change**2, axis=0)) / rated_torque(plant)
    assert share[1] > (0.0003 if name == "backlash" else 0.002)
    assert share.max() < 0.15
    assert found.joint in (None, 1)
    if found.joint == 1 and not found.plant.hidden.springs:
        assert share[1] > (1.0 if found.kind == PAIR else 2.0) * share[0]
    assert robot_toml("arm", found.declared) == robot_toml("arm", plant)
