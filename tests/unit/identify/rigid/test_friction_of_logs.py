"""Friction that differs between logs is said, judged and makes the surface less
certain.
"""

from dataclasses import replace

import numpy as np
import pytest

from seqid_cli.identify.friction_surface.corrections import HeldJoints
from seqid_cli.identify.regression.least_squares import Accumulator, solve
from seqid_cli.identify.rigid.friction_of_logs import FrictionShares
from seqid_cli.identify.rigid.gravity_rows import GravityRows
from seqid_cli.identify.settings import GravityFitSettings
from seqid_cli.params.schema import FrictionStage
from seqid_cli.robot.base_parameters import base_parameters
from tests.plants.arms.rigs import one_joint
from tests.plants.robots.lab import robot_of
from tests.unit.identify.rigid.test_gravity import (
    NEGATIVE,
    POSITIVE,
    SPREAD,
    drive_prior,
    surface_of,
    trials,
)

SETTINGS = GravityFitSettings()
ENTRIES = POSITIVE.size


def shares_of(change: float, *, seed: int = 3) -> FrictionShares:
    """Return the shares of two logs, friction being another by `change` in the
    second.
    """
    surface = surface_of(POSITIVE, NEGATIVE, (0.1 * SPREAD) ** 2 * np.eye(2 * ENTRIES))
    first = trials(np.random.default_rng(seed))
    second = [
        replace(
            trial,
            log=1,
            tau=trial.tau
            + change * surface.torque(trial.q, np.full(len(trial.q), trial.velocity)),
        )
        for trial in trials(np.random.default_rng(seed + 100))
    ]
    robot = robot_of("one", one_joint())
    held = HeldJoints(robot, base_parameters(robot, rotor=()), np.zeros(2))
    rows = GravityRows(held, [surface], FrictionStage(joints={}))
    joints = [Accumulator(rows.columns)]
    rows.add_joint([*first, *second], joints)
    solution = solve(joints, prior=drive_prior(surface), nuisances=slice(2, None))
    return FrictionShares.of(rows.joints[0], solution.theta)


@pytest.mark.parametrize("change", [-0.06, 0.04])
def test_change_of_friction_is_measured_and_said(change: float) -> None:
    shares = shares_of(change)
    difference = shares.shares[1] - shares.shares[0]
    assert abs(difference - change) < 3.0 * shares.spread_std
    assert shares.has_changed(SETTINGS)
    less_in = "warm.csv" if change < 0.0 else "cold.csv"
    verdict = shares.verdict("j1", ["cold.csv", "warm.csv"])
    assert verdict.level == "usable"
    assert f"less in {less_in}" in verdict.reason


@pytest.mark.parametrize("seed", range(4))
def test_friction_that_stays_is_not_said_to_change(seed: int) -> None:
    assert not shares_of(0.0, seed=seed).has_changed(SETTINGS)


def test_limits_are_settings() -> None:
    shares = shares_of(-0.06)
    assert not shares.has_changed(replace(SETTINGS, min_friction_change=0.1))
    assert not shares.has_changed(replace(SETTINGS, shown_sigma=50.0))
