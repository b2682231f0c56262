"""The reduced fit against direct generalised least squares; orders and errors against
truth.
"""

from dataclasses import replace
from itertools import product

import numpy as np
import pytest
from scipy.linalg import block_diag

from seqid_cli.errors import QualityError, UsageError
from seqid_cli.identify.friction_surface import fit as fitting
from seqid_cli.identify.friction_surface.fit import (
    SurfaceFit,
    choose_orders,
    fit_surfaces,
)
from seqid_cli.identify.friction_surface.prior import Sizes
from seqid_cli.identify.friction_surface.reduction import (
    Orders,
    SpeedData,
    edges_of,
    reduce_trials,
    weighted,
)
from seqid_cli.identify.friction_surface.stage import identify_friction
from seqid_cli.identify.friction_surface.summary import Errors, errors_of
from seqid_cli.identify.options import MAX_POSITION_ORDER as HIGHEST
from seqid_cli.identify.options import FrictionOptions
from seqid_cli.model.friction_basis import Scaling
from tests import Array
from tests.plants.robots.sample import sample_rig

SCALING = Scaling((-2.0, 2.0), (0.2, 4.0))
SPEEDS = np.geomspace(0.2, 4.0, 12)
SLICES = 40
COEFFICIENTS = np.array(
    [[5.0, 0.8, -0.4], [0.5, 0.1, 0.0], [-0.7, 0.0, 0.2], [0.3, 0.2, 0.1]]
)
SURFACE = {
    "position": 0.5,
    "speed": 0.5,
    "surface": 0.2,
    "position_decay": 3.0,
    "speed_decay": 3.0,
}
ERRORS = {"trial": 0.1, "slow": 0.1, "unsteady": 0.2, "edge": 0.1, "noise": 0.3}
TRUE = Sizes(**SURFACE, **ERRORS, broad=15.0)
WHITE = replace(TRUE, trial=0.0, slow=0.0, unsteady=0.0, edge=0.0)


def data_of(
    D: Array, rng: np.random.Generator, sizes: Sizes = WHITE, doubt: float = 0.0
) -> list[SpeedData]:
    """Both ways at twelve speeds; the inertia's error makes `doubt` N m times the
    speed.
    """
    result = []
    for speed, direction in product(SPEEDS, (1, -1)):
        q = np.sort(rng.uniform(*SCALING.position, SLICES))
        order = SCALING.over_position.order(len(D))
        A = SCALING.basis(q, np.full(SLICES, speed), order, D.shape[1] - 1)
        weight = rng.uniform(5.0, 50.0, SLICES)
        edges = edges_of(0.02 * np.arange(SLICES), 0.02)
        push = doubt * speed * np.linspace(1.0, -0.5, SLICES)
        own = np.hstack([SCALING.over_position.values(q, HIGHEST), edges])
        size = own.shape[1] - edges.shape[1]
        spread = np.sqrt(
            sizes.trial_variances(SCALING, size, np.array([speed])).sum(axis=0)[0]
        )
        error = own @ (spread[: own.shape[1]] * rng.standard_normal(own.shape[1]))
        error += sizes.noise / np.sqrt(weight) * rng.standard_normal(SLICES)
        trial = SpeedData(
            speed=float(speed),
            direction=direction,
            q=q,
            friction=A @ D.ravel() + error,
            weight=weight,
            edges=edges,
            push=push,
            doubt=doubt * np.cos(q),
            late=doubt * speed * np.sin(q),
            warm=doubt * np.full(SLICES, np.sin(len(result))),
        )
        result.append(trial)
    return result


def surface_fit(data: list[SpeedData]) -> SurfaceFit:
    (fit,), _ = fit_surfaces([reduce_trials(data, SCALING)])
    return fit


def chosen(fit: SurfaceFit) -> Orders:
    return choose_orders([fit], (None, None))


