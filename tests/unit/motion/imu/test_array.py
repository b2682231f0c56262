"""The accelerometer equation, solved where the layout allows and refused elsewhere."""

import numpy as np
import pytest

from seqid_cli.motion.filters.butterworth import Lowpass
from seqid_cli.motion.imu.array import (
    array_inverse,
    array_matrix,
    calibrated,
    layout,
    layout_statements,
    read_angular,
    speed_about,
)
from seqid_cli.params.schema import ImuCalibration
from seqid_cli.robot.types import Imu
from seqid_cli.typing import Array
from tests.plants.mechanics.rigid import LinkMotion
from tests.plants.sensors import AccelerometerArray, tetrahedral_array

OPEN = Lowpass(1e9, 100.0)  # passes everything


def imu_of(positions: Array, axes: Array, *, gyro: bool = False) -> Imu:
    return Imu("imu_a", 0, positions, axes, gyro=gyro)


def moved(imu: Imu, seed: int, samples: int = 50) -> tuple[Array, Array, Array]:
    """Readings (N, K) of a rigid motion by the simulated instrument's own arithmetic; w and dw."""
    f, w, dw = np.random.default_rng(seed).standard_normal((3, samples, 3))
    f, w, dw = 10 * f, 4 * w, 30 * dw
    array = AccelerometerArray("a", 0, imu.positions, imu.axes, np.eye(3), np.zeros(3))
    turn = np.broadcast_to(np.eye(3), (samples, 3, 3))
    return array.ideal(LinkMotion(turn, w, dw, f)), w, dw


def squared(w: Array) -> Array:
    return np.asarray(w[:, :, None] * w[:, None, :])


@pytest.fixture(params=["tetrahedron", "random"])
def imu(request: pytest.FixtureRequest) -> Imu:
    """Twelve accelerometers that see everything."""
    if request.param == "tetrahedron":
        return imu_of(*tetrahedral_array(0.05))
    rng = np.random.default_rng(0)
    axes = rng.standard_normal((12, 3))
    return imu_of(
        rng.uniform(-0.1, 0.1, (12, 3)), axes / np.linalg.norm(axes, axis=1, keepdims=True)
    )


def test_twelve_accelerometers_give_the_motion_exactly(imu: Imu) -> None:
    values, w, dw = moved(imu, 1)
    got = read_angular(imu, values, None, OPEN, np.ones(len(w), dtype=bool))
    np.testing.assert_allclose(got.dw, dw, atol=1e-7)
    np.testing.assert_allclose(got.products, squared(w), atol=1e-7)


@pytest.mark.parametrize("count", [6, 9, 11])
def test_fewer_accelerometers_see_no_more_than_their_number(count: int) -> None:
    positions, axes = tetrahedral_array(0.05)
    few = imu_of(positions[:count], axes[:count])
    assert not (layout(few).acceleration and layout(few).products)
    assert _claims_hold(few)
    if count == 9:
        values, w, _ = moved(few, 6)
        assert not read_angular(few, values, None, OPEN, np.ones(len(w), bool)).products.any()


def _claims_hold(imu: Imu) -> bool:
    """Whether `layout` says a group is seen exactly where no null direction touches it."""
    A = array_matrix(imu)
    _, s, Vt = np.linalg.svd(A)
    null = Vt[np.sum(s > 1e-9 * s[0]) :]
    seen = layout(imu)
    acceleration = bool(np.abs(null[:, 3:6]).max(initial=0.0) < 1e-9)
    products = bool(np.abs(null[:, 6:]).max(initial=0.0) < 1e-9)
    return (seen.acceleration, seen.products) == (acceleration, products)


def test_random_layouts_are_judged_by_their_null_space() -> None:
    rng = np.random.default_rng(5)
    corners = np.column_stack([rng.uniform(-0.1, 0.1, (4, 2)), np.zeros(4)])
    assert _claims_hold(imu_of(np.repeat(corners, 3, axis=0), np.tile(np.eye(3), (4, 1))))
    for count in range(3, 15):
        axes = np.eye(3)[rng.integers(0, 3, count)]
        positions = 0.05 * rng.integers(-1, 2, (count, 3)).astype(float)
        assert _claims_hold(imu_of(positions, axes))


