"""Estimates at neighbouring cut-offs are compared by what they do not share."""

import numpy as np

from seqid_cli.identify.regression.least_squares import Accumulator, solve
from seqid_cli.identify.rigid import cutoff_check as checks
from seqid_cli.identify.rigid.cutoff_check import (
    CutoffDependence,
    Difference,
    Result,
    cutoff_check,
)
from seqid_cli.identify.rigid.posterior import Posterior
from seqid_cli.params.schema import Parameter, RigidStage
from seqid_cli.robot.base_parameters import base_parameters
from tests import Array
from tests.plants.arms.rigs import one_joint
from tests.plants.robots.lab import robot_of

THETA = np.array([2.0, -1.0, 0.5])
BLOCKS, ROWS = 40, 25


def result(H: Array, y: Array) -> Result:
    joint = Accumulator(len(THETA))
    for h, own in zip(np.split(H, BLOCKS), np.split(y, BLOCKS), strict=True):
        joint.add(h, own)
    solution = solve([joint])
    return solution, Posterior.of(solution, [None], np.zeros(1), {}, {})


def checked(seed: int, *, shrunk: float) -> tuple[CutoffDependence, Array]:
    """Return what the same rows, noisier and one column off, change;
    standard errors.
    """
    rng = np.random.default_rng(seed)
    H = rng.standard_normal((BLOCKS * ROWS, len(THETA)))
    y = H @ THETA + 0.5 * rng.standard_normal(len(H))
    own = result(H, y)
    other = result(H * [1.0 + shrunk, 1.0, 1.0], y + 0.1 * rng.standard_normal(len(H)))
    stated = np.sqrt(np.diag(own[1].covariance))
    return cutoff_check(own, {0.7: other}, [None]), stated


def test_noise_alone_is_not_said_and_adds_little() -> None:
    found = (checked(seed, shrunk=0.0) for seed in range(40))
    checks_of_seeds, stated = zip(*found, strict=True)
    assert sum(bool(check.differences) for check in checks_of_seeds) <= 1
    added = np.mean(
        [np.sum(check.directions**2, axis=1) for check in checks_of_seeds], axis=0
    )
    assert (added < 0.1 * stated[0] ** 2).all()


def test_a_parameter_that_depends_on_the_cutoff_is_named_and_its_error_grows() -> None:
    for seed in range(5):
        check, _ = checked(seed, shrunk=0.1)
        assert [x.place for x in check.differences] == [0]
        assert check.differences[0].multiple == 0.7
        assert check.differences[0].n_errors < -3.0
        # of the 2 / 1.1 - 2 that it differs by
        assert abs(check.directions[0, 0]) > 0.12
        assert (np.abs(check.directions[1:, 0]) < 0.03).all()


def difference(n_errors: float) -> Difference:
    return Difference(place=0, multiple=0.7, n_errors=n_errors)


def test_the_stage_is_poor_where_the_difference_matters() -> None:
    basis = base_parameters(robot_of("one", one_joint()), rotor=())
    name = basis.names[0]
    parameter = Parameter(name=name, value=1.0, std_error=0.1, unit="kg m")
    stage = RigidStage(parameters=[parameter], condition=1.0, rank=1)
    none, mild, poor = (
        checks.with_cutoff_check(stage, differences, basis)
        for differences in ([], [difference(1.5)], [difference(-6.0)])
    )
    assert none == stage
    assert not mild.verdicts
    assert f"{name} by +1.5 at 0.7 times" in mild.notes[-1]
    assert [v.good for v in poor.verdicts] == [False]
    assert f"{name} by -6.0 at 0.7 times" in poor.verdicts[0].reason