def direct(data: list[SpeedData], sizes: Sizes, orders: Orders) -> tuple[Array, Array]:
    """Entries and covariance by one dense system over all slices, with their whole
    covariance.
    """
    columns, blocks = [], []
    for item in data:
        speed = np.full(len(item.q), item.speed)
        columns.append(SCALING.basis(item.q, speed, orders.position, orders.velocity))
        values = SCALING.over_position.values(item.q, HIGHEST)
        shared_errors = [item.push, item.doubt, item.late, item.warm]
        own = np.column_stack([values, item.edges, *shared_errors])
        variance = sizes.trial_variances(
            SCALING, HIGHEST + 1, np.array([item.speed])
        ).sum(axis=0)
        shared = own * np.sqrt(variance)
        blocks.append(shared @ shared.T + np.diag(sizes.noise**2 / item.weight))
    A, V = np.vstack(columns), block_diag(*blocks)
    # each one and the same error in all trials
    for name in ("push", "doubt", "late", "warm"):
        error = np.concatenate([getattr(item, name) for item in data])
        V += np.outer(error, error)
    prior = sizes.prior(SCALING, orders.position + 1, orders)[
        : orders.position + 1
    ].ravel()
    weighing = np.linalg.solve(V, A)
    covariance = np.linalg.inv(A.T @ weighing + np.diag(prior**-2.0))
    return (
        covariance @ (weighing.T @ np.concatenate([x.friction for x in data])),
        covariance,
    )


@pytest.mark.parametrize(("m", "l"), [(HIGHEST, 11), (0, 0), (3, 2), (1, 5)])
def test_both_steps_together_are_the_generalised_least_squares(m: int, l: int) -> None:
    data = data_of(COEFFICIENTS, np.random.default_rng(0), TRUE, doubt=0.05)
    reduced, orders = reduce_trials(data, SCALING), Orders(m, l)
    fit = SurfaceFit(reduced, TRUE, fitting.highest_orders([reduced], (None, None)))
    entries, covariance = direct(data, TRUE, orders)
    np.testing.assert_allclose(fit.entries(orders).ravel(), entries, atol=1e-8)
    if m == HIGHEST:  # that of fewer orders allows for what they leave out
        np.testing.assert_allclose(fit.covariance(orders), covariance, atol=1e-9)


def drawn(sizes: Sizes, rng: np.random.Generator) -> Array:
    """A surface of the highest orders, drawn from the prior; Coulomb friction of 5."""
    prior = sizes.prior(SCALING, HIGHEST + 1, Orders(HIGHEST, 11))
    D: Array = prior[: HIGHEST + 1] * rng.standard_normal((HIGHEST + 1, 12))
    D[0, :2] = 5.0, 0.5
    return D


@pytest.mark.slow
def test_standard_errors_hold() -> None:
    """Of surfaces drawn from the prior,
    errors of trials and sizes estimated as well.
    """
    rng = np.random.default_rng(18)
    z = []
    for _ in range(20):
        D = drawn(TRUE, rng)
        fit = surface_fit(data_of(D, rng, TRUE))
        orders = chosen(fit)
        q, v = rng.uniform(-2, 2, 20), rng.uniform(0.2, 4.0, 20)
        A = SCALING.basis(q, v, orders.position, orders.velocity)
        true = SCALING.basis(q, v, HIGHEST, 11) @ D.ravel()
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


@pytest.mark.slow
@pytest.mark.parametrize(("m", "l"), [(0, 1), (2, 1), (3, 2), (5, 3)])
def test_orders_of_a_known_surface_are_never_too_low(m: int, l: int) -> None:
    for seed in range(4):
        fit = surface_fit(data_of(known_surface(m, l), np.random.default_rng(seed)))
        found = chosen(fit)
        assert found.position >= m
        assert found.velocity >= l
        assert fit.deviation(found) <= fitting.DEVIATION


def test_high_orders_do_not_swing_between_the_speeds() -> None:
    """With the paper's orders the surface is as good between the speeds as at them
    (Runge).
    """
    fit = surface_fit(data_of(known_surface(3, 2), np.random.default_rng(9)))
    q, v = (
        x.ravel()
        for x in np.meshgrid(np.linspace(-1.9, 1.9, 30), np.linspace(0.3, 3.8, 60))
    )
    true = SCALING.basis(q, v, 3, 2) @ known_surface(3, 2).ravel()
    entries = fit.entries(Orders(HIGHEST, 11))
    off = SCALING.basis(q, v, HIGHEST, 11) @ entries.ravel() - true
    assert np.sqrt(np.mean(off**2)) < 0.02
    assert np.abs(off).max() < 0.12


