"""The accelerometer equation, solved where the layout allows and refused elsewhere."""

import numpy as np
import pytest

from seqid_cli.imu import array as arrays
from seqid_cli.imu.array import (
    array_matrix,
    layout,
    layout_statements,
    read_angular,
)
from seqid_cli.motion.filters.butterworth import Lowpass
from seqid_cli.robot.types import Imu
from seqid_cli.typing import Array
from tests.plants.mechanics.rigid import LinkMotion
from tests.plants.sensors import AccelerometerArray, tetrahedral_array

OPEN = Lowpass(1e9, 100.0)  # passes everything


def imu_of(positions: Array, axes: Array, *, gyro: bool = False) -> Imu:
    return Imu("imu_a", 0, positions, axes, gyro=gyro)


def moved(imu: Imu, seed: int, samples: int = 50) -> tuple[Array, Array, Array]:
    """Readings (N, K) of a rigid motion by the simulated instrument's own arithmetic; w
    and dw.
    """
    f, w, dw = np.random.default_rng(seed).standard_normal((3, samples, 3))
    f = 10 * f
    w = 4 * w
    dw = 30 * dw
    array = AccelerometerArray("a", 0, imu.positions, imu.axes, np.eye(3), np.zeros(3))
    turn = np.broadcast_to(np.eye(3), (samples, 3, 3))
    return array.ideal(LinkMotion(turn, w, dw, f)), w, dw


def squared(w: Array) -> Array:
    return np.asarray(w[:, :, None] * w[:, None, :])


@pytest.fixture(params=["tetrahedron", "random"])
def imu(request: pytest.FixtureRequest) -> Imu:
    if request.param == "tetrahedron":
        return imu_of(*tetrahedral_array(0.05))
    rng = np.random.default_rng(0)
    axes = rng.standard_normal((12, 3))
    axes /= np.linalg.norm(axes, axis=1, keepdims=True)
    return imu_of(rng.uniform(-0.1, 0.1, (12, 3)), axes)


def test_twelve_accelerometers_give_the_motion_exactly(imu: Imu) -> None:
    values, w, dw = moved(imu, 1)
    got = read_angular(imu, values, None, OPEN, np.ones(len(w), dtype=bool))
    np.testing.assert_allclose(got.dw, dw, atol=1e-7)
    np.testing.assert_allclose(got.products, squared(w), atol=1e-7)
    inverse = arrays.array_inverse(imu)
    np.testing.assert_allclose(inverse @ array_matrix(imu), np.eye(12), atol=1e-8)
    np.testing.assert_allclose(
        layout(imu).errors, np.linalg.norm(inverse, axis=1), rtol=1e-8
    )


@pytest.mark.parametrize("count", [*range(3, 15), "flat"])
def test_a_layout_claims_what_no_null_direction_touches(count: int | str) -> None:
    rng = np.random.default_rng(5)
    if count == "flat":
        corners = np.column_stack([rng.uniform(-0.1, 0.1, (4, 2)), np.zeros(4)])
        few = imu_of(np.repeat(corners, 3, axis=0), np.tile(np.eye(3), (4, 1)))
    else:
        positions = 0.05 * rng.integers(-1, 2, (count, 3)).astype(float)
        few = imu_of(positions, np.eye(3)[rng.integers(0, 3, count)])
    A = array_matrix(few)
    judged = layout(few)
    _, s, Vt = np.linalg.svd(A)
    hidden = np.abs(Vt[np.sum(s > 1e-9 * s[0]) :]).max(axis=0, initial=0.0) > 1e-9
    assert judged.acceleration == (not hidden[3:6].any())
    assert judged.products == (not hidden[6:].any())
    values, w, _ = moved(few, 6)
    read = read_angular(few, values, None, OPEN, np.ones(len(w), bool))
    assert judged.products or not read.products.any()


def test_a_gyro_is_differentiated() -> None:
    t = np.arange(2000) / 500.0
    w = np.column_stack([np.sin(3 * t), 0.5 * np.cos(2 * t), 0.2 * t])
    dw = np.column_stack([3 * np.cos(3 * t), -np.sin(2 * t), np.full_like(t, 0.2)])
    f = np.tile([0.1, 0.2, 9.8], (len(t), 1))
    imu = imu_of(np.zeros((3, 3)), np.eye(3), gyro=True)
    lowpass = Lowpass(20.0, 500.0)
    valid = np.ones(len(t), dtype=bool)
    got = read_angular(imu, f, w, lowpass, valid)
    inner = slice(2 * lowpass.settling, -2 * lowpass.settling)
    np.testing.assert_allclose(got.dw[inner], dw[inner], atol=1e-3)
    np.testing.assert_allclose(got.products[inner], squared(w)[inner], atol=1e-3)


def test_a_layout_is_described_in_words(imu: Imu) -> None:
    assert layout_statements(imu) == []
    positions, axes = tetrahedral_array(0.05)
    point = imu_of(0.0 * positions, axes)
    few = imu_of(positions[:9], axes[:9])
    flat = imu_of(positions * [1.0, 1.0, 0.0], axes)
    for poor, reason in (
        (point, "one point"),
        (few, "fewer than the 12"),
        (flat, "plane"),
    ):
        assert any(reason in text for text in layout_statements(poor))
    assert "the angular acceleration cannot be told from the rest" in layout_statements(
        point
    )
    assert np.isinf(layout(few).errors).any()
    assert layout_statements(imu_of(np.zeros((3, 3)), np.eye(3), gyro=True)) == []
