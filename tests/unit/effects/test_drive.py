"""Drive and measurement effects: parameters come back from torque distorted at a finer
rate.
"""

from collections.abc import Callable
from contextlib import suppress
from dataclasses import replace

import numpy as np
import pytest
from scipy.ndimage import uniform_filter1d

from seqid_cli.effects.effect import GridAxes
from seqid_cli.effects.measurement import TorqueMeasurement
from seqid_cli.effects.registry import CATALOGUE
from seqid_cli.effects.scene import Scene, Scenes
from seqid_cli.effects.torque_filter import TorqueFilter
from seqid_cli.motion.filters.differentiation import differentiate
from tests import Array
from tests.plants.robots.two_joint import torque_model, two_joint_robot
from tests.unit.effects.fitting import best_fitted, fitted, rms_left
from tests.unit.effects.scenes import RATE_HZ, motion_of, scene_of, wander

# t (M,), torque (M, n) at the fine rate -> torque
Distortion = Callable[[Array, Array], Array]

FINE = 10
FINE_HZ = FINE * RATE_HZ
NOISE = 0.3  # N m per sample; the torque's RMS is 49 and 28 N m


def scenes(distortion: Distortion, logs: int = 2) -> list[Scene]:
    """Logs, 100 s from start to start, whose torque went through a distortion."""
    model = torque_model(two_joint_robot())
    of_logs = []
    for log in range(logs):
        q = wander(22.0, seed=log, rate_hz=FINE_HZ, rests=())
        dq, ddq = differentiate(q, FINE_HZ)
        # derivatives and motion set in before
        inside = slice(round(FINE_HZ), -round(FINE_HZ))
        true = (model.rigid(q, dq, ddq) + model.friction(q, dq))[inside]
        t = 100.0 * log + np.arange(len(true)) / FINE_HZ
        # Read as a drive reads: the mean over a sample, centred on it.
        means = uniform_filter1d(distortion(t, true), FINE + 1, axis=0, mode="nearest")
        read = means[::FINE]
        hiss = np.random.default_rng(100 + log).normal(size=read.shape)
        logged = read + NOISE * hiss

        positions = q[inside][::FINE]
        scene = scene_of(positions, log=log, start=100.0 * log, shared_clock=True)
        of_logs.append(replace(scene, motion=motion_of(positions, tau=logged)))
    return of_logs


def honest(t: Array, tau: Array) -> Array:
    return tau


def late(samples: int) -> Distortion:
    """Torque as it was some fine samples before (after, where negative)."""
    return lambda t, tau: tau[np.clip(np.arange(len(tau)) - samples, 0, len(tau) - 1)]


def lagging(constant: float) -> Distortion:
    """Return the command whose lagged version is the torque: the inverse recursion."""
    past = np.exp(-1.0 / (FINE_HZ * constant))
    return lambda t, tau: np.vstack(
        [tau[:1], (tau[1:] - past * tau[:-1]) / (1.0 - past)]
    )


def averaging(seconds: float) -> Distortion:
    """Return the mean of the torques over the last seconds."""
    count = round(seconds * FINE_HZ)

    def read(t: Array, tau: Array) -> Array:
        held = np.vstack([np.repeat(tau[:1], count, axis=0), tau])
        return np.array(
            [np.convolve(x, np.full(count, 1.0 / count), "valid")[1:] for x in held.T]
        ).T

    return read


def smoothing(constant: float) -> Distortion:
    """Low-pass step by step."""
    past = np.exp(-1.0 / (FINE_HZ * constant))

    def read(t: Array, tau: Array) -> Array:
        low = np.empty_like(tau)
        low[0] = tau[0]
        for k in range(1, len(tau)):
            low[k] = past * low[k - 1] + (1.0 - past) * tau[k]
        return low

    return read


def saturating(b: float) -> Distortion:
    """Bisect m (1 - b m^2) = tau on its rising branch."""

    def read(t: Array, tau: Array) -> Array:
        low = np.zeros_like(tau)
        high = np.full_like(tau, 1.0 / np.sqrt(3.0 * b))
        for _ in range(60):
            middle = 0.5 * (low + high)
            less = middle * (1.0 - b * middle**2) < np.abs(tau)
            low = np.where(less, middle, low)
            high = np.where(less, high, middle)
        return np.sign(tau) * low

    return read


@pytest.fixture(scope="module")
def floor() -> Array:
    """RMS (2,) N m that honest torque leaves."""
    clean = scenes(honest)
    return np.array([rms_left(clean, j) for j in range(2)])


