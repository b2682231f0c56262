"""The reduced fit against direct least squares; orders against surfaces that have them."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from seqid_cli.identify.surface_fit import (
    Orders,
    Reduced,
    SpeedData,
    choose_orders,
    fit_surface,
    information,
    left_out_errors,
    left_out_rms,
    reduce_speed,
)
from seqid_cli.model.friction_basis import Scaling

Array = NDArray[np.float64]

SCALING = Scaling((-2.0, 2.0), (0.2, 4.0))
SPEEDS = np.geomspace(0.2, 4.0, 12)


def data_of(
    D: Array, rng: np.random.Generator, *, noise: float = 0.0, slices: int = 40
) -> list[SpeedData]:
    """Both directions at twelve speeds of the surface with coefficients D, weights uneven."""
    result = []
    for speed in SPEEDS:
        for direction in (1, -1):
            q = np.sort(rng.uniform(-2, 2, slices))
            A = SCALING.basis(q, np.full(slices, speed), D.shape[0] - 1, D.shape[1] - 1)
            friction = A @ D.ravel() + noise * rng.standard_normal(slices)
            weight = rng.uniform(5.0, 50.0, slices)
            result.append(SpeedData(float(speed), direction, q, friction, weight))
    return result


def reduced_of(data: list[SpeedData]) -> list[Reduced]:
    return [reduce_speed(item, SCALING) for item in data]


def direct(data: list[SpeedData], m: int, l: int) -> tuple[Array, Array, Array]:
    """Weighted rows and right side of the whole surface at once, and its solution."""
    rows, right = [], []
    for item in data:
        root = np.sqrt(item.weight)
        A = SCALING.basis(item.q, np.full(len(item.q), item.speed), m, l)
        rows.append(A * root[:, None])
        right.append(item.friction * root)
    A, y = np.vstack(rows), np.concatenate(right)
    D: Array = np.asarray(np.linalg.lstsq(A, y, rcond=None)[0], dtype=np.float64)
    return A, y, D.reshape(m + 1, l + 1)


COEFFICIENTS = np.array([[5.0, 0.8, -0.4], [0.5, 0.1, 0.0], [-0.7, 0.0, 0.2], [0.3, 0.2, 0.1]])


@pytest.mark.parametrize(("m", "l"), [(0, 0), (3, 2), (1, 5), (10, 4)])
def test_both_steps_together_are_the_direct_least_squares(m: int, l: int) -> None:
    data = data_of(COEFFICIENTS, np.random.default_rng(0), noise=0.2)
    reduced = reduced_of(data)
    A, _, D = direct(data, m, l)
    np.testing.assert_allclose(fit_surface(reduced, m, l), D, atol=1e-8)
    np.testing.assert_allclose(information(reduced, m, l), A.T @ A, rtol=1e-8, atol=1e-6)


def test_the_papers_orders_can_be_fitted() -> None:
    """Orders (10, 11) through twelve speeds reproduce the data."""
    rng = np.random.default_rng(1)
    data = data_of(COEFFICIENTS, rng)
    reduced = reduced_of(data)
    D = fit_surface(reduced, 10, 11)
    power = sum(float(item.z @ item.z) for item in reduced)
    assert sum(item.misfit(D) for item in reduced) < 1e-12 * power
    assert np.abs(D).max() < 10.0


def test_the_misfit_is_the_weighted_sum_of_squares() -> None:
    data = data_of(COEFFICIENTS, np.random.default_rng(2), noise=0.2)
    reduced = reduced_of(data)
    D = COEFFICIENTS[:2, :2]
    A, y, _ = direct(data, 1, 1)
    total = sum(item.misfit(D) for item in reduced)
    assert total == pytest.approx(float(np.sum((A @ D.ravel() - y) ** 2)), rel=1e-10)


@pytest.mark.parametrize("slices", [1, 5, 11])
def test_few_slices_are_still_exact(slices: int) -> None:
    data = data_of(COEFFICIENTS, np.random.default_rng(3), noise=0.1, slices=slices)
    A, y, D = direct(data, 0, 2)
    reduced = reduced_of(data)
    np.testing.assert_allclose(fit_surface(reduced, 0, 2), D, atol=1e-8)
    total = sum(item.misfit(D) for item in reduced)
    assert total == pytest.approx(float(np.sum((A @ D.ravel() - y) ** 2)), rel=1e-8)


def test_leaving_a_speed_out_is_a_refit_without_its_data() -> None:
    data = data_of(COEFFICIENTS, np.random.default_rng(4), noise=0.3)
    squares, weight = 0.0, 0.0
    for speed in SPEEDS[1:-1]:
        kept = [item for item in data if item.speed != speed]
        D = direct(kept, 3, 2)[2]
        for item in data:
            if item.speed == speed:
                A = SCALING.basis(item.q, np.full(len(item.q), item.speed), 3, 2)
                off = A @ D.ravel() - item.friction
                squares += float(item.weight @ off**2)
                weight += float(item.weight.sum())
    got = left_out_rms(reduced_of(data), Orders(3, 2))
    assert got == pytest.approx(np.sqrt(squares / weight), rel=1e-8)


@pytest.mark.parametrize("smoothing", [1e-6, 1e-3])
def test_smoothing_is_a_ridge_that_grows_with_the_order(smoothing: float) -> None:
    data = data_of(COEFFICIENTS, np.random.default_rng(10), noise=0.2)
    A, y, _ = direct(data, 5, 4)
    total = sum(float(item.weight.sum()) for item in data)
    j, r = np.arange(6.0)[:, None], np.arange(5.0)[None, :]
    ridge = total * smoothing * ((j**2 + r**2) ** 2).ravel()
    expected = np.linalg.solve(A.T @ A + np.diag(ridge), A.T @ y).reshape(6, 5)
    got = fit_surface(reduced_of(data), 5, 4, smoothing)
    np.testing.assert_allclose(got, expected, atol=1e-8)


def test_leaving_out_under_smoothing_is_a_refit_too() -> None:
    data = data_of(COEFFICIENTS, np.random.default_rng(11), noise=0.3)
    reduced = reduced_of(data)
    smoothing = 1e-5
    squares, weight = 0.0, 0.0
    total = sum(item.total for item in reduced)
    for u in sorted({item.u for item in reduced})[1:-1]:
        kept = [item for item in reduced if item.u != u]
        share = total / sum(item.total for item in kept)  # the penalty stays as strong
        D = fit_surface(kept, 6, 5, smoothing * share)
        squares += sum(item.misfit(D) for item in reduced if item.u == u)
        weight += sum(item.total for item in reduced if item.u == u)
    got = left_out_rms(reduced, Orders(6, 5, smoothing))
    assert got == pytest.approx(np.sqrt(squares / weight), rel=1e-6)


def known_surface(m: int, l: int) -> Array:
    """Coefficients that need the orders (m, l), no less."""
    D = np.zeros((m + 1, l + 1))
    D[0, 0], D[0, 1:], D[1:, 0] = 5.0, 0.8, 0.5
    D[m, l] = D[m, l] if (m, l) == (0, 0) else 0.5
    return D


@pytest.mark.parametrize(("m", "l"), [(0, 1), (2, 1), (3, 2), (5, 3)])
def test_orders_of_a_known_surface_are_found(m: int, l: int) -> None:
    """Raised until the noise is reached: never too low, at most one too high."""
    for seed in range(5):
        data = data_of(known_surface(m, l), np.random.default_rng(seed), noise=0.05)
        got = choose_orders(
            reduced_of(data),
            position=None,
            velocity=None,
            accept=lambda orders: orders.held_out_rmse < 0.06,
        )
        assert m <= got.position <= m + 1
        assert l <= got.velocity <= l + 1


@pytest.mark.parametrize(("m", "l"), [(0, 1), (3, 2), (5, 3)])
def test_what_is_chosen_is_as_good_as_the_true_orders(m: int, l: int) -> None:
    """On the noiseless surface the error is a small share of the noise of one slice."""
    D, noise = known_surface(m, l), 0.2
    errors, best = [], []
    q, v = (g.ravel() for g in np.meshgrid(np.linspace(-1.9, 1.9, 30), np.linspace(0.3, 3.8, 30)))
    true = SCALING.basis(q, v, m, l) @ D.ravel()
    for seed in range(3):
        reduced = reduced_of(data_of(D, np.random.default_rng(seed), noise=noise))
        got = choose_orders(reduced, position=None, velocity=None, accept=None)
        fit = fit_surface(reduced, got.position, got.velocity, got.smoothing)
        off = SCALING.basis(q, v, got.position, got.velocity) @ fit.ravel() - true
        errors.append(np.sqrt(np.mean(off**2)))
        ideal = SCALING.basis(q, v, m, l) @ fit_surface(reduced, m, l).ravel() - true
        best.append(np.sqrt(np.mean(ideal**2)))
        assert got.held_out_rmse < 1.15 * noise
    assert np.mean(errors) < 0.4 * noise
    assert np.mean(errors) < 5 * np.mean(best)


def test_orders_that_the_user_fixes_are_kept() -> None:
    reduced = reduced_of(data_of(COEFFICIENTS, np.random.default_rng(5), noise=0.1))
    fixed = choose_orders(reduced, position=10, velocity=11, accept=None)
    assert (fixed.position, fixed.velocity) == (10, 11)
    half = choose_orders(reduced, position=1, velocity=None, accept=None)
    assert half.position == 1
    assert half.velocity >= 1
    low = choose_orders(reduced, position=0, velocity=0, accept=lambda orders: True)
    assert (low.position, low.velocity) == (0, 0)


def test_raising_stops_where_the_criterion_holds() -> None:
    reduced = reduced_of(data_of(COEFFICIENTS, np.random.default_rng(6), noise=0.01))
    early = choose_orders(
        reduced, position=None, velocity=None, accept=lambda o: o.position + o.velocity >= 2
    )
    assert 2 <= early.position + early.velocity <= 5


def test_eq_11_holds_for_the_right_orders_and_fails_for_too_low_ones() -> None:
    data = data_of(COEFFICIENTS, np.random.default_rng(7), noise=0.02)
    reduced = reduced_of(data)
    good, poor = (left_out_errors(data, reduced, Orders(m, l)) for m, l in ((3, 2), (0, 0)))
    assert good.meets(0.01)
    assert not poor.meets(0.1)
    assert poor.relative > 0.1
    assert good.rmse < 0.02
    assert poor.absolute > 0.5


def test_near_zero_the_criterion_is_absolute() -> None:
    """A friction that crosses zero does not make the relative error boundless."""
    D = np.array([[0.0, 0.0], [3.0, 0.0]])
    data = data_of(D, np.random.default_rng(8), noise=0.02)
    errors = left_out_errors(data, reduced_of(data), Orders(1, 1))
    assert errors.relative < 0.05
    assert errors.crossing < 0.02


def test_with_three_speeds_nothing_is_left_out() -> None:
    data = [
        item
        for item in data_of(COEFFICIENTS, np.random.default_rng(9), noise=0.1)
        if item.speed in SPEEDS[[0, 5, 11]]
    ]
    A, y, D = direct(data, 1, 1)
    weight = sum(float(item.weight.sum()) for item in data)
    expected = np.sqrt(np.sum((A @ D.ravel() - y) ** 2) / weight)
    assert left_out_rms(reduced_of(data), Orders(1, 1)) == pytest.approx(expected, rel=1e-8)
