"""Chains, regressors and base parameters against Pinocchio, Lagrange and the
literature.
"""

import tracemalloc
from collections.abc import Callable

import numpy as np
import pinocchio as pin
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from seqid_cli.robot import base_parameters as base
from seqid_cli.robot import kinematics, regressor
from seqid_cli.robot.base_parameters import base_parameters, base_regressor
from seqid_cli.robot.kinematics import chain_from_dh, rotation_about
from seqid_cli.robot.regressor import (
    inverse_dynamics,
    rotor_regressor,
    torque_regressor,
)
from seqid_cli.robot.types import Array, Chain
from tests.plants.robots import small
from tests.plants.robots.small import (
    HALF,
    arm_6r,
    planar_2r,
    random_model,
    robot_from_chain,
)

X, Z = np.eye(3)[[0, 2]]


@settings(deadline=None, max_examples=40)
@given(
    prismatic=st.lists(st.booleans(), min_size=1, max_size=8),
    seed=st.integers(min_value=0, max_value=2**32 - 1),
)
def test_regressor_and_torque_are_pinocchios_on_any_chain(
    prismatic: list[bool], seed: int
) -> None:
    rng = np.random.default_rng(seed)
    model, chain = random_model(rng, prismatic)
    model.gravity.linear = gravity = rng.normal(size=3) * 5.0
    q, dq, ddq = small.states(rng, 5, chain.n)
    Y = torque_regressor(chain, gravity, q, dq, ddq)
    expected = small.oracle_regressor(model, q, dq, ddq)
    size = max(1.0, abs(expected).max())
    np.testing.assert_allclose(Y, expected, rtol=0.0, atol=1e-12 * size)
    phi = np.array([inertia.toDynamicParameters() for inertia in model.inertias[1:]])
    tau = inverse_dynamics(chain, gravity, phi, q, dq, ddq)
    np.testing.assert_allclose(tau, expected @ phi.ravel(), rtol=1e-11, atol=1e-10)


def test_torque_of_a_long_log_is_that_of_its_parts_and_holds_little_else() -> None:
    rng = np.random.default_rng(2)
    _, chain = random_model(rng, [False, True, False, False, False, False])
    gravity = rng.normal(size=3)
    phi = rng.normal(size=(chain.n, 10))
    q, dq, ddq = rng.normal(size=(3, 40_000, chain.n))
    inverse_dynamics(chain, gravity, phi, q[:1], dq[:1], ddq[:1])

    tracemalloc.start()
    tau = inverse_dynamics(chain, gravity, phi, q, dq, ddq)
    _, peak = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert peak < 4 * tau.nbytes

    parts = [slice(0, 1), slice(1, 4_097), slice(4_097, None)]
    by_part = [
        inverse_dynamics(chain, gravity, phi, q[part], dq[part], ddq[part])
        for part in parts
    ]
    np.testing.assert_allclose(tau, np.concatenate(by_part), rtol=1e-12, atol=1e-12)


def test_dh_frames_are_products_of_the_four_moves() -> None:
    def move(axis: Array, angle: float, slide: float) -> Array:
        return pin.SE3(rotation_about(axis, angle), slide * axis).homogeneous

    rows = [(0.3, 0.2, 0.5, -0.7), (-1.1, 0.1, 0.4, 0.9)]
    q = np.array([0.6, 0.25])
    T = np.eye(4)
    for alpha, a, d, theta in [
        (0.3, 0.2, 0.5, -0.7 + q[0]),
        (-1.1, 0.1, 0.4 + q[1], 0.9),
    ]:
        T = T @ move(X, alpha, a) @ move(Z, theta, d)
    frames = kinematics.forward(chain_from_dh(rows, [1]), q[None])
    np.testing.assert_allclose(frames.R[0, 1], T[:3, :3], atol=1e-14)
    np.testing.assert_allclose(frames.p[0, 1], T[:3, 3], atol=1e-14)


