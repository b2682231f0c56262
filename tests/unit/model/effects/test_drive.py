"""Drive and measurement effects: parameters come back from torque distorted at a finer rate."""

import numpy as np
import pytest

from seqid_cli.model.effects.measurement import TorqueMeasurement
from seqid_cli.model.effects.registry import CATALOGUE
from seqid_cli.model.effects.scene import Scene
from tests import Array
from tests.unit.model.effects.fitting import (
    FINE,
    Distortion,
    best_fitted,
    fitted,
    rms_left,
    scene_measuring,
)
from tests.unit.model.effects.scenes import RATE_HZ

FINE_HZ = FINE * RATE_HZ
NOISE = 0.3  # N m per sample; the torque's RMS is 49 and 28 N m


def honest(t: Array, tau: Array) -> Array:
    return tau


def late(samples: int) -> Distortion:
    """Torque as it was some fine samples before (after, where negative)."""

    def read(t: Array, tau: Array) -> Array:
        out = np.roll(tau, samples, axis=0)
        if samples > 0:
            out[:samples] = tau[0]
        elif samples < 0:
            out[samples:] = tau[-1]
        return out

    return read


def lagging(constant: float) -> Distortion:
    """Return the command whose lagged version is the torque, by the inverse recursion."""
    past = np.exp(-1.0 / (FINE_HZ * constant))

    def read(t: Array, tau: Array) -> Array:
        return np.vstack([tau[:1], (tau[1:] - past * tau[:-1]) / (1.0 - past)])

    return read


def saturating(b: float) -> Distortion:
    """Bisect m (1 - b m^2) = tau on its rising branch."""

    def read(t: Array, tau: Array) -> Array:
        low, high = np.zeros_like(tau), np.full_like(tau, 1.0 / np.sqrt(3.0 * b))
        for _ in range(60):
            middle = 0.5 * (low + high)
            less = middle * (1.0 - b * middle**2) < np.abs(tau)
            low, high = np.where(less, middle, low), np.where(less, high, middle)
        return np.sign(tau) * low

    return read


def scenes(distortion: Distortion, noise: float = NOISE) -> list[Scene]:
    return [scene_measuring(distortion, seed=seed, noise=noise) for seed in range(2)]


@pytest.fixture(scope="module")
def floor() -> Array:
    """RMS (2,) N m that honest torque leaves."""
    clean = scenes(honest)
    return np.array([rms_left(clean, j) for j in range(2)])


@pytest.mark.parametrize("samples", [10, -10, 2, 40])
@pytest.mark.parametrize("joint", [0, 1])
def test_a_delay_comes_back_down_to_the_floor(floor: Array, samples: int, joint: int) -> None:
    skewed = scenes(late(samples))
    _, c, left = best_fitted(CATALOGUE["time_skew"], skewed, joint)
    assert c[0] == pytest.approx(samples / FINE_HZ, abs=3e-5)
    assert left < 1.05 * floor[joint]
    assert rms_left(skewed[:1], joint) > (5.0 if abs(samples) > 5 else 1.2) * floor[joint]


def test_one_delay_of_all_joints(floor: Array) -> None:
    skewed = scenes(late(10))
    _, c, left = best_fitted(CATALOGUE["time_skew"], skewed, None)
    assert c[0] == pytest.approx(10 / FINE_HZ, abs=2e-5)
    assert left < 1.05 * np.sqrt(np.mean(floor**2))


@pytest.mark.parametrize("constant", [0.002, 0.01])
def test_a_lag_comes_back(floor: Array, constant: float) -> None:
    lagged = scenes(lagging(constant))
    _, c, left = best_fitted(CATALOGUE["actuator_lag"], lagged, 0)
    assert c[0] == pytest.approx(constant - 0.5 / FINE_HZ, abs=5e-5)  # held over a fine sample
    assert left < 1.05 * floor[0]


def test_lag_and_delay_part_in_the_second_order() -> None:
    """A lag of 20 ms, fitted as a delay, leaves more than it does as a lag."""
    lagged = scenes(lagging(0.02))
    _, _, as_lag = best_fitted(CATALOGUE["actuator_lag"], lagged, 0)
    _, _, as_skew = best_fitted(CATALOGUE["time_skew"], lagged, 0)
    assert as_skew > 1.5 * as_lag


@pytest.mark.parametrize("share", [0.05, 0.12])
def test_saturation_comes_back(floor: Array, share: float) -> None:
    clean = scenes(honest)
    peak = max(float(np.max(np.abs(s.modelled[s.motion.usable, 0]))) for s in clean)
    b = share / peak**2
    effect = CATALOGUE["torque_saturation"]
    bent = scenes(saturating(b))
    settings, c, left = best_fitted(effect, bent, 0)
    assert c[0] == pytest.approx(b, rel=0.1)
    assert effect.plausible(bent, 0, settings, c)
    exact, least = fitted(effect, bent, 0, {"around": b})
    assert exact[0] == pytest.approx(b, rel=0.01)
    assert least < 1.05 * floor[0]
    assert left < 1.5 * floor[0]


def test_a_wrong_torque_constant_comes_back(floor: Array) -> None:
    _, c, left = best_fitted(CATALOGUE["torque_constant"], scenes(lambda t, x: 1.08 * x), 1)
    assert c[0] == pytest.approx(0.08, abs=1e-3)
    assert left < 1.05 * 1.08 * floor[1]


def test_an_offset_and_a_drift_come_back() -> None:
    wander = [
        scene_measuring(
            lambda t, x: x + np.outer(0.3 + 1e-3 * t, [1.0, 0.0]),
            seed=seed,
            noise=NOISE,
            start=100.0 * seed,
            shared_clock=True,
            log=seed,
        )
        for seed in range(3)
    ]
    settings, c, _ = best_fitted(CATALOGUE["drift"], wander, 0)
    assert settings["duration"] == pytest.approx(220.0, abs=0.1)
    assert c[0] == pytest.approx(0.3, abs=0.02)
    assert c[1] == pytest.approx(1e-3, abs=2e-4)
    _, bias, _ = best_fitted(CATALOGUE["torque_bias"], scenes(lambda t, x: x + 0.5), 0)
    assert bias[0] == pytest.approx(0.5, abs=0.02)


TRUTHS = [
    ("torque_constant", {}, [0.08], lambda t, x: 1.08 * x),
    ("torque_bias", {}, [0.7], lambda t, x: x + 0.7),
    ("torque_saturation", {"around": 0.0}, [3e-6], saturating(3e-6)),
    ("time_skew", {"around": 0.0}, [20 / FINE_HZ], late(20)),
    ("actuator_lag", {}, [0.005 - 0.5 / FINE_HZ], lagging(0.005)),
]


@pytest.mark.parametrize(("name", "settings", "c", "distortion"), TRUTHS)
def test_true_torque_undoes_the_distortion(
    name: str, settings: dict[str, float], c: list[float], distortion: Distortion
) -> None:
    effect = CATALOGUE[name]
    assert isinstance(effect, TorqueMeasurement)
    t = np.arange(5000) / FINE_HZ
    tau = np.stack([80 * np.sin(3 * t) + 20 * np.cos(11 * t), 40 * np.cos(5 * t)], axis=1)
    undone = effect.true_torque(distortion(t, tau), FINE_HZ, settings, np.array(c))
    np.testing.assert_allclose(undone[200:-200], tau[200:-200], atol=5e-3)
