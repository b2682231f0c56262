"""The friction surface against its formula, its gradient, and its edges."""

from dataclasses import replace

import numpy as np
import pytest
from numpy.polynomial.chebyshev import chebval2d, chebvander

from seqid_cli.model.friction import FrictionSurface
from seqid_cli.model.friction_basis import Scaling, tensor
from tests import Array
from tests.plants.robots.made import friction_joint

POSITION, SPEED, WIDTH = (-1.5, 2.5), (0.1, 4.0), 0.01


def surface(
    *, directional: bool = False, logarithmic: bool = False, orders: tuple[int, int] = (3, 2)
) -> FrictionSurface:
    """A surface with random coefficients, Coulomb friction above all."""
    rng = np.random.default_rng(0)
    shape = (orders[0] + 1, orders[1] + 1)
    positive, negative = 0.2 * rng.standard_normal((2, *shape))
    positive[0, 0], negative[0, 0] = 5.0, 4.0
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
    """Both kinds on both scales."""
    return surface(directional=request.param[0], logarithmic=request.param[1])


def states(count: int = 60) -> tuple[Array, Array]:
    rng = np.random.default_rng(1)
    q = rng.uniform(*POSITION, count)
    v = rng.uniform(*SPEED, count) * rng.choice([-1, 1], count)
    return q, v


def formula(own: FrictionSurface, q: Array, v: Array) -> Array:
    """Eq. 7 and 10 on Chebyshev polynomials, written with numpy's own evaluation."""
    low, high = own.scaling.position
    x = (2 * q - low - high) / (high - low)
    slow, fast = own.scaling.speed
    speed = np.abs(v)
    if own.scaling.logarithmic:
        slow, fast, speed = np.log(slow), np.log(fast), np.log(speed)
    u = (2 * speed - slow - fast) / (fast - slow)
    ahead, back = chebval2d(x, u, own.positive), chebval2d(x, u, own.negative)
    return np.where(v > 0, ahead, -back)


def test_the_torque_is_the_formula_inside_the_range(any_surface: FrictionSurface) -> None:
    q, v = states()
    np.testing.assert_allclose(
        any_surface.torque(q, v), formula(any_surface, q, v), rtol=1e-7, atol=1e-7
    )


def line_of(own: FrictionSurface, side: int) -> tuple[float, float]:
    """Mean friction over position at the fastest speed, and its slope over the faster half."""
    q = np.linspace(*POSITION, 4001)
    speeds = np.linspace(0.5 * SPEED[1], SPEED[1], 33)
    level = [float(np.trapezoid(formula(own, q, np.full(4001, side * v)), q)) for v in speeds]
    mean = side * np.array(level) / (POSITION[1] - POSITION[0])
    return float(mean[-1]), float(np.polyfit(speeds, mean, 1)[0])


@pytest.mark.parametrize("side", [1, -1])
def test_beyond_the_fastest_speed_it_goes_on_as_a_line(
    any_surface: FrictionSurface, side: int
) -> None:
    q = np.linspace(*POSITION, 30)
    slope = max(line_of(any_surface, side)[1], 0.0)
    fast = SPEED[1]
    at = any_surface.torque(q, np.full(30, side * fast))
    for speed in (fast + 1e-9, 1.3 * fast, 3.0 * fast):
        got = any_surface.torque(q, np.full(30, side * speed))
        np.testing.assert_allclose(got, at + side * slope * (speed - fast), atol=1e-5)


def test_the_slope_beyond_the_fastest_speed_is_never_negative() -> None:
    """Friction that falls over the speeds seen stays where it is, with a doubt about that."""
    rising, falling = (replace(surface(), positive=np.array([[5.0, k]])) for k in (0.4, -0.4))
    flat = [replace(s, entry_covariance=0.01 * np.eye(2)) for s in (rising, falling)]
    q, v = np.zeros(2), np.array([SPEED[1], 2.0 * SPEED[1]])
    up, down = (own.torque(q, v) for own in flat)
    assert up[1] - up[0] == pytest.approx(0.8 / (SPEED[1] - SPEED[0]) * SPEED[1], rel=1e-3)
    assert down[1] == pytest.approx(down[0])
    for own in flat:
        errors = own.std_error(np.zeros(3), np.array([4.0, 6.0, 8.0]))
        assert (np.diff(errors) > 0.03).all()


def test_the_error_grows_outside(any_surface: FrictionSurface) -> None:
    """Inside the covariance is the file's; outside what is not known comes on top."""
    count = any_surface.entries
    sure = replace(any_surface, entry_covariance=1e-8 * np.eye(count))
    low, high = POSITION
    pace = np.full(3, 1.0)
    for q in (low - np.array([0.0, 0.3, 2.0]), high + np.array([0.0, 0.3, 2.0])):
        errors = sure.std_error(q, pace)
        assert errors[0] < 1e-2 < errors[1] < errors[2]
    along = np.linspace(low, high, 400)
    swing = [np.std(sure.torque(along, np.full(400, v))) for v in (0.3, 1.0, 3.0)]
    far = float(sure.std_error(np.array([high + 5.0]), np.ones(1))[0])
    assert 0.3 * min(swing) < far < 3.0 * max(swing)
    for v in (np.array([4.0, 5.0, 8.0]), np.array([0.1, 0.08, 0.06])):
        errors = sure.std_error(np.zeros(3), v)
        assert errors[0] < 1e-2
        assert (np.diff(errors) > 0.0).all()