@pytest.mark.parametrize("angle", [1.5708, 1.570796, -1.5708, 3.14159])
def test_rounded_quarter_turns_become_exact_and_real_misalignment_is_kept(
    angle: float,
) -> None:
    R = kinematics.tidy_rotation(rotation_about(X, angle))
    assert set(np.unique(R)) <= {-1.0, 0.0, 1.0}
    for skewed in (R @ rotation_about(Z, 0.3), rotation_about(X, 1e-4)):
        np.testing.assert_allclose(kinematics.tidy_rotation(skewed), skewed, atol=1e-8)
    tidied = kinematics.tidy_position(np.array([1e-5, 4e-17, -0.2]))
    np.testing.assert_array_equal(tidied, [1e-5, 0.0, -0.2])


def _spin_energy(chain: Chain, q: Array, dq: Array, i: int, ratio: float) -> float:
    """Kinetic energy of rotor i about its axis, above what it has as a dead mass of its
    link.
    """
    carried = 0.0
    if i > 0:
        motion = kinematics.link_motion(
            chain, np.zeros(3), q[:, None], dq[:, None], np.zeros((chain.n, 1))
        )
        carried = float(chain.rotation[i] @ chain.axis[i] @ motion.w[i - 1][:, 0])
    return float(0.5 * ((ratio * dq[i] + carried) ** 2 - carried**2))


def _gradient(
    function: Callable[[Array], Array | float], at: Array, h: float = 1e-4
) -> Array:
    steps = h * np.eye(len(at))
    return np.array([function(at + step) - function(at - step) for step in steps]) / (
        2 * h
    )


def _lagrange(
    chain: Chain, q: Array, dq: Array, ddq: Array, i: int, ratio: float
) -> Array:
    """Compute d/dt dT/d(dq) - dT/dq of the spin energy by central differences."""

    def momentum(time: Array) -> Array:
        at, rate = q + dq * time + 0.5 * ddq * time**2, dq + ddq * time
        return _gradient(lambda x: _spin_energy(chain, at, x, i, ratio), rate)

    (growth,) = _gradient(momentum, np.zeros(1))
    return growth - _gradient(lambda x: _spin_energy(chain, x, dq, i, ratio), q)


@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize("prismatic", [[False] * 5, [False, True, False, False]])
def test_gyroscopic_rotor_is_lagranges(seed: int, prismatic: list[bool]) -> None:
    rng = np.random.default_rng(seed)
    _, chain = random_model(rng, prismatic)
    q, dq, ddq = small.states(rng, 1, chain.n)
    ratio = rng.uniform(-5.0, 5.0, size=chain.n)
    Y = rotor_regressor(chain, q, dq, ddq, ratio, "gyroscopic")[0]
    for i in np.flatnonzero(~chain.prismatic):
        expected = _lagrange(chain, q[0], dq[0], ddq[0], int(i), ratio[i])
        np.testing.assert_allclose(Y[:, i], expected, atol=2e-5)


def test_diagonal_rotor_loads_its_own_joint_only() -> None:
    rng = np.random.default_rng(6)
    _, chain = random_model(rng, [False, False, True, False, False, True, False])
    q, dq, ddq = small.states(rng, 3, chain.n)
    ratio = rng.uniform(-100.0, 100.0, size=chain.n)
    Y = rotor_regressor(chain, q, dq, ddq, ratio, "diagonal")
    np.testing.assert_allclose(Y, [np.diag(ratio**2 * row) for row in ddq])
    coupled = rotor_regressor(chain, q, dq, ddq, ratio, "gyroscopic")
    slides = np.flatnonzero(chain.prismatic)
    np.testing.assert_array_equal(coupled[:, :, slides], Y[:, :, slides])


