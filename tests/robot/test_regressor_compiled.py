"""The compiled regressor against Pinocchio and against numpy's; skipped without numba."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from seqid_cli import compiled
from seqid_cli.robot.base import Coupling, base_parameters, base_regressor, loaded_columns
from seqid_cli.robot.regressor import torque_regressor

from .robots import arm_6r, oracle_regressor, random_model, states

pytestmark = pytest.mark.skipif(not compiled.available(), reason="numba is not installed")
MIXED = [False, False, True, False, False, True, False]


@settings(deadline=None, max_examples=40)
@given(
    prismatic=st.lists(st.booleans(), min_size=1, max_size=8),
    seed=st.integers(min_value=0, max_value=2**32 - 1),
)
def test_it_is_pinocchios_on_any_chain(prismatic: list[bool], seed: int) -> None:
    rng = np.random.default_rng(seed)
    model, chain = random_model(rng, prismatic)
    model.gravity.linear = rng.normal(size=3) * 5.0
    q, dq, ddq = states(rng, 5, chain.n)
    Y = torque_regressor(chain, model.gravity.linear.copy(), q, dq, ddq, use_compiled=True)
    expected = oracle_regressor(model, q, dq, ddq)
    np.testing.assert_allclose(Y, expected, rtol=0.0, atol=1e-12 * max(1.0, abs(expected).max()))


@pytest.mark.parametrize("samples", [0, 1, 383, 384, 385, 3072, 3073, 4000])
@pytest.mark.parametrize("columns", [None, [], [0, 2, 7, 11, 13, 40, 44, 49, 66, 69]])
def test_both_ways_agree_and_have_no_seams(samples: int, columns: list[int] | None) -> None:
    rng = np.random.default_rng(samples)
    _, chain = random_model(rng, MIXED)
    gravity = np.array([1.0, -2.0, 9.0])
    q, dq, ddq = states(rng, samples, chain.n)
    plain, fast = (
        torque_regressor(chain, gravity, q, dq, ddq, columns=columns, use_compiled=use)
        for use in (False, True)
    )
    assert fast.shape == plain.shape
    largest = np.abs(plain).max(initial=1.0)
    np.testing.assert_allclose(fast, plain, rtol=0.0, atol=1e-12 * largest)


def test_angles_of_many_turns_lose_no_more_than_they_must() -> None:
    rng = np.random.default_rng(1)
    _, chain = random_model(rng, [False] * 4)
    q, dq, ddq = states(rng, 600, 4)
    quarters = np.arange(600)[:, None] * (np.pi / 2) - 470.0  # at and around multiples, both signs
    for shift in (quarters + 1e-9 * q, 9.0e4 + q, -3.0e5 + q, 1e9 * q):
        plain, fast = (
            torque_regressor(chain, np.zeros(3), shift, dq, ddq, use_compiled=use)
            for use in (False, True)
        )
        np.testing.assert_allclose(fast, plain, rtol=0.0, atol=1e-12 * np.abs(plain).max())


def test_what_is_not_a_number_stays_in_its_sample() -> None:
    rng = np.random.default_rng(2)
    _, chain = random_model(rng, [False, True, False])
    q, dq, ddq = states(rng, 500, 3)
    expected = torque_regressor(chain, np.ones(3), q, dq, ddq, use_compiled=True)
    q[123] = np.nan
    found = torque_regressor(chain, np.ones(3), q, dq, ddq, use_compiled=True)
    assert np.isnan(found[123]).any()
    rest = np.arange(500) != 123
    np.testing.assert_array_equal(found[rest], expected[rest])


@pytest.mark.parametrize("coupling", ["diagonal", "gyroscopic"])
def test_base_columns_are_numpys(coupling: Coupling) -> None:
    robot = arm_6r()
    basis = base_parameters(robot, rotor=range(robot.n), coupling=coupling)
    state = states(np.random.default_rng(3), 1000, robot.n)
    plain = base_regressor(robot, basis, *state, spare=1, use_compiled=False)
    fast = base_regressor(robot, basis, *state, spare=1, use_compiled=True)
    np.testing.assert_allclose(fast, plain, rtol=0.0, atol=1e-12 * np.abs(plain).max())
    again = np.zeros((robot.n, basis.size + 1, 1000))
    again[:, :-1][loaded_columns(robot, basis)] = np.nan  # what an earlier call left
    written = base_regressor(robot, basis, *state, spare=1, out=again, use_compiled=True)
    np.testing.assert_array_equal(written, fast)
    assert np.shares_memory(written, again)


def test_memory_of_another_layout_is_filled_by_numpy() -> None:
    robot = arm_6r()
    basis = base_parameters(robot, rotor=[])
    state = states(np.random.default_rng(4), 50, robot.n)
    wide = np.zeros((robot.n, basis.size, 100))
    written = base_regressor(robot, basis, *state, out=wide[:, :, ::2], use_compiled=True)
    np.testing.assert_array_equal(written, base_regressor(robot, basis, *state))
