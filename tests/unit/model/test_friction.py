"""The friction surface against its formula, its gradient, and its edges."""

from dataclasses import replace

import numpy as np
import pytest
from numpy.polynomial.chebyshev import chebpts1, chebval2d, chebvander

from seqid_cli.model.friction import FrictionSurface
from seqid_cli.model.friction_basis import Scaling, tensor
from tests import Array
from tests.plants.robots.made import friction_joint

POSITION = (-1.5, 2.5)
SPEED = (0.1, 4.0)
WIDTH = 0.01


def surface(*, directional: bool = False, logarithmic: bool = False) -> FrictionSurface:
    """A surface with random coefficients, Coulomb friction above all."""
    rng = np.random.default_rng(0)
    positive, negative = 0.2 * rng.standard_normal((2, 4, 3))
    positive[0, 0] = 5.0
    negative[0, 0] = 4.0
    size = positive.size * (2 if directional else 1)
    A = rng.standard_normal((size, size))
    return FrictionSurface(
        scaling=Scaling(POSITION, SPEED, logarithmic),
        sign_width=WIDTH,
        positive=positive,
        negative=negative if directional else positive,
        entry_covariance=A @ A.T,
        directional=directional,
    )


@pytest.fixture(params=[(False, False), (True, False), (False, True), (True, True)])
def any_surface(request: pytest.FixtureRequest) -> FrictionSurface:
    return surface(directional=request.param[0], logarithmic=request.param[1])


def states(count: int = 60) -> tuple[Array, Array]:
    rng = np.random.default_rng(1)
    q = rng.uniform(*POSITION, count)
    v = rng.uniform(*SPEED, count) * rng.choice([-1, 1], count)
    return q, v


def formula(of_surface: FrictionSurface, q: Array, v: Array) -> Array:
    """Eq. 7 and 10 on Chebyshev polynomials, written with numpy's own evaluation."""
    low, high = of_surface.scaling.position
    x = (2 * q - low - high) / (high - low)
    slow, fast = of_surface.scaling.speed
    speed = np.abs(v)
    if of_surface.scaling.logarithmic:
        slow = np.log(slow)
        fast = np.log(fast)
        speed = np.log(speed)
    u = (2 * speed - slow - fast) / (fast - slow)
    ahead = chebval2d(x, u, of_surface.positive)
    back = chebval2d(x, u, of_surface.negative)
    return np.where(v > 0, ahead, -back)


def test_the_torque_is_the_formula_inside_the_range(
    any_surface: FrictionSurface,
) -> None:
    q, v = states()
    torque = any_surface.torque(q, v)
    expected = formula(any_surface, q, v)
    np.testing.assert_allclose(torque, expected, rtol=1e-7, atol=1e-7)
    assert not any_surface.outside(q, v).any()


def test_torque_needs_no_product_of_both_bases(
    any_surface: FrictionSurface, monkeypatch: pytest.MonkeyPatch
) -> None:
    """It is that of the columns, also beyond the fastest speed."""
    q, v = states()
    v[::3] *= 2.0
    columns = any_surface.columns(q, v)
    expected = columns @ any_surface.coefficients

    def refused(*_: object) -> None:
        raise AssertionError

    monkeypatch.setattr(Scaling, "basis", refused)
    np.testing.assert_allclose(any_surface.torque(q, v), expected, rtol=1e-12)


@pytest.mark.parametrize("side", [1, -1])
def test_beyond_the_fastest_speed_it_goes_on_as_a_line(
    any_surface: FrictionSurface, side: int
) -> None:
    """With the slope that friction, meant over position, has over the faster half of
    the speeds.
    """
    q = np.linspace(*POSITION, 4001)
    fast = SPEED[1]
    speeds = np.linspace(0.5 * fast, fast, 33)
    levels = [
        np.trapezoid(formula(any_surface, q, np.full(4001, side * v)), q)
        for v in speeds
    ]
    fitted_slope = np.polyfit(speeds, side * np.array(levels), 1)[0]
    slope = max(fitted_slope / np.ptp(POSITION), 0.0)

    at = any_surface.torque(q, np.full(4001, side * fast))
    for speed in (fast + 1e-9, 1.3 * fast, 3.0 * fast):
        got = any_surface.torque(q, np.full(4001, side * speed))
        np.testing.assert_allclose(got, at + side * slope * (speed - fast), atol=1e-5)


