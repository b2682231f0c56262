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


def _arm(*rows: tuple[float, float, float], slides: tuple[int, ...] = (), ratio: float) -> Robot:
    """An arm of (alpha, a, d) per joint."""
    chain = chain_from_dh([(*row, 0.0) for row in rows], slides)
    return robot_from_chain(chain, gear_ratio=ratio)


SKEW = random_model(np.random.default_rng(3), [False, False, True, False])[1]
ROBOTS = {
    "planar": planar_2r(),
    "arm_6r": arm_6r(gear_ratio=101.0),
    "scara": _arm((0, 0, 0.4), (0, 0.3, 0), (0, 0.25, 0), (0, 0, 0), slides=(2,), ratio=50.0),
    "skew": robot_from_chain(SKEW, gravity=np.array([1.0, 2.0, -9.0]), gear_ratio=-30.0),
    "seven": _arm(
        (0, 0, 0.333),
        (-HALF, 0, 0),
        (HALF, 0, 0.316),
        (HALF, 0.0825, 0),
        (-HALF, -0.0825, 0.384),
        (HALF, 0, 0),
        (HALF, 0.088, 0),
        ratio=100.0,
    ),
}


@pytest.mark.parametrize("rotors", ["none", "all", "last"])
@pytest.mark.parametrize("name", ROBOTS)
def test_base_parameters_say_all_and_nothing_twice(name: str, rotors: str) -> None:
    robot = ROBOTS[name]
    rotor = {"none": [], "all": range(robot.n), "last": [robot.n - 1]}[rotors]
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
    robot = ROBOTS[name]
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
    basis = base_parameters(planar_2r(), rotor=[0, 1])
    assert not basis.gravity.any()
    assert basis.names == ("Izz_1", "mx_2", "my_2", "Izz_2", "Ia_2")
    # Eq. 44; N_2^2 is a factor of the column here
    assert basis.terms(0) == pytest.approx({"Izz_1": 1.0, "m_2": 0.09, "Ia_1": 36.0})
    assert [basis.expression_text(k) for k in range(1, 5)] == ["mx_2", "my_2", "Izz_2", "Ia_2"]
    assert basis.expression_text(0) == "Izz_1 + 0.09*m_2 + 36*Ia_1"
    basis = base_parameters(arm_6r(gear_ratio=101.0), rotor=range(6))
    elbow = basis.expression_text(basis.names.index("mx_3"))
    assert elbow == "mx_3 - 0.3922*m_4 - 0.3922*m_5 - 0.3922*m_6"


def test_loaded_columns_are_all_that_differ_from_zero() -> None:
    robot = arm_6r()
    basis = base_parameters(robot, rotor=range(robot.n))
    q, dq, ddq = states(np.random.default_rng(21), 40, robot.n)
    H = base_regressor(robot, basis, q, dq, ddq)
    loaded = loaded_columns(robot, basis)
    assert not H[:, ~loaded].any()
    assert loaded.sum() < loaded.size
    again = np.zeros((robot.n, basis.size + 1, len(q)))
    again[:, :-1][loaded] = np.nan  # what an earlier call left
    written = base_regressor(robot, basis, q, dq, ddq, spare=1, out=again)
    np.testing.assert_array_equal(written[:, :, :-1], H)