def test_orders_that_the_user_fixes_are_kept() -> None:
    reduced = reduce_trials(data_of(COEFFICIENTS, np.random.default_rng(5)), SCALING)
    for position, velocity in ((10, 11), (1, 2), (0, 0), (1, None)):
        fits, _ = fit_surfaces([reduced], (position, velocity))
        found = choose_orders(fits, (position, velocity))
        assert found.position == position
        assert found.velocity == velocity or velocity is None
    assert found.velocity >= 2


def test_trials_of_one_motion_again_and_again_tell_nothing_new() -> None:
    """What a trial has for itself comes again with it: more orders would follow it."""
    rng = np.random.default_rng(3)
    once = data_of(COEFFICIENTS, rng, TRUE)
    noise = TRUE.noise / np.sqrt([item.weight for item in once])
    often = [
        replace(item, friction=item.friction + level * rng.standard_normal(SLICES))
        for _ in range(16)
        for item, level in zip(once, noise, strict=True)
    ]
    left_out = []
    std_errors = []
    for data in (once, often):
        fit = surface_fit(data)
        errors = errors_of([(data, fit)], chosen(fit), unseen=True)
        left_out.append(np.sqrt(np.mean(errors.missed**2)))
        std_errors.append(np.sqrt(np.trace(fit.highest_posterior.covariance)))
    assert left_out[1] < 1.1 * left_out[0]
    assert std_errors[1] > 0.5 * std_errors[0]


def test_eq_11_holds_for_the_right_orders_and_fails_for_too_low_ones() -> None:
    data = data_of(COEFFICIENTS, np.random.default_rng(7), replace(WHITE, noise=0.05))
    parts = [(data, surface_fit(data))]
    for unseen in (True, False):
        good, poor = (
            errors_of(parts, Orders(m, l), unseen=unseen) for m, l in ((3, 2), (0, 1))
        )
        assert good.relative <= 0.01
        assert poor.relative > 0.1
        assert np.sqrt(np.mean(good.error**2)) < 0.01
        assert np.abs(poor.error).max() > 0.5


def test_eq_11_is_the_largest_relative_error_and_nothing_is_taken_off() -> None:
    """Of averages over sixteen slices, by a surface evaluated here."""
    data = data_of(COEFFICIENTS, np.random.default_rng(11), TRUE)
    fit, orders = surface_fit(data), Orders(3, 2)
    D = fit.entries(orders)
    largest = 0.0
    for item in data:
        columns = SCALING.basis(item.q, np.full(SLICES, item.speed), 3, 2)
        error = columns @ D.ravel() - item.friction
        for group in np.array_split(np.arange(SLICES), 2):
            largest = max(
                largest, abs(error[group].mean() / item.friction[group].mean())
            )
    errors = errors_of([(data, fit)], orders, unseen=False)
    assert errors.relative == pytest.approx(largest, rel=1e-9)
    assert 0.0 < errors.relative_beyond_noise < errors.relative


def test_where_friction_approaches_zero_the_error_is_over_a_fifth_of_its_rms() -> None:
    one = np.ones(4)
    friction = np.array([1.0, -1.0, 1e-9, 0.5])
    error = np.array([0.01, 0.02, 0.03, 0.0])
    errors = Errors(
        u=one,
        error=error,
        friction=friction,
        noise=0.0 * one,
        trial_error=0.0 * one,
        q=0.0 * one,
        direction=one,
    )
    rms = np.sqrt(np.mean(friction**2))
    assert errors.relative == pytest.approx(0.03 / (0.2 * rms))
    assert errors.relative_of_noise == 0.0


