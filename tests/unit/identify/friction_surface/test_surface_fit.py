"""The reduced fit against direct generalised least squares; orders and errors against truth."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from numpy.typing import NDArray

from seqid_cli.identify.friction_surface.fit import (
    DEVIATION,
    SurfaceFit,
    choose_orders,
    fit_surfaces,
    highest_orders,
)
from seqid_cli.identify.friction_surface.prior import NAMES, Evidence, Normal, Sizes
from seqid_cli.identify.friction_surface.reduction import (
    MAX_POSITION_ORDER,
    Orders,
    SpeedData,
    around_medians,
    edges_of,
    reduce_trials,
    weighted,
)
from seqid_cli.identify.friction_surface.summary import errors_of
from seqid_cli.model.friction_basis import Scaling

Array = NDArray[np.float64]

SCALING = Scaling((-2.0, 2.0), (0.2, 4.0))
SPEEDS = np.geomspace(0.2, 4.0, 12)
SLICES = 40
COEFFICIENTS = np.array([[5.0, 0.8, -0.4], [0.5, 0.1, 0.0], [-0.7, 0.0, 0.2], [0.3, 0.2, 0.1]])
TRUE = Sizes(
    position=0.5,
    speed=0.5,
    both=0.2,
    trial=0.1,
    slow=0.1,
    unsteady=0.2,
    edge=0.1,
    noise=0.3,
    over_position=3.0,
    over_speed=3.0,
    broad=15.0,
)

WHITE = replace(TRUE, trial=0.0, slow=0.0, unsteady=0.0, edge=0.0)


def data_of(
    D: Array,
    rng: np.random.Generator,
    *,
    sizes: Sizes = WHITE,
    scaling: Scaling = SCALING,
    doubt: float = 0.0,
) -> list[SpeedData]:
    """Both directions at twelve speeds of the surface with entries D, and errors of given sizes.

    The inertia's standard error makes a torque of `doubt` N m times the speed.
    """
    result = []
    for speed in SPEEDS:
        for direction in (1, -1):
            q = np.sort(rng.uniform(*scaling.position, SLICES))
            order = scaling.over_position.order(len(D))
            A = scaling.basis(q, np.full(SLICES, speed), order, D.shape[1] - 1)
            weight = rng.uniform(5.0, 50.0, SLICES)
            edges = edges_of(0.02 * np.arange(SLICES), 0.02)
            push = doubt * speed * np.linspace(1.0, -0.5, SLICES)
            own = np.hstack([scaling.over_position.values(q, MAX_POSITION_ORDER), edges])
            size = own.shape[1] - edges.shape[1]
            spread = np.sqrt(sizes.own(scaling, size, np.array([speed])).sum(axis=0)[0])
            spread = spread[: own.shape[1]]
            error = own @ (spread * rng.standard_normal(own.shape[1]))
            error += sizes.noise / np.sqrt(weight) * rng.standard_normal(SLICES)
            friction = A @ D.ravel() + error
            own = q, friction, weight, edges, push, doubt * np.cos(q)
            result.append(SpeedData(float(speed), direction, *own))
    return result


def fit_of(data: list[SpeedData], sizes: Sizes = TRUE) -> SurfaceFit:
    reduced = reduce_trials(data, SCALING)
    return SurfaceFit(reduced, sizes, highest_orders([reduced], None, None))


def direct(data: list[SpeedData], sizes: Sizes, orders: Orders) -> tuple[Array, Array]:
    """Entries and covariance by one dense system over all slices, with their whole covariance."""
    columns, y, blocks = [], [], []
    for item in data:
        speed = np.full(len(item.q), item.speed)
        columns.append(SCALING.basis(item.q, speed, orders.position, orders.velocity))
        y.append(item.friction)
        values = SCALING.over_position.values(item.q, MAX_POSITION_ORDER)
        own = np.column_stack([values, item.edges, item.push, item.doubt])
        variance = sizes.own(SCALING, MAX_POSITION_ORDER + 1, np.array([item.speed])).sum(axis=0)
        shared = own * np.sqrt(variance)
        blocks.append(shared @ shared.T + np.diag(sizes.noise**2 / item.weight))
    A = np.vstack(columns)
    V = np.zeros((len(A), len(A)))
    start = 0
    for block in blocks:
        V[start : start + len(block), start : start + len(block)] = block
        start += len(block)
    for name in ("push", "doubt"):  # each one and the same error in all trials
        error = np.concatenate([getattr(item, name) for item in data])
        V += np.outer(error, error)
    prior = sizes.prior(SCALING, orders.position + 1, orders)[: orders.position + 1].ravel()
    weighing = np.linalg.solve(V, A)
    covariance = np.linalg.inv(A.T @ weighing + np.diag(prior**-2.0))
    return covariance @ (weighing.T @ np.concatenate(y)), covariance


@pytest.mark.parametrize(("m", "l"), [(MAX_POSITION_ORDER, 11), (0, 0), (3, 2), (1, 5)])
def test_both_steps_together_are_the_generalised_least_squares(m: int, l: int) -> None:
    data = data_of(COEFFICIENTS, np.random.default_rng(0), sizes=TRUE, doubt=0.05)
    fit, orders = fit_of(data), Orders(m, l)
    entries, covariance = direct(data, TRUE, orders)
    np.testing.assert_allclose(fit.entries(orders).ravel(), entries, atol=1e-8)
    if m == MAX_POSITION_ORDER:  # that of fewer orders allows for what they leave out
        np.testing.assert_allclose(fit.covariance(orders), covariance, atol=1e-9)


def drawn(sizes: Sizes, rng: np.random.Generator) -> Array:
    """A surface of the highest orders, drawn from the prior; Coulomb friction of 5."""
    prior = sizes.prior(SCALING, MAX_POSITION_ORDER + 1, Orders(MAX_POSITION_ORDER, 11))
    D: Array = prior[: MAX_POSITION_ORDER + 1] * rng.standard_normal((MAX_POSITION_ORDER + 1, 12))
    D[0, :2] = 5.0, 0.5
    return D


@pytest.mark.slow
def test_the_sizes_of_terms_and_errors_are_found() -> None:
    """Those with which data were drawn, to a third, in the geometric mean of eight sets."""
    rng = np.random.default_rng(7)
    logs = []
    for _ in range(8):
        reduced = reduce_trials(data_of(drawn(TRUE, rng), rng, sizes=TRUE), SCALING)
        sizes, _ = Evidence([reduced], highest_orders([reduced], None, None)).strongest()
        logs.append([np.log(getattr(sizes, name) / getattr(TRUE, name)) for name in NAMES])
    for name, log in zip(NAMES, np.mean(logs, axis=0), strict=True):
        assert abs(log) < np.log(4 / 3), name


@pytest.mark.slow
def test_standard_errors_hold() -> None:
    """Of surfaces drawn from the prior, errors of trials and sizes estimated as well."""
    rng = np.random.default_rng(18)
    z = []
    for _ in range(20):
        D = drawn(TRUE, rng)
        data = data_of(D, rng, sizes=TRUE)
        (fit,), _ = fit_surfaces([reduce_trials(data, SCALING)])
        orders = choose_orders([fit], position=None, velocity=None)
        q, v = rng.uniform(-2, 2, 20), rng.uniform(0.2, 4.0, 20)
        A = SCALING.basis(q, v, orders.position, orders.velocity)
        true = SCALING.basis(q, v, MAX_POSITION_ORDER, 11) @ D.ravel()
        error = np.sqrt(np.einsum("nk,kl,nl->n", A, fit.covariance(orders), A))
        z.append((A @ fit.entries(orders).ravel() - true) / error)
    rms = float(np.sqrt(np.mean(np.concatenate(z) ** 2)))
    assert 0.85 < rms < 1.25


def known_surface(m: int, l: int) -> Array:
    """Coefficients that need the orders (m, l), no less."""
    D = np.zeros((m + 1, l + 1))
    D[0, 0], D[0, 1:], D[1:, 0] = 5.0, 0.8, 0.5
    D[m, l] = D[m, l] if (m, l) == (0, 0) else 0.5
    return D


@cache
def fitted(m: int, l: int, seed: int) -> tuple[SurfaceFit, Orders]:
    """A known surface of these orders, and those that are chosen."""
    data = data_of(known_surface(m, l), np.random.default_rng(seed))
    (fit,), _ = fit_surfaces([reduce_trials(data, SCALING)])
    return fit, choose_orders([fit], position=None, velocity=None)


@pytest.mark.slow
@pytest.mark.parametrize(("m", "l"), [(0, 1), (2, 1), (3, 2), (5, 3)])
def test_orders_of_a_known_surface_are_never_too_low(m: int, l: int) -> None:
    for seed in range(4):
        fit, found = fitted(m, l, seed)
        assert found.position >= m
        assert found.velocity >= l
        assert fit.deviation(found) <= DEVIATION


def test_high_orders_do_not_swing_between_the_speeds() -> None:
    """With the paper's orders the surface is as good between the speeds as at them (Runge)."""
    rng = np.random.default_rng(9)
    data = data_of(known_surface(3, 2), rng)
    (fit,), _ = fit_surfaces([reduce_trials(data, SCALING)])
    q, v = (x.ravel() for x in np.meshgrid(np.linspace(-1.9, 1.9, 30), np.linspace(0.3, 3.8, 60)))
    true = SCALING.basis(q, v, 3, 2) @ known_surface(3, 2).ravel()
    entries = fit.entries(Orders(MAX_POSITION_ORDER, 11))
    off = SCALING.basis(q, v, MAX_POSITION_ORDER, 11) @ entries.ravel() - true
    assert np.sqrt(np.mean(off**2)) < 0.02
    assert np.abs(off).max() < 0.12