def test_friction_that_falls_stays_where_it_is_beyond_the_fastest_speed() -> None:
    """With a doubt about that."""
    falling = replace(
        surface(), positive=np.array([[5.0, -0.4]]), entry_covariance=0.01 * np.eye(2)
    )
    at, beyond = falling.torque(np.zeros(2), np.array([SPEED[1], 2.0 * SPEED[1]]))
    assert beyond == pytest.approx(at)
    errors = falling.std_error(np.zeros(3), np.array([4.0, 6.0, 8.0]))
    assert (np.diff(errors) > 0.03).all()


def test_outside_is_said_and_the_error_grows_there(
    any_surface: FrictionSurface,
) -> None:
    """Inside the covariance is the file's; outside what is not known comes on top."""
    sure = replace(any_surface, entry_covariance=1e-8 * np.eye(any_surface.entries))
    low, high = POSITION
    beyond = np.array([0.0, 0.3, 2.0])
    pace = np.full(3, 1.0)
    for q in (low - beyond, high + beyond):
        errors = sure.std_error(q, pace)
        assert errors[0] < 1e-2 < errors[1] < errors[2]
        assert sure.outside(q, pace).tolist() == [False, True, True]

    # Far out the error is the spread of friction over position.
    along = np.linspace(low, high, 400)
    swing = [np.std(sure.torque(along, np.full(400, v))) for v in (0.3, 1.0, 3.0)]
    far = float(sure.std_error(np.array([high + 5.0]), np.ones(1))[0])
    assert 0.3 * min(swing) < far < 3.0 * max(swing)

    # Speeds beyond either end.
    for v in (np.array([4.0, 5.0, 8.0]), np.array([0.1, 0.08, 0.06])):
        errors = sure.std_error(np.zeros(3), v)
        assert errors[0] < 1e-2
        assert (np.diff(errors) > 0.0).all()
    ways = np.array([-5.0, -0.05, 0.0, 0.05, 5.0])
    assert sure.outside(np.zeros(5), ways).tolist() == [True, True, False, True, True]


def test_columns_are_the_gradient(any_surface: FrictionSurface) -> None:
    """Differences in every entry that the covariance is of: the torque is linear in
    them.
    """
    q, v = states(25)
    # outside as well
    q[:10] = 3.0 * q[:10]
    v[:10] = 1.0 + np.abs(3.0 * v[:10])
    columns = any_surface.columns(q, v)
    shape = any_surface.positive.shape
    sides = (any_surface.positive, any_surface.negative)[: 1 + any_surface.directional]
    for k, unit in enumerate(1e-4 * np.eye(any_surface.entries)):
        positive, *other = (
            side + step
            for side, step in zip(sides, unit.reshape(-1, *shape), strict=True)
        )
        moved = replace(any_surface, positive=positive, negative=[positive, *other][-1])
        slope = (moved.torque(q, v) - any_surface.torque(q, v)) / 1e-4
        np.testing.assert_allclose(columns[:, k], slope, atol=1e-8)


def test_slow_motion_has_the_friction_of_the_slowest_speed(
    any_surface: FrictionSurface,
) -> None:
    """It holds below that speed, bounds friction at rest, and does not jump where a
    joint turns.
    """
    q = np.linspace(*POSITION, 20)
    v = np.full(20, any_surface.scaling.speed[0])
    np.testing.assert_allclose(
        any_surface.torque(q, 0.7 * v), any_surface.torque(q, v), rtol=1e-5
    )
    low, high = any_surface.at_rest(q)
    np.testing.assert_allclose(high, formula(any_surface, q, v), rtol=1e-4)
    np.testing.assert_allclose(low, formula(any_surface, q, -v), rtol=1e-4)
    assert (low < high).all()
    rest = any_surface.torque(q, 0.0 * v)
    for tiny in (1e-8 * v, -1e-8 * v):
        np.testing.assert_allclose(any_surface.torque(q, tiny), rest, atol=1e-5)


