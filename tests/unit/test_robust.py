"""Standard deviations that a few large values do not move."""

import numpy as np

from seqid_cli.robust import white_noise

SIZE = np.array([0.3, 2.0])


def noisy(samples: int = 20_000) -> np.ndarray:
    """White noise on smooth motion, with a jolt in every hundred samples."""
    rng = np.random.default_rng(0)
    t = np.linspace(0.0, 20.0, samples)
    values = np.stack([np.sin(t), 50.0 * np.cos(0.7 * t)], axis=1)
    values = values + SIZE * rng.normal(size=(samples, 2))
    values[::100] += 40.0 * SIZE
    return values


def test_noise_is_told_from_motion_and_jolts() -> None:
    np.testing.assert_allclose(white_noise(noisy()), SIZE, rtol=0.1)


def test_noise_is_looked_for_in_known_stretches_alone() -> None:
    values = noisy()
    known = np.ones(len(values), dtype=bool)
    known[5000:] = False
    values[5000:] += 100.0 * np.random.default_rng(1).normal(size=(len(values) - 5000, 2))
    np.testing.assert_allclose(white_noise(values, known), SIZE, rtol=0.1)
    assert white_noise(values)[0] > 10.0 * SIZE[0]
