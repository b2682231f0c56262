"""Lines in time: their frequency to a fraction of one over the session, and none of the motion."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray

from seqid_cli.model.effects.registry import CATALOGUE
from seqid_cli.model.effects.scene import Scene
from seqid_cli.model.effects.spectral_lines import Signal, strongest_lines
from tests.unit.model.effects.measured import noise_like
from tests.unit.model.effects.scenes import RATE_HZ, scene_of, wander

Array = NDArray[np.float64]

EFFECT = CATALOGUE["periodic_disturbance"]
AMPLITUDE, NOISE = 0.3, 0.3


def logs(*, shared: bool = True, count: int = 4, seconds: float = 20.0) -> list[Scene]:
    starts = [300.0 * k + 17.3 * k**2 if shared else 0.0 for k in range(count)]
    return [
        scene_of(wander(seconds, seed=k), log=k, start=start, shared_clock=shared)
        for k, start in enumerate(starts)
    ]


def line(scene: Scene, frequency: float, phase: float = 0.7, joint: int = 0) -> Array:
    """A line on one joint and noise on all, (N, n) N m."""
    torque = noise_like(scene, scene.log, NOISE)
    torque[:, joint] += AMPLITUDE * np.sin(2 * np.pi * frequency * scene.time + phase)
    return torque


@pytest.mark.parametrize("frequency", [50.0, 49.987, 23.4567, 99.3])
def test_frequency_to_a_fraction_of_the_session(frequency: float) -> None:
    scenes = logs()
    span = scenes[-1].time[-1]
    found = list(EFFECT.grid(scenes, 0, [line(s, frequency) for s in scenes]))
    assert len(found) == 1
    assert found[0]["frequency"] == pytest.approx(frequency, abs=0.05 / span)
    assert found[0]["clocks"] == 0.0


def test_amplitude_phase_and_their_errors() -> None:
    """Recovered within four of the standard errors that are reported."""
    scenes = logs()
    residual = [line(s, 50.0) for s in scenes]
    (settings,) = EFFECT.grid(scenes, 0, residual)
    X = np.concatenate([EFFECT.columns(s, 0, settings)[0] for s in scenes])
    y = np.concatenate([r[:, 0] for r in residual])
    c = np.linalg.lstsq(X, y)[0]
    covariance = NOISE**2 * np.linalg.inv(X.T @ X)
    values = {v.name: v for v in EFFECT.values(scenes[0].robot, 0, settings, c, covariance)}
    for name, truth in (("amplitude", AMPLITUDE), ("frequency", 50.0)):
        assert 0.0 < values[name].std_error < 0.05 * truth
        assert abs(values[name].value - truth) < 4 * values[name].std_error


def test_logs_without_a_common_clock_have_their_own_phases() -> None:
    scenes = logs(shared=False)
    residual = [line(s, 50.0, phase=1.3 * s.log) for s in scenes]
    (settings,) = EFFECT.grid(scenes, 0, residual)
    assert settings["clocks"] == 4.0
    assert settings["frequency"] == pytest.approx(50.0, abs=0.005)
    X = np.concatenate([EFFECT.columns(s, 0, settings)[0] for s in scenes])
    y = np.concatenate([r[:, 0] for r in residual])
    c = np.linalg.lstsq(X, y)[0]
    left = float(np.std(y - X @ c))
    assert left < 1.02 * NOISE
    values = EFFECT.values(scenes[0].robot, 0, settings, c, 1e-4 * np.eye(8))
    assert [v.name for v in values] == ["amplitude", "frequency"]
    assert values[0].value == pytest.approx(AMPLITUDE, rel=0.05)
    unknown = replace(scenes[0], log=4)
    assert not EFFECT.columns(unknown, 0, settings)[0].any()


def test_nothing_in_noise_nor_on_the_other_joint() -> None:
    scenes = logs()
    assert list(EFFECT.grid(scenes, 0, [noise_like(s, 50 + s.log, NOISE) for s in scenes])) == []
    assert list(EFFECT.grid(scenes, 1, [line(s, 50.0) for s in scenes])) == []


def test_ripple_of_the_motor_is_no_line_in_time() -> None:
    """Constant speeds, one per log: a clean line in each, at another frequency."""
    scenes = []
    for k, speed in enumerate((0.5, 0.8, 1.1, 1.4)):
        t = np.arange(round(20 * RATE_HZ)) / RATE_HZ
        q = np.stack([speed * t, 0.0 * t], axis=1)
        scenes.append(scene_of(q, log=k, start=100.0 * k, shared_clock=True))
    ripple = [noise_like(s, s.log, NOISE) + np.sin(2 * 50.0 * s.motion.q[:, :1]) for s in scenes]
    assert list(EFFECT.grid(scenes, 0, ripple)) == []


def test_harmonics_of_the_motion_are_no_disturbance() -> None:
    """A share of the model's own torque is missing: all lines of the residual are the motion's."""
    t = np.arange(round(20 * RATE_HZ)) / RATE_HZ
    q = np.stack([0.5 * np.sin(2 * np.pi * t), 0.5 * np.cos(2 * np.pi * t)], axis=1)
    scenes = [scene_of(q, log=k, start=40.0 * k, shared_clock=True) for k in range(4)]
    missing = [noise_like(s, s.log, 0.01) + 0.1 * s.modelled for s in scenes]
    assert strongest_lines([Signal(m[:, 0], RATE_HZ) for m in missing], 1.0, 3)
    assert list(EFFECT.grid(scenes, 0, missing)) == []