SKEW = random_model(np.random.default_rng(3), [False, False, True, False])[1]
SCARA = [(0, 0, 0.4, 0), (0, 0.3, 0, 0), (0, 0.25, 0, 0), (0, 0, 0, 0)]
PANDA = np.zeros((7, 4))
PANDA[:, 0] = HALF * np.array([0, -1, 1, 1, -1, 1, 1])
PANDA[[3, 4, 6], 1] = 0.0825, -0.0825, 0.088
PANDA[[0, 2, 4], 2] = 0.333, 0.316, 0.384
ROBOTS = {
    "planar": planar_2r(),
    "arm_6r": arm_6r(gear_ratio=101.0),
    "scara": robot_from_chain(chain_from_dh(SCARA, (2,)), gear_ratio=50.0),
    "skew": robot_from_chain(
        SKEW, gravity=np.array([1.0, 2.0, -9.0]), gear_ratio=-30.0
    ),
    "seven": robot_from_chain(chain_from_dh(PANDA.tolist()), gear_ratio=100.0),
}


@pytest.mark.parametrize("rotors", ["none", "all", "last"])
@pytest.mark.parametrize("name", ROBOTS)
def test_base_parameters_say_all_and_nothing_twice(name: str, rotors: str) -> None:
    robot = ROBOTS[name]
    rotor = {"none": [], "all": range(robot.n), "last": [robot.n - 1]}[rotors]
    rng, basis = np.random.default_rng(11), base_parameters(robot, rotor=tuple(rotor))
    q, dq, ddq = small.states(rng, 200, robot.n)
    phi = rng.normal(size=11 * robot.n)
    phi[10 * robot.n :] *= np.isin(np.arange(robot.n), rotor)
    tau = base.standard_regressor(robot, q, dq, ddq, coupling="diagonal") @ phi
    H = base_regressor(robot, basis, q, dq, ddq)
    np.testing.assert_allclose(
        H @ (basis.expression @ phi), tau, atol=1e-10 * abs(tau).max()
    )
    stacked = H.reshape(-1, basis.size)
    assert (
        np.linalg.matrix_rank(stacked / np.linalg.norm(stacked, axis=0)) == basis.size
    )
    identity = basis.expression @ basis.representative
    np.testing.assert_allclose(identity, np.eye(basis.size), atol=1e-9)


@pytest.mark.parametrize("name", ROBOTS)
def test_gravity_parameters_are_those_of_gravity_alone(name: str) -> None:
    robot, rng = ROBOTS[name], np.random.default_rng(13)
    basis = base_parameters(robot, rotor=range(robot.n))
    g = int(basis.gravity.sum())
    assert basis.gravity.tolist() == [True] * g + [False] * (basis.size - g)
    q, _, _ = small.states(rng, 100, robot.n)
    at_rest = base_regressor(robot, basis, q, np.zeros_like(q), np.zeros_like(q))
    assert abs(at_rest[:, :, g:]).max(initial=0.0) < 1e-10
    Y = regressor.gravity_regressor(robot.chain, robot.gravity, q)
    phi = rng.normal(size=11 * robot.n)
    found = at_rest[:, :, :g] @ (basis.expression[:g] @ phi)
    np.testing.assert_allclose(found, Y @ phi[: 10 * robot.n], atol=1e-10)
    assert g == np.linalg.matrix_rank(Y.reshape(-1, 10 * robot.n), tol=1e-8)
    inertias = [k for k, n in enumerate(base.standard_names(robot.n)) if n[0] == "I"]
    assert not basis.expression[:g, inertias].any()


def test_planar_arm_has_the_papers_five_parameters() -> None:
    basis = base_parameters(planar_2r(), rotor=(0, 1))
    assert not basis.gravity.any()
    assert basis.names == ("Izz_1", "mx_2", "my_2", "Izz_2", "Ia_2")
    # Eq. 44; N_2^2 is a factor of the column here
    assert basis.terms(0) == pytest.approx({"Izz_1": 1.0, "m_2": 0.09, "Ia_1": 36.0})
    assert [basis.expression_text(k) for k in range(1, 5)] == [
        "mx_2",
        "my_2",
        "Izz_2",
        "Ia_2",
    ]
    assert basis.expression_text(0) == "Izz_1 + 0.09*m_2 + 36*Ia_1"
    basis = base_parameters(arm_6r(gear_ratio=101.0), rotor=range(6))
    elbow = basis.expression_text(basis.names.index("mx_3"))
    assert elbow == "mx_3 - 0.3922*m_4 - 0.3922*m_5 - 0.3922*m_6"