LAG = 0.5 / FINE_HZ  # s: a lagging torque is held over a fine sample


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "joint", "distortion", "c", "off"),
    [
        *(
            ("time_skew", joint, late(samples), samples / FINE_HZ, 3e-5)
            for joint, samples in ((0, 10), (0, -10), (1, 2), (1, 40))
        ),
        ("time_skew", None, late(10), 10 / FINE_HZ, 2e-5),
        *(("actuator_lag", 0, lagging(x), x - LAG, 5e-5) for x in (0.002, 0.01)),
        ("torque_constant", 1, lambda t, x: 1.08 * x, 0.08, 1e-3),
        ("torque_bias", 0, lambda t, x: x + 0.5, 0.5, 0.02),
    ],
)
def test_the_size_comes_back_down_to_the_floor(
    floor: Array,
    name: str,
    joint: int | None,
    distortion: Distortion,
    c: float,
    off: float,
) -> None:
    _, coefficients, rms = best_fitted(CATALOGUE[name], scenes(distortion), joint)
    assert coefficients[0] == pytest.approx(c, abs=off)
    alone = np.sqrt(np.mean(floor**2)) if joint is None else floor[joint]
    assert rms < 1.05 * alone * (1.08 if name == "torque_constant" else 1.0)


class FilterOfLaw(TorqueFilter):
    """A filter of which it is known whether it is a window or a low-pass."""

    def __init__(self, lowpass: float) -> None:
        self.lowpass = lowpass

    def axes(self, scenes: Scenes, joint: int | None) -> GridAxes:
        return {**super().axes(scenes, joint), "lowpass": [self.lowpass]}


@pytest.mark.parametrize(
    ("distortion", "lowpass", "seconds", "off"),
    [
        (averaging(0.3), 0.0, 0.3, 3e-3),
        (averaging(0.06), 0.0, 0.06, 1e-3),
        (smoothing(0.1), 1.0, 0.1, 2e-3),
    ],
)
def test_the_filter_of_all_joints_comes_back(
    floor: Array, distortion: Distortion, lowpass: float, seconds: float, off: float
) -> None:
    """A window's length or a time constant, and which of the two it is.

    These logs begin in motion: what the filter still remembers of before is not known.
    """
    filtered = scenes(distortion)
    for scene in filtered:
        scene.motion.usable[: round(1.2 * RATE_HZ)] = False
    _, c, rms = best_fitted(FilterOfLaw(lowpass), filtered, None)
    assert c[0] == pytest.approx(seconds, abs=off)
    assert rms < 1.3 * np.sqrt(np.mean(floor**2))
    with suppress(ValueError):  # no other filter is plausible
        other = best_fitted(FilterOfLaw(1.0 - lowpass), filtered, None)
        assert rms < 0.5 * other.rms
    presliding = best_fitted(CATALOGUE["presliding_hysteresis"], filtered, 0).rms
    assert presliding > 3.0 * rms


def test_lag_and_delay_part_in_the_second_order() -> None:
    lagged = scenes(lagging(0.02))
    rms = [
        best_fitted(CATALOGUE[name], lagged, 0)[2]
        for name in ("actuator_lag", "time_skew")
    ]
    assert rms[1] > 1.5 * rms[0]


@pytest.mark.parametrize("share", [0.05, 0.12])
def test_saturation_comes_back(floor: Array, share: float) -> None:
    effect = CATALOGUE["torque_saturation"]
    peak = max(np.max(np.abs(s.modelled[s.motion.usable, 0])) for s in scenes(honest))
    b = share / peak**2
    bent = scenes(saturating(b))
    settings, c, rms = best_fitted(effect, bent, 0)
    assert c[0] == pytest.approx(b, rel=0.1)
    assert effect.plausible(bent, 0, settings, c)
    assert rms < 1.5 * floor[0]
    exact, least = fitted(effect, bent, 0, {"around": b})
    assert exact[0] == pytest.approx(b, rel=0.01)
    assert least < 1.05 * floor[0]


def test_a_drift_comes_back() -> None:
    drifting = scenes(lambda t, x: x + np.outer(0.3 + 1e-3 * t, [1.0, 0.0]), logs=3)
    settings, c, _ = best_fitted(CATALOGUE["drift"], drifting, 0)
    assert settings["duration"] == pytest.approx(220.0, abs=0.1)
    assert c[0] == pytest.approx(0.3, abs=0.02)
    assert c[1] == pytest.approx(1e-3, abs=2e-4)


TRUTHS = [
    ("torque_constant", {}, [0.08], lambda t, x: 1.08 * x),
    ("torque_bias", {}, [0.7], lambda t, x: x + 0.7),
    ("torque_saturation", {"around": 0.0}, [3e-6], saturating(3e-6)),
    ("time_skew", {"around": 0.0}, [20 / FINE_HZ], late(20)),
    ("actuator_lag", {}, [0.005 - LAG], lagging(0.005)),
]


@pytest.mark.parametrize(("name", "settings", "c", "distortion"), TRUTHS)
def test_true_torque_undoes_the_distortion(
    name: str, settings: dict[str, float], c: list[float], distortion: Distortion
) -> None:
    effect = CATALOGUE[name]
    assert isinstance(effect, TorqueMeasurement)
    t = np.arange(5000) / FINE_HZ
    tau = np.stack(
        [80 * np.sin(3 * t) + 20 * np.cos(11 * t), 40 * np.cos(5 * t)], axis=1
    )
    undone = effect.true_torque(distortion(t, tau), FINE_HZ, settings, np.array(c))
    np.testing.assert_allclose(undone[200:-200], tau[200:-200], atol=5e-3)