def test_orders_that_the_user_fixes_are_kept() -> None:
    reduced = reduce_trials(data_of(COEFFICIENTS, np.random.default_rng(5)), SCALING)
    for position, velocity in ((10, 11), (1, 2), (0, 0)):
        fits, _ = fit_surfaces([reduced], position=position, velocity=velocity)
        fixed = choose_orders(fits, position=position, velocity=velocity, accept=lambda _: True)
        assert fixed == Orders(position, velocity)
    fits, _ = fit_surfaces([reduced], position=1)
    half = choose_orders(fits, position=1, velocity=None)
    assert half.position == 1
    assert half.velocity >= 2


def test_eq_11_holds_for_the_right_orders_and_fails_for_too_low_ones() -> None:
    data = data_of(COEFFICIENTS, np.random.default_rng(7), sizes=replace(WHITE, noise=0.05))
    (fit,), _ = fit_surfaces([reduce_trials(data, SCALING)])
    parts = [(data, fit)]
    good, poor = (errors_of(parts, Orders(m, l), unseen=True) for m, l in ((3, 2), (0, 1)))
    assert good.relative <= 0.01
    assert poor.relative > 0.1
    assert good.rms < 0.01
    assert np.abs(poor.error).max() > 0.5


def test_slices_in_which_the_joint_still_speeds_up_lose_their_weight() -> None:
    """The first tenth of the fast trials is off by as much as friction; medians do not follow."""
    data = data_of(known_surface(2, 1), np.random.default_rng(11), sizes=replace(WHITE, noise=0.3))
    spoilt = [
        replace(item, friction=item.friction + 5.0 * (np.arange(SLICES) < 4) * (item.speed > 2.0))
        for item in data
    ]
    found = weighted(spoilt, around_medians(spoilt))
    for item, own in zip(spoilt, found, strict=True):
        if item.speed > 2.0:
            assert np.all(own.weight[:4] == 0.0)
        share = own.weight[4:] / item.weight[4:]
        assert np.mean(share > 0.3 * share.max()) > 0.9


def test_a_posterior_of_sizes_that_are_far_apart() -> None:
    """Rounding makes an eigenvalue of the normal equations negative, here by more than 1."""
    large, none = 1e16, np.zeros((0, 0))
    N = np.array([[large, large + 8.0], [large + 8.0, large]])
    normal = Normal(N, np.array([1.0, 1.0]), none, none, none, none, 0.0, 0.0)
    mean, covariance, log_size = normal.posterior(np.ones(2))
    assert np.isfinite(mean).all()
    np.testing.assert_allclose(covariance, [[0.5, -0.5], [-0.5, 0.5]], atol=1e-6)
    assert log_size == pytest.approx(np.log(2.0 * large))