def test_a_gyro_is_differentiated() -> None:
    t = np.arange(2000) / 500.0
    w = np.column_stack([np.sin(3 * t), 0.5 * np.cos(2 * t), 0.2 * t])
    dw = np.column_stack([3 * np.cos(3 * t), -np.sin(2 * t), np.full_like(t, 0.2)])
    f = np.tile([0.1, 0.2, 9.8], (len(t), 1))
    imu = imu_of(np.zeros((3, 3)), np.eye(3), gyro=True)
    lowpass, valid = Lowpass(20.0, 500.0), np.ones(len(t), dtype=bool)
    got = read_angular(imu, f, w, lowpass, valid)
    inner = slice(2 * lowpass.settling, -2 * lowpass.settling)
    np.testing.assert_allclose(got.dw[inner], dw[inner], atol=1e-3)
    np.testing.assert_allclose(got.products[inner], squared(w)[inner], atol=1e-3)


def test_readings_go_through_the_low_pass_once(imu: Imu) -> None:
    values = np.random.default_rng(7).standard_normal((600, 12))
    lowpass, valid = Lowpass(10.0, 500.0), np.ones(600, dtype=bool)
    once = read_angular(imu, values, None, lowpass, valid).dw
    before = read_angular(imu, lowpass(values), None, OPEN, valid).dw
    np.testing.assert_allclose(once, before, atol=1e-10)


def test_a_layout_is_described_in_words(imu: Imu) -> None:
    assert layout_statements(imu) == []
    positions, axes = tetrahedral_array(0.05)
    point = layout_statements(imu_of(np.zeros((12, 3)), axes))
    assert "the angular acceleration cannot be told from the rest" in point
    assert any("one point" in text for text in point)
    few = imu_of(positions[:9], axes[:9])
    assert any("fewer than the 12" in text for text in layout_statements(few))
    assert np.isinf(layout(few).errors).any()
    flat = positions.copy()
    flat[:, 2] = 0.0
    assert any("plane" in text for text in layout_statements(imu_of(flat, axes)))
    assert layout_statements(imu_of(np.zeros((3, 3)), np.eye(3), gyro=True)) == []


def test_calibrated_readings_are_those_of_an_instrument_without_faults() -> None:
    rng = np.random.default_rng(12)
    imu = imu_of(np.zeros((3, 3)), np.eye(3), gyro=True)
    tilt = 0.02 * rng.standard_normal((2, 3, 3))
    skew = np.eye(3) + tilt
    skew /= np.linalg.norm(skew, axis=2, keepdims=True)
    f, w = rng.standard_normal((2, 40, 3))
    scale, bias = 1.0 + 0.1 * rng.standard_normal((2, 3)), rng.standard_normal((2, 3))
    calibration = ImuCalibration(
        rotation=np.eye(3).tolist(),
        std_error_deg=0.1,
        accelerometer_scale=scale[0].tolist(),
        accelerometer_bias=bias[0].tolist(),
        accelerometer_axes=skew[0].tolist(),
        gyro_scale=scale[1].tolist(),
        gyro_bias=bias[1].tolist(),
        gyro_axes=skew[1].tolist(),
    )
    mended, values, gyro = calibrated(
        imu, calibration, scale[0] * (f @ skew[0].T) + bias[0], scale[1] * (w @ skew[1].T) + bias[1]
    )
    np.testing.assert_allclose(values @ np.linalg.pinv(mended.axes).T, f, atol=1e-12)
    assert gyro is not None
    np.testing.assert_allclose(gyro, w, atol=1e-12)
    untold = ImuCalibration(rotation=np.eye(3).tolist(), std_error_deg=0.1)
    untold.accelerometer_bias = [None, 0.5, None]
    np.testing.assert_allclose(calibrated(imu, untold, f, None)[1], f - [0.0, 0.5, 0.0])


def test_speed_about_an_axis_is_its_component() -> None:
    w = np.random.default_rng(9).standard_normal((30, 3))
    axis = np.array([0.6, 0.0, -0.8])
    np.testing.assert_allclose(speed_about(squared(w), axis), np.abs(w @ axis), atol=1e-12)


def test_errors_of_a_layout_are_those_of_its_inverse(imu: Imu) -> None:
    inverse = array_inverse(imu)
    np.testing.assert_allclose(inverse @ array_matrix(imu), np.eye(12), atol=1e-8)
    np.testing.assert_allclose(layout(imu).errors, np.linalg.norm(inverse, axis=1), rtol=1e-8)