def test_outside_is_said(any_surface: FrictionSurface) -> None:
    q, v = states()
    assert not any_surface.outside(q, v).any()
    middle, pace = np.zeros(1), np.ones(1)
    assert any_surface.outside(np.array([3.0]), pace).all()
    assert any_surface.outside(np.array([-2.0]), pace).all()
    assert any_surface.outside(middle, np.array([-5.0])).all()
    assert any_surface.outside(middle, np.array([0.05])).all()
    assert not any_surface.outside(middle, np.array([0.0])).any()


def test_columns_are_the_gradient(any_surface: FrictionSurface) -> None:
    """Differences in every entry that the covariance is of: the torque is linear in them."""
    q, v = states(25)
    q[:10], v[:10] = 3.0 * q[:10], 1.0 + np.abs(3.0 * v[:10])  # outside as well
    columns, shape = any_surface.columns(q, v), any_surface.positive.shape
    sides = (any_surface.positive, any_surface.negative)[: 1 + any_surface.directional]
    for k, unit in enumerate(1e-4 * np.eye(any_surface.entries)):
        positive, *other = (
            side + step for side, step in zip(sides, unit.reshape(-1, *shape), strict=True)
        )
        moved = replace(any_surface, positive=positive, negative=[positive, *other][-1])
        slope = (moved.torque(q, v) - any_surface.torque(q, v)) / 1e-4
        np.testing.assert_allclose(columns[:, k], slope, atol=1e-8)


def test_slow_motion_has_the_friction_of_the_slowest_speed(any_surface: FrictionSurface) -> None:
    """It holds below that speed, bounds friction at rest, and does not jump where a joint turns."""
    q = np.linspace(*POSITION, 20)
    v = np.full(20, any_surface.scaling.speed[0])
    np.testing.assert_allclose(any_surface.torque(q, 0.7 * v), any_surface.torque(q, v), rtol=1e-5)
    low, high = any_surface.at_rest(q)
    np.testing.assert_allclose(high, formula(any_surface, q, v), rtol=1e-4)
    np.testing.assert_allclose(low, formula(any_surface, q, -v), rtol=1e-4)
    assert (low < high).all()
    rest = any_surface.torque(q, 0.0 * v)
    for tiny in (1e-8 * v, -1e-8 * v):
        np.testing.assert_allclose(any_surface.torque(q, tiny), rest, atol=1e-5)


@pytest.mark.parametrize("logarithmic", [False, True])
def test_the_papers_orders_are_well_conditioned(logarithmic: bool) -> None:
    """Orders (10, 11) from twelve speeds, where raw monomials are hopeless."""
    scaling = Scaling((-2.6, 2.6), (0.4, 8.0), logarithmic)
    # Chebyshev's points in the speed show the basis itself; evenly spaced ones would show Runge's.
    points = np.cos((np.arange(12) + 0.5) * np.pi / 12)
    ends = np.log(scaling.speed) if logarithmic else np.array(scaling.speed)
    pace = (ends[0] + ends[1] + points * (ends[1] - ends[0])) / 2
    speeds = np.exp(pace) if logarithmic else pace
    q, v = (g.ravel() for g in np.meshgrid(np.linspace(-2.6, 2.6, 64), speeds))
    A = scaling.basis(q, v, 10, 11)
    assert np.linalg.cond(A) < 30
    raw = (q[:, None, None] ** np.arange(11)[:, None] * v[:, None, None] ** np.arange(12)).reshape(
        len(q), -1
    )
    assert np.linalg.cond(raw) > 1e12


@pytest.mark.parametrize("directional", [False, True])
def test_a_corner_that_no_trial_has_been_in_is_vague(directional: bool) -> None:
    """Slow passes near the middle only: what the surface says of slow motion far out is its own."""
    own = surface(directional=directional)
    rng = np.random.default_rng(2)
    u = rng.uniform(-1.0, 1.0, 4000)
    x = rng.uniform(-1.0, 1.0, 4000) * np.where(u < 0.0, 0.3, 1.0)
    basis = tensor(chebvander(x, 3), chebvander(u, 2))
    block = np.linalg.inv(basis.T @ basis)
    covariance = np.kron(np.eye(2 if directional else 1), block)
    own = replace(own, entry_covariance=covariance)
    middle, half = 0.5 * sum(POSITION), 0.5 * (POSITION[1] - POSITION[0])
    slow, fast = np.array([0.2, -0.2]), np.array([3.8, -3.8])
    assert own.vague(np.full(2, middle + 0.98 * half), slow).all()
    assert not own.vague(np.full(2, middle + 0.98 * half), fast).any()
    assert not own.vague(np.full(2, middle), slow).any()
    assert not own.vague(np.array([middle + 0.98 * half]), np.array([0.5 * WIDTH])).any()


def test_coulomb_and_viscous_friction_of_a_file_goes_on_beyond_the_fastest_speed() -> None:
    """As it is; that it was not seen there is said all the same."""
    coulomb, half = 2.0, 0.5 * 0.7 * 1.5
    joint = friction_joint(
        [[coulomb + half, half]],
        position_range=list(POSITION),
        speed_range=[0.0, 1.5],
        sign_width=WIDTH,
        covariance=[[1e-4, 0.0], [0.0, 1e-4]],
    )
    own = FrictionSurface.from_stage(joint)
    v = np.array([0.3, -1.2, 1.5, 3.0, -4.0])
    q = np.zeros(len(v))
    np.testing.assert_allclose(own.torque(q, v), coulomb * np.sign(v) + 0.7 * v, rtol=1e-9)
    assert own.outside(q, v).tolist() == [False, False, False, True, True]
    assert not own.vague(q, v).any()
