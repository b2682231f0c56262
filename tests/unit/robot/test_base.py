"""Base parameters: identities, the paper's own case, and counts known from the literature."""

import numpy as np
import pytest

from seqid_cli.robot.base_parameters import (
    base_parameters,
    base_regressor,
    loaded_columns,
    standard_names,
    standard_regressor,
)
from seqid_cli.robot.kinematics import chain_from_dh
from seqid_cli.robot.regressor import gravity_regressor
from seqid_cli.robot.types import Robot
from tests.plants.robots.small import (
    HALF,
    arm_6r,
    planar_2r,
    random_model,
    robot_from_chain,
    states,
)


def _scara() -> Robot:
    rows = [
        (0.0, 0.0, 0.4, 0.0),
        (0.0, 0.3, 0.0, 0.0),
        (0.0, 0.25, 0.0, 0.0),
        (0.0, 0.0, 0.0, 0.0),
    ]
    return robot_from_chain(chain_from_dh(rows, [2]), gear_ratio=50.0)


def _skew() -> Robot:
    _, chain = random_model(np.random.default_rng(3), [False, False, True, False])
    return robot_from_chain(chain, gravity=np.array([1.0, 2.0, -9.0]), gear_ratio=-30.0)


def _seven() -> Robot:
    twists = (0.0, -HALF, HALF, HALF, -HALF, HALF, HALF)
    offsets = ((0.0, 0.333), (0, 0), (0, 0.316), (0.0825, 0), (-0.0825, 0.384), (0, 0), (0.088, 0))
    rows = [(al, a, d, 0.0) for al, (a, d) in zip(twists, offsets, strict=True)]
    return robot_from_chain(chain_from_dh(rows), gear_ratio=100.0)


ROBOTS = {
    "planar": planar_2r,
    "arm_6r": lambda: arm_6r(gear_ratio=101.0),
    "scara": _scara,
    "skew": _skew,
    "seven": _seven,
}


@pytest.mark.parametrize("rotors", ["none", "all", "last"])
@pytest.mark.parametrize("name", ROBOTS)
def test_base_parameters_say_all_and_nothing_twice(name: str, rotors: str) -> None:
    robot = ROBOTS[name]()
    rotor = {"none": [], "all": list(range(robot.n)), "last": [robot.n - 1]}[rotors]
    rng = np.random.default_rng(11)
    basis = base_parameters(robot, rotor=rotor)
    q, dq, ddq = states(rng, 200, robot.n)
    phi = rng.normal(size=11 * robot.n)
    phi[10 * robot.n :] *= np.isin(np.arange(robot.n), rotor)
    tau = standard_regressor(robot, q, dq, ddq, coupling="diagonal") @ phi
    H = base_regressor(robot, basis, q, dq, ddq)
    np.testing.assert_allclose(H @ (basis.expression @ phi), tau, atol=1e-10 * abs(tau).max())
    stacked = H.reshape(-1, basis.size)
    assert np.linalg.matrix_rank(stacked / np.linalg.norm(stacked, axis=0)) == basis.size
    identity = basis.expression @ basis.representative
    np.testing.assert_allclose(identity, np.eye(basis.size), atol=1e-9)


@pytest.mark.parametrize("name", ROBOTS)
def test_gravity_parameters_are_those_of_gravity_alone(name: str) -> None:
    robot = ROBOTS[name]()
    rng = np.random.default_rng(13)
    basis = base_parameters(robot, rotor=range(robot.n))
    g = int(basis.gravity.sum())
    assert basis.gravity.tolist() == [True] * g + [False] * (basis.size - g)
    q, _, _ = states(rng, 100, robot.n)
    at_rest = base_regressor(robot, basis, q, np.zeros_like(q), np.zeros_like(q))
    assert abs(at_rest[:, :, g:]).max(initial=0.0) < 1e-10
    Y = gravity_regressor(robot.chain, robot.gravity, q)
    phi = rng.normal(size=11 * robot.n)
    expected = Y @ phi[: 10 * robot.n]
    found = at_rest[:, :, :g] @ (basis.expression[:g] @ phi)
    np.testing.assert_allclose(found, expected, atol=1e-10)
    assert g == np.linalg.matrix_rank(Y.reshape(-1, 10 * robot.n), tol=1e-8)
    inertias = [k for k, n in enumerate(standard_names(robot.n)) if n[0] == "I"]
    assert not basis.expression[:g, inertias].any()


def test_planar_arm_has_the_papers_five_parameters() -> None:
    robot = planar_2r()
    basis = base_parameters(robot, rotor=[0, 1])
    assert not basis.gravity.any()
    assert basis.names == ("Izz_1", "mx_2", "my_2", "Izz_2", "Ia_2")
    # Eq. 44; N_2^2 is a factor of the column here
    assert basis.terms(0) == pytest.approx({"Izz_1": 1.0, "m_2": 0.09, "Ia_1": 36.0})
    assert [basis.expression_text(k) for k in range(1, 5)] == ["mx_2", "my_2", "Izz_2", "Ia_2"]
    assert basis.expression_text(0) == "Izz_1 + 0.09*m_2 + 36*Ia_1"


def test_expressions_are_tidy() -> None:
    basis = base_parameters(arm_6r(gear_ratio=101.0), rotor=range(6))
    elbow = basis.names.index("mx_3")
    assert basis.expression_text(elbow) == "mx_3 - 0.3922*m_4 - 0.3922*m_5 - 0.3922*m_6"
    assert list(basis.terms(elbow)) == ["mx_3", "m_4", "m_5", "m_6"]


def test_loaded_columns_are_all_that_differ_from_zero() -> None:
    robot = arm_6r()
    basis = base_parameters(robot, rotor=range(robot.n))
    q, dq, ddq = states(np.random.default_rng(21), 40, robot.n)
    H = base_regressor(robot, basis, q, dq, ddq)
    loaded = loaded_columns(robot, basis)
    assert loaded.shape == H.shape[1:]
    assert not H[:, ~loaded].any()
    assert loaded.sum() < loaded.size
    again = np.zeros((robot.n, basis.size + 1, len(q)))
    again[:, :-1][loaded] = np.nan  # what an earlier call left
    written = base_regressor(robot, basis, q, dq, ddq, spare=1, out=again)
    np.testing.assert_array_equal(written[:, :, :-1], H)
    assert np.shares_memory(written, again)