@pytest.mark.parametrize("logarithmic", [False, True])
def test_the_papers_orders_are_well_conditioned(logarithmic: bool) -> None:
    """Orders (10, 11) from twelve speeds, at Chebyshev's points."""
    scaling = Scaling((-2.6, 2.6), (0.4, 8.0), logarithmic)
    slow, fast = np.log(scaling.speed) if logarithmic else scaling.speed
    pace = (slow + fast + chebpts1(12) * (fast - slow)) / 2
    speeds = np.exp(pace) if logarithmic else pace
    q, v = (g.ravel() for g in np.meshgrid(np.linspace(-2.6, 2.6, 64), speeds))
    assert np.linalg.cond(scaling.basis(q, v, 10, 11)) < 30


@pytest.mark.parametrize("directional", [False, True])
def test_a_corner_that_no_trial_has_been_in_is_vague(directional: bool) -> None:
    """Slow passes near the middle only: what the surface says of slow motion far out is
    its own.
    """
    rng = np.random.default_rng(2)
    u = rng.uniform(-1.0, 1.0, 4000)
    x = rng.uniform(-1.0, 1.0, 4000) * np.where(u < 0.0, 0.3, 1.0)
    basis = tensor(chebvander(x, 3), chebvander(u, 2))
    block = np.linalg.inv(basis.T @ basis)
    covariance = np.kron(np.eye(2 if directional else 1), block)
    cornered = replace(surface(directional=directional), entry_covariance=covariance)
    middle = 0.5 * sum(POSITION)
    end = POSITION[1] - 0.04
    slow = np.array([0.2, -0.2])
    fast = np.array([3.8, -3.8])
    turning = np.full(2, 0.5 * WIDTH)
    assert cornered.vague(np.full(2, end), slow).all()
    for q, v in ((end, fast), (middle, slow), (end, turning)):
        assert not cornered.vague(np.full(2, q), v).any()


def test_coulomb_and_viscous_friction_of_a_file_goes_on_beyond_the_fastest_speed() -> (
    None
):
    """As it is; that it was not seen there is said all the same."""
    coulomb = 2.0
    half = 0.5 * 0.7 * 1.5
    joint = friction_joint(
        [[coulomb + half, half]],
        position_range=list(POSITION),
        speed_range=[0.0, 1.5],
        sign_width=WIDTH,
        covariance=[[1e-4, 0.0], [0.0, 1e-4]],
    )
    of_file = FrictionSurface.from_stage(joint)
    v = np.array([0.3, -1.2, 1.5, 3.0, -4.0])
    q = np.zeros(len(v))
    np.testing.assert_allclose(
        of_file.torque(q, v), coulomb * np.sign(v) + 0.7 * v, rtol=1e-9
    )
    assert of_file.outside(q, v).tolist() == [False, False, False, True, True]
    assert not of_file.vague(q, v).any()


@pytest.mark.parametrize("covariance", [[], [[1.0]]])
@pytest.mark.parametrize("directional", [False, True])
def test_a_file_without_errors_of_its_surface_is_taken_as_exact(
    covariance: list[list[float]], directional: bool
) -> None:
    joint = friction_joint(
        [[5.0, 0.4], [0.2, 0.1]],
        speed_range=list(SPEED),
        sign_width=WIDTH,
        covariance=covariance,
        directional=directional,
    )
    made = FrictionSurface.from_stage(joint)
    size = len(made.coefficients)
    np.testing.assert_array_equal(
        made.covariance[: made.entries, : made.entries], np.zeros((made.entries,) * 2)
    )
    assert made.covariance.shape == (size, size)