def test_what_noise_alone_makes_is_the_median_of_the_largest() -> None:
    rng = np.random.default_rng(12)
    friction = rng.uniform(1.0, 3.0, 80)
    noise, trial_error = rng.uniform(0.01, 0.1, (2, 80))
    one = np.ones(80)
    errors = Errors(
        u=one,
        error=one,
        friction=friction,
        noise=noise,
        trial_error=trial_error,
        q=0.0 * one,
        direction=one,
    )
    drawn_errors = np.hypot(noise, trial_error) * rng.standard_normal((20000, 80))
    largest = np.abs(drawn_errors / friction).max(axis=1)
    assert errors.relative_of_noise == pytest.approx(np.median(largest), rel=0.01)


def test_noise_of_the_right_size_explains_eq_11() -> None:
    """The surface is the true one: what is left is what trials have for themselves."""
    data = data_of(COEFFICIENTS, np.random.default_rng(13), TRUE)
    errors = errors_of([(data, surface_fit(data))], Orders(3, 2), unseen=False)
    assert 0.6 < errors.relative / errors.relative_of_noise < 1.6
    assert np.sqrt(np.mean(errors.trial_error**2)) > 2.0 * np.sqrt(
        np.mean(errors.noise**2)
    )


def test_orders_are_raised_until_eq_11_holds_or_no_orders_meet_it() -> None:
    data = data_of(COEFFICIENTS, np.random.default_rng(14), TRUE)
    fit = surface_fit(data)

    def raised_to(beta: float) -> Orders:
        def accept(orders: Orders) -> bool:
            return errors_of([(data, fit)], orders, unseen=False).relative <= beta

        return choose_orders([fit], (None, None), accept=accept)

    unasked = chosen(fit)
    at_unasked = errors_of([(data, fit)], unasked, unseen=False).relative
    loose = raised_to(2.0 * at_unasked)
    assert (loose.position + 1) * (loose.velocity + 1) < (unasked.position + 1) * (
        unasked.velocity + 1
    )
    met = errors_of([(data, fit)], loose, unseen=False)
    assert met.relative <= 2.0 * at_unasked
    assert raised_to(1e-6) == unasked


def test_orders_beyond_the_reduction_are_refused() -> None:
    with pytest.raises(UsageError, match="position order 11 is too high"):
        FrictionOptions(position_order=HIGHEST + 1)
    fit = surface_fit(data_of(COEFFICIENTS, np.random.default_rng(0)))
    for orders in (
        Orders(HIGHEST + 1, 1),
        Orders(1, fit.highest.velocity + 1),
    ):
        with pytest.raises(ValueError, match="beyond the highest"):
            fit.entries(orders)
        with pytest.raises(ValueError, match="beyond the highest"):
            fit.covariance(orders)


@pytest.mark.parametrize("torque", [0.0, 1.0])
def test_a_torque_that_never_changes_is_said(torque: float) -> None:
    rig = sample_rig("one_joint")
    logs = [
        replace(log, tau=np.full_like(log.tau, torque)) for log in rig.logs("friction")
    ]
    with pytest.raises(QualityError, match="one and the same") as raised:
        identify_friction(logs, rig.robot, options=FrictionOptions())
    assert raised.value.where == "joint joint_1"
    assert "seqid inspect" in raised.value.hint


def test_evidence_that_is_no_number_is_an_error(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    rig = sample_rig("one_joint")
    monkeypatch.setattr(
        "seqid_cli.identify.friction_surface.stage.fit_surfaces",
        lambda *_: ([None], np.nan),
    )
    with pytest.raises(QualityError, match="no number"):
        identify_friction(rig.logs("friction"), rig.robot, options=FrictionOptions())


def test_half_of_the_slices_of_every_trial_belong() -> None:
    """Distances are from their median: whatever they are, half of them are small."""
    rng = np.random.default_rng(0)
    for size in (1, 2, 3, 40):
        zeros = np.zeros(size)
        data = [
            SpeedData(
                speed=0.1,
                direction=1,
                q=np.arange(size) * 1.0,
                friction=scale * rng.standard_cauchy(size),
                weight=np.full(size, 8.0),
                edges=np.zeros((size, 2)),
                push=zeros,
                doubt=zeros,
                late=zeros,
                warm=zeros,
            )
            for scale in (0.0, 1.0, 1e9)
        ]
        distances = [item.friction - np.median(item.friction) for item in data]
        for item in weighted(data, distances):
            assert np.count_nonzero(item.belongs) >= size / 2
